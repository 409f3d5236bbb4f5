"""The variants are the paper's: its ablations, its parameter counts, its sizes."""

import dataclasses
from functools import cache
from pathlib import Path

import pytest

from ablate.analysis import Component, Question
from ablate.command.compose import jobs_of
from ablate.metrics import METRICS
from ablate.networks import GeneratorSpec
from ablate.settings import components as declared
from ablate.settings.components import components, components_of_networks
from ablate.settings.conf import keys, variant_names
from ablate.settings.study import StudySettings
from ablate.training import AdversarialLoss
from ablate.ultrasound import SimulatorSettings, TimeGain


@cache
def composed() -> dict[str, GeneratorSpec]:
    """The generator of every variant, composed at once."""
    jobs = jobs_of(["-m", f"variant={','.join(variant_names())}", "preset=paper"])
    return {job.settings.variant: job.settings.model for job in jobs}


def spec(variant: str) -> GeneratorSpec:
    return composed()[variant]


def test_the_paper_preset_is_the_defaults_of_the_code() -> None:
    """But for the time gain, which is the patient's in every preset. Crop and levels follow from the frame size."""
    (job,) = jobs_of(["preset=paper"])
    assert job.settings == StudySettings(simulator=SimulatorSettings(tgc=TimeGain.patient))


def test_ablations_equal_the_generated_leave_one_out() -> None:
    """A component needs no file of its own in conf/variant; where it has one, that switches nothing else."""
    ablations = {f"sa2h-{c.name}": {field: c.off} for field, c in components_of_networks().items()}
    of_files = ablations.keys() & set(variant_names())
    assert len(of_files) >= 5
    for name in of_files:
        assert dataclasses.replace(spec("sa2h"), **ablations[name]) == spec(name)


def test_components_name_levels_and_metrics_that_exist() -> None:
    allowed = keys()
    for component in components():
        setting = allowed[component.key]
        for level in (*component.levels_on, component.off):
            assert level in tuple(setting.kind) if isinstance(level, str) else setting.declared.holds(level)
        assert component.metric in METRICS
        assert component.band


def test_the_page_of_the_networks_prints_the_components_as_their_files_are() -> None:
    page = (Path(__file__).parents[2] / "docs" / "networks.md").read_text()
    printed = page.split("| component | key |")[1].split("\n\n")[0].splitlines()[2:]

    def levels(names: tuple[object, ...]) -> str:
        return ", ".join(map(str, names)).replace(f", {names[-1]}", f" or {names[-1]}")

    def row(c: Component) -> str:
        cells = (c.name, f"`{c.key}`", levels(c.levels_on), c.off, c.question, f"`{c.metric}`")
        return f"| {' | '.join(map(str, cells))} |"

    rows = {row(c) for c in components()}
    assert len(printed) >= 6
    assert rows.issuperset(printed)


def test_a_variant_without_a_discriminator_is_sa2h_but_for_its_loss() -> None:
    with_one, without = (job.settings for job in jobs_of(["-m", "variant=sa2h,sa2h-gan", "preset=paper"]))
    training = dataclasses.replace(with_one.training, loss=AdversarialLoss.none)
    assert without == dataclasses.replace(with_one, variant="sa2h-gan", training=training)


def test_one_key_has_one_file_of_a_component(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The level of the last file once decided which runs have the component of the first."""
    monkeypatch.setattr(declared, "conf_folder", lambda: tmp_path)
    (tmp_path / "component").mkdir()

    def declare(**levels: str) -> None:
        for name, lines in levels.items():
            (tmp_path / "component" / f"{name}.yaml").write_text(f"key: model.attenuation\n{lines}\n")

    declare(att="on: [illumination, integral]\noff: none", gain="on: compensated\noff: integral")
    assert [component.name for component in components()] == ["att", "gain"]
    for twin in ("on: integral\noff: none", "on: none\noff: illumination", "purpose: any"):
        declare(gain=twin)
        with pytest.raises(
            ValueError, match=r"gain\.yaml: key=model\.attenuation is declared by .*att\.yaml with the same"
        ):
            components()


def test_a_study_has_the_components_that_were_registered_for_it() -> None:
    """And today's, where nothing else is said of one."""
    registered = {component.name: component for component in components("full_model")}
    today = {component.name: component for component in components()}
    assert today.keys() - registered.keys() == {"lattice", "properties"}
    assert (registered["encoding"].on, registered["encoding"].off) == ("properties", "arbitrary")
    assert (today["encoding"].on, today["encoding"].off) == ("echogenicity", "arbitrary")
    assert {component.question for component in registered.values()} == {Question.earns}
    assert {name for name, component in today.items() if component.question is Question.saves} == {"depth", "space"}
    assert {component.share for component in registered.values()} == {None}, "its bands are in units of the metrics"
    bands = {"shadow_contrast": 3.0, "thin_contrast": 2.5, "mae_smooth": 1.0, "pchi2_tissue": 0.005}  # docs/study.md
    bands |= {"octave_sd": 0.4, "nyquist_excess": 0.4}
    assert {component.metric: component.band for component in registered.values()} == bands
    assert components("any other") == components()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("gone: {share: null}", "mine.yaml: gone is no file of conf/component"),
        ("att: {wrong: 1}", "mine.yaml: att: .*wrong"),
        ("att: 3", "mine.yaml: att=3: allowed are null and values as in conf/component"),
        ("- att", "registered/mine.yaml: holds no keys"),
    ],
)
def test_what_was_registered_wrongly_is_named(
    text: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "component").mkdir()
    (tmp_path / "registered").mkdir()
    (tmp_path / "component" / "att.yaml").write_text("key: model.attenuation\n")
    (tmp_path / "registered" / "mine.yaml").write_text(text)
    monkeypatch.setattr(declared, "conf_folder", lambda: tmp_path)
    with pytest.raises(ValueError, match=said):
        components("mine")
