"""What a comparison makes of a study that is whole, and of one that is not: words, never a traceback."""

import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

import ablate
from ablate.analysis import RESIMULATION, find_design
from ablate.comparison.compare import compare_study, write_comparison
from ablate.comparison.frame_times import TIMES, network_of, timed_on
from ablate.comparison.opened import Study
from ablate.comparison.reading import pictures
from ablate.comparison.usable_runs import levels_of, usable_runs
from ablate.metrics import METRICS_VERSION, Metric, choose_metrics, metric_of, registry
from ablate.runs.run import Run, runs_of
from ablate.settings.conf import components
from ablate.settings.study import ConfigurationError, StudySettings
from ablate.storage import digest
from support.finished_runs import WHOLE, timed
from support.studies import Unrendered, study_group

MODEL = {"family": "local", "attenuation": "integral", "concat": "every_level", "upsampling": "texture"}
MODEL |= {"noise": "inject", "depth": 4, "extra_input": "none", "width": 0.25}
VARIANTS = {
    "sa2h": {},
    "sa2h-att": {"attenuation": "none"},
    "sa2h-conv": {"upsampling": "transposed"},
    "nsa2h": {"family": "unet", "extra_input": "noise"},
}
FRAMES, SITES = 24, 8
FACTORS = [component.key for component in components()]
METRICS = ("psnr", "mae", "pchi2", str(components()[0].metric))  # the last one is what `att` is judged by


def write_run(
    study: Path, label: str, seed: int, data: str = "fetal-0", frames: int = FRAMES, anatomy: int = 0
) -> Path:
    """A finished run without its training."""
    rng = np.random.default_rng([seed, *label.encode()])
    folder = study / label / f"seed{seed}"
    folder.mkdir(parents=True)
    rows = [
        {"frame": f, "site": f % SITES, "metric": m, "source": source, "split": split, "value": 20 + k + rng.normal()}
        for k, m in enumerate(METRICS)
        for source in ("model", "resimulation")
        for split in ("test", "validation")
        for f in range(frames)
    ]
    pd.DataFrame(rows).assign(variant=label, seed=seed).to_parquet(folder / "per_image.parquet")
    model = MODEL | VARIANTS.get(label.partition(".")[0], {})
    encoding = {"order": "arbitrary" if ".encoding" in label else "echogenicity"}
    pairs = {"scene": {"anatomy_seed": anatomy}, "dataset": {"frames": frames}}
    loss = "none" if label.startswith("sa2h-gan") else "nonsaturating"
    training = {"steps": 9, "seed": seed, "loss": loss}
    semantic = {"model": model, "encoding": encoding, "data": pairs, "training": training, "seed": seed}
    spec = {"label": label, "hash": digest(semantic), "changed": {}, "semantic": semantic}
    (folder / "spec.json").write_text(json.dumps({**spec, "settings": {"model": model, "seed": seed}}))
    scalars = {"test/fd_speckle": 3.0 + seed, "test/fd_speckle_lower": 2.0, "test/fd_speckle_upper": 5.0 + seed}
    scalars |= {"test/floor_fd_speckle": 0.1, "test/psnr": 20.0, "test/floor_psnr": 22.0}
    scalars |= {"parameters_generator": 1e6, "parameters_discriminator": 2e6}
    result = {**WHOLE, "hash": spec["hash"], "label": label, "seed": seed, "data": data, "scalars": scalars}
    notes = ["FID: no Inception weights were given."]
    (folder / "result.json").write_text(json.dumps({**result, "notes": notes}))
    return folder


@pytest.fixture(autouse=True)
def undrawn(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """No figure is drawn but where a test asks for them, and then none is rendered: tests/analysis looks at them."""
    if "figures" not in request.fixturenames:
        monkeypatch.setattr("ablate.comparison.compare.draw_figures", lambda *_: [])


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ablate.analysis.figures.style.Figure", Unrendered)


@pytest.fixture
def study(tmp_path: Path) -> Path:
    folder = tmp_path / "quick-fetal"
    for label in VARIANTS:
        for seed in (0, 1, 2):
            write_run(folder, label, seed)
    networks = {run.label: network_of(run.spec["semantic"]) for run in runs_of(folder)}
    times = [timed("a machine", networks[label], k + 9.0, k + 10.0, k + 11.0) for k, label in enumerate(VARIANTS)]
    pd.concat(times).to_csv(folder / TIMES, index=False)
    return folder


def compared(study: Path, reference: str = "sa2h") -> tuple[Path, str, str]:
    """Folder of the comparison, its report, and its notes as one text."""
    usable = usable_runs(study, reference)
    notes = write_comparison(Study(study, usable, reference), "a study")
    return study / "comparison", (study / "comparison" / "report.html").read_text(), "\n".join(notes)


def change(folder: Path, **values: object) -> None:
    """Other values in a result.json."""
    path = folder / "result.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | values))


def set_values(folder: Path, metric: str, where: Callable[[pd.DataFrame], pd.Series], value: float) -> None:
    """Other values in a per_image.parquet."""
    table = pd.read_parquet(folder / "per_image.parquet")
    table.loc[(table["metric"] == metric) & (table["source"] == "model") & where(table), "value"] = value
    table.to_parquet(folder / "per_image.parquet")


@pytest.mark.usefixtures("figures")
def test_a_whole_study_gives_every_table_and_figure(study: Path) -> None:
    folder, report, notes = compared(study)
    names = {path.name for path in folder.iterdir()}
    assert names >= {"report.html", "table.csv", "table.tex", "paired.csv", "claims.csv", "effects.csv"}
    assert names >= {"verdicts.csv", "runs.csv"}
    figures = {"verdicts", "boxplots", "seeds", "error_vs_runtime", *(f"boxplot_{m}" for m in METRICS)}
    assert names >= {f"{name}.{kind}" for name in figures for kind in ("png", "pdf")}
    assert not (study / "comparison.partial").exists()
    table = pd.read_csv(folder / "table.csv").set_index("variant")
    assert list(table.index) == [RESIMULATION, "sa2h", "nsa2h", "sa2h-att", "sa2h-conv"]
    assert table.loc["sa2h", "fd_speckle_mean"] == 4.0
    assert (table.loc["sa2h", "fd_speckle_lower"], table.loc["sa2h", "fd_speckle_upper"]) == (2.0, 6.0)
    assert "fd_speckle_lower_mean" not in table, "a bound is no metric"
    runs = pd.read_csv(folder / "runs.csv").set_index("variant")
    assert set(runs.loc["sa2h-att", "model.attenuation"]) == {"none"}
    for name, ms in (("ms_per_frame", 10.0), ("ms_per_frame_lower", 9.5), ("ms_per_frame_upper", 10.5)):
        assert set(runs.loc["sa2h", name]) == {ms}
    assert table.loc["sa2h", "ms_per_frame_sd"] == 0.5
    assert set(pd.read_csv(folder / "effects.csv")["effect"]) == {"model.attenuation", "model.upsampling"}
    claims = pd.read_csv(folder / "claims.csv")
    assert set(claims["metric"]) == {*METRICS, "fd_speckle"}
    assert set(claims["seeds"]) == {3}
    assert "one change at a time around sa2h" in report
    assert report.count("FID: no Inception weights were given.") == 1
    assert "There are no pictures: the runs kept no frame in common." in notes


def test_an_opened_study_is_tables_and_says_nothing_of_what_a_network_of_the_user_lacks(
    study: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = {"family": "custom", "concat": "input", "upsampling": "transposed", "noise": "none"}
    monkeypatch.setitem(VARIANTS, "Mine", own)
    write_run(study, "Mine", 0)
    opened = ablate.open_study(study)
    assert len(opened.runs) == 3 * (len(VARIANTS) - 1) + 1
    runs = opened.runs.set_index(["variant", "seed"])
    assert runs.loc[("Mine", 0), ["model.concat", "model.upsampling", "model.depth"]].isna().all()
    assert list(runs.loc[("Mine", 0), ["model.attenuation", "model.noise"]]) == ["integral", "none"]
    assert list(runs.loc[("sa2h", 0), ["model.concat", "model.depth"]]) == ["every_level", 4]
    frames = opened.per_image.query("variant == 'sa2h' and seed == 0 and metric == 'psnr'")["value"]
    assert runs.loc[("sa2h", 0), "psnr"] == pytest.approx(frames.mean())
    again = opened.per_image.query(f"variant == '{RESIMULATION}' and metric == 'psnr'")["value"]
    assert opened.floor.loc["psnr", "mean"] == pytest.approx(again.mean())
    assert set(opened.verdicts["component"]) == {component.name for component in components()}
    with pytest.raises(FileNotFoundError, match="There is no finished study at nowhere"):
        ablate.open_study("nowhere")


def test_runs_without_a_discriminator_tell_its_effect_and_leave_the_others(study: Path) -> None:
    before = pd.read_csv(compared(study)[0] / "effects.csv").set_index(["metric", "effect"])
    for seed in (0, 1, 2):
        write_run(study, "sa2h-gan", seed)
    folder, _, _ = compared(study)
    assert "sa2h-gan" in set(pd.read_csv(folder / "paired.csv")["variant"])
    after = pd.read_csv(folder / "effects.csv").set_index(["metric", "effect"])
    assert set(after.index.unique("effect")) - set(before.index.unique("effect")) == {"training.loss"}
    pd.testing.assert_series_equal(after["estimate"].loc[before.index], before["estimate"])
    assert (after["dof"].loc[before.index] == before["dof"] + 2).all()


def test_pictures_without_their_pairs_are_said_to_be_missing(study: Path) -> None:
    for folder in study.glob("*/seed0"):
        np.savez(folder / "pictures.npz", frames=[3], images=np.zeros((1, 40, 60), np.uint8))
    _, report, notes = compared(study)
    assert "There are no pictures: no data set at" in notes
    assert "no data set at" in report


@pytest.mark.usefixtures("figures")
def test_one_variant(tmp_path: Path) -> None:
    alone = tmp_path / "alone"
    write_run(alone, "sa2h", 0)
    folder, report, notes = compared(alone)
    assert "There is one variant, sa2h: nothing is compared." in notes
    assert "nothing is compared" in report
    assert "not claimable" in report
    assert pd.read_csv(folder / "table.csv").shape[0] == 2, "what there is, is shown"
    assert (folder / "seeds.png").exists()
    assert not (folder / "boxplots.png").exists()


@pytest.mark.usefixtures("figures")
def test_a_missing_reference(study: Path) -> None:
    folder, report, notes = compared(study, reference="lsa2h")
    assert "The reference lsa2h is missing" in notes
    assert "The reference lsa2h is missing" in report
    assert (folder / "table.tex").exists()
    assert (folder / "seeds.png").exists()
    assert not (folder / "boxplots.png").exists()
    assert pd.read_csv(folder / "paired.csv").empty


def test_another_anatomy_is_a_block_of_effects_and_no_part_of_any_pair(study: Path) -> None:
    folder, _, _ = compared(study)
    alone = {name: (folder / name).read_text() for name in ("table.csv", "paired.csv", "claims.csv")}
    effects = pd.read_csv(folder / "effects.csv")
    for label in ("sa2h", "sa2h-att", "sa2h-conv"):
        for seed in (3, 4):
            run = write_run(study, label, seed, data="fetal-1", anatomy=1)
            set_values(run, "psnr", lambda t: t["frame"] >= 0, 1000.0 - 5 * (label == "sa2h-att"))
    folder, report, _ = compared(study)
    assert {name: (folder / name).read_text() for name in alone} == alone
    assert (
        "6 runs on another anatomy or data set than fetal-0 take part in effects and verdicts only: sa2h/seed3,"
        in report
    )
    together = pd.read_csv(folder / "effects.csv")
    assert (together["dof"] == effects["dof"] + 6 - 1).all(), "six more runs and one more block"
    shift = together.set_index(["metric", "effect"])["estimate"]["psnr", "model.attenuation"]
    alone_shift = effects.set_index(["metric", "effect"])["estimate"]["psnr", "model.attenuation"]
    # Two differences of two means, over 3 + 3 and over 2 + 2 runs; 900 dB between anatomies are in neither.
    assert shift == pytest.approx((3 * alone_shift + 2 * -5) / 5)


def test_cautions_notes_and_times_are_of_all_runs_that_verdicts_use(study: Path) -> None:
    blocks = [
        write_run(study, label, seed, data="fetal-1", anatomy=1) for label in ("sa2h", "sa2h-att") for seed in (3, 4)
    ]
    set_values(blocks[0], METRICS[-1], lambda t: t["frame"] == 5, np.nan)
    scores = pd.read_parquet(blocks[1] / "per_image.parquet")
    scores[scores["frame"] < 20].to_parquet(blocks[1] / "per_image.parquet")
    change(blocks[0], notes=["3 % of the pixels were clipped."])
    times = pd.read_csv(study / TIMES)
    other = write_run(study, "sa2h.encoding-arbitrary", 3, data="fetal-1", anatomy=1)
    more = timed("a machine", network_of(Run(other).spec["semantic"]), 5.0, 6.0, 7.0)
    later = times.assign(machine="a later machine", ms=99.0)  # of all networks but that of the block
    pd.concat([times, more, later]).to_csv(study / TIMES, index=False)
    folder, report, notes = compared(study)
    for text in (notes, report):
        assert "1 NaN left out (sa2h/seed3 frame 5)" in text
        assert "sa2h/seed4 (20 of 24)" in text
    assert "3 % of the pixels were clipped." in report
    runs = pd.read_csv(folder / "runs.csv").set_index(["variant", "seed"])
    shared = pd.read_parquet(blocks[1] / "per_image.parquet").query("split == 'test' and source == 'model'")
    shared = shared[(shared["metric"] == METRICS[-1]) & (shared["frame"] != 5)]
    assert runs.loc[("sa2h", 4), METRICS[-1]] == pytest.approx(shared["value"].mean())
    opened = ablate.open_study(study)
    assert timed_on(opened.usable.all) == "a machine"
    assert opened.scalars.query("metric == 'ms_per_frame'")["value"].max() < 99, (
        "times are of the machine that is named"
    )
    assert set(opened.per_image["data"]) == {"fetal-0"}
    assert set(opened.blocks["data"]) == {"fetal-1"}


def test_runs_of_different_data_sets(study: Path) -> None:
    shutil.rmtree(study / "nsa2h" / "seed1")
    write_run(study, "nsa2h", 1, data="fetal-1", frames=10, anatomy=1)
    write_run(study, "sa2h-att.encoding-arbitrary", 0, data="fetal-2", frames=12)
    folder, report, notes = compared(study)
    note = "2 runs left aside, made from other pairs than fetal-0: nsa2h/seed1, sa2h-att.encoding-arbitrary/seed0."
    assert note in notes
    assert note in report
    table = pd.read_csv(folder / "table.csv").set_index("variant")
    assert table.loc["nsa2h", "seeds"] == 2
    assert "sa2h-att.encoding-arbitrary" not in table.index
    assert "nsa2h (2)" in notes, "which leaves it too few seeds"


def change_spec(run: Path, **model: object) -> None:
    """Other values of the model in a spec.json, which its hash does not know of."""
    spec = json.loads((run / "spec.json").read_text())
    replace_in_spec(run, semantic=spec["semantic"] | {"model": spec["semantic"]["model"] | model})


def replace_in_spec(run: Path, **parts: object) -> None:
    """Other parts in a spec.json."""
    spec = json.loads((run / "spec.json").read_text())
    (run / "spec.json").write_text(json.dumps(spec | parts))


def replace_in_scores(run: Path, **words: dict[str, str]) -> None:
    """Other words in the columns of a per_image.parquet."""
    table = pd.read_parquet(run / "per_image.parquet")
    table.replace(words).to_parquet(run / "per_image.parquet")


AGAIN = "unreadable ({}: per_image.parquet): start it again"
ANOTHER, SPEC = "with a result of another configuration", "with a spec.json that is damaged, or not what its hash says"
UNUSABLE: dict[str, tuple[Callable[[Path], object], str]] = {
    "scores are not Parquet": (
        lambda run: (run / "per_image.parquet").write_bytes(b"no"),
        AGAIN.format("ArrowInvalid"),
    ),
    "scores are missing": (lambda run: (run / "per_image.parquet").unlink(), AGAIN.format("FileNotFoundError")),
    "a metric that is no name": (
        lambda run: replace_in_scores(run, metric={"mae": "x/../../../stolen"}),
        AGAIN.format("ValueError"),
    ),
    "another version of the metrics": (
        lambda run: change(run, metrics_version=METRICS_VERSION - 1),
        f"scored by version {METRICS_VERSION - 1} of the metrics, not {METRICS_VERSION}: start it again",
    ),
    "a damaged result": (lambda run: (run / "result.json").write_text("{"), "without a usable hash, label, "),
    "a result of another hash": (lambda run: change(run, hash="another"), ANOTHER),
    "a result of another label": (lambda run: change(run, label="other"), ANOTHER),
    "an empty spec": (lambda run: (run / "spec.json").write_text(""), SPEC),
    "a spec without a hash": (lambda run: (run / "spec.json").write_text("{}"), SPEC),
    "a spec that is no mapping": (lambda run: (run / "spec.json").write_text('{"hash": "sa2h0", "semantic": 3}'), SPEC),
    "a spec whose changes are no mapping": (lambda run: replace_in_spec(run, changed="ab"), SPEC),
    "a spec whose changes are a number": (lambda run: replace_in_spec(run, changed=0.5), SPEC),
    "a spec whose settings are a number": (lambda run: replace_in_spec(run, settings=5), SPEC),
    "a spec without a seed": (lambda run: replace_in_spec(run, semantic={}, hash=digest({})), SPEC),
    "a spec that is not what its hash says": (lambda run: change_spec(run, depth={"a": 3}), SPEC),
}


@pytest.mark.parametrize("damage", UNUSABLE)
def test_a_run_that_cannot_be_used_is_left_aside_in_words(study: Path, damage: str) -> None:
    harm, why = UNUSABLE[damage]
    harm(study / "nsa2h" / "seed0")
    (study / "sa2h-conv" / "seed1" / "result.json").unlink()
    usable = usable_runs(study)
    aside, unfinished = usable.notes
    assert (aside[: len(why) + 18], aside[-13:]) == (f"1 run left aside, {why}", " nsa2h/seed0.")
    assert unfinished == "1 run not finished: sa2h-conv/seed1."
    assert len(usable.runs) == len(VARIANTS) * 3 - 2


@pytest.mark.usefixtures("figures")
def test_a_metric_that_is_nan_for_one_frame_or_for_all(study: Path) -> None:
    set_values(study / "nsa2h" / "seed0", "mae", lambda t: (t["frame"] == 5) & (t["split"] == "test"), np.nan)
    for seed in (0, 1, 2):
        set_values(study / "sa2h-att" / f"seed{seed}", "pchi2", lambda t: t["frame"] >= 0, np.nan)
    folder, report, notes = compared(study)
    assert "MAE: 1 NaN left out (nsa2h/seed0 frame 5)." in notes
    paired = pd.read_csv(folder / "paired.csv").set_index(["variant", "metric"])
    assert paired.loc[("nsa2h", "mae"), "n"] == FRAMES - 1
    assert ("sa2h-att", "pchi2") not in paired.index
    assert "±\u00a0nan" not in report
    assert "–" in report
    assert (folder / "boxplot_pchi2.png").exists()
    assert "72 NaNs left out" in report


def test_a_comparison_is_kept_until_what_it_is_made_from_changes(
    study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run that was deleted and trained again has the same hash."""
    (conf := tmp_path / "conf").joinpath("component").mkdir(parents=True)
    conf.joinpath("component", "att.yaml").write_text("band: 1")
    monkeypatch.setattr("ablate.comparison.compare._track", lambda *_: None)
    settings = StudySettings(runs_dir=str(study.parent), study_name=study.name)
    compare_study(settings)
    table, before = study / "comparison" / "table.csv", (study / "comparison" / "table.csv").stat().st_mtime_ns
    compare_study(settings)
    assert table.stat().st_mtime_ns == before
    for changed, to in (("conf_folder", conf), ("tracking.source_digest", "x")):  # another band, or other statistics
        monkeypatch.setattr(f"ablate.comparison.compare.{changed}", lambda to=to: to)
        compare_study(settings)
        assert table.stat().st_mtime_ns > before, changed
        before = table.stat().st_mtime_ns
    set_values(study / "nsa2h" / "seed0", "psnr", lambda t: t["frame"] >= 0, 90.0)
    assert "43." in compare_study(settings)
    assert 43 < pd.read_csv(table).set_index("variant").loc["nsa2h", "psnr_mean"] < 44
    (study / "comparison" / "made_from.json").write_text("")
    table.unlink()
    compare_study(settings)
    assert table.exists()
    (study / "comparison" / "report.html").unlink()
    compare_study(settings)
    assert (study / "comparison" / "report.html").exists()


def test_no_run_at_all_is_one_line_that_says_why(tmp_path: Path) -> None:
    settings = StudySettings(runs_dir=str(tmp_path), study_name="quick-fetal")
    with pytest.raises(ConfigurationError, match=r"quick-fetal holds no finished run to compare\.$"):
        compare_study(settings)
    folder = write_run(tmp_path / "quick-fetal", "sa2h", 0)
    (folder / "result.json").unlink()
    with pytest.raises(ConfigurationError, match=r"1 run not finished: sa2h/seed0\.$"):
        compare_study(settings)


def test_what_was_there_stays_when_a_comparison_fails(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, before, _ = compared(study)

    def broken(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr("ablate.analysis.write_report", broken)
    with pytest.raises(MemoryError):
        compared(study)
    assert (folder / "report.html").read_text() == before


@pytest.mark.parametrize(
    ("group", "name"),
    [
        ("factorial_half", "half of the factorial of 5 components (16 of 32 cells)"),
        ("add_one_in", "one change at a time around"),
        ("encoding", "6 of the 8 cells of 3 components"),
        pytest.param("full_model", "one change at a time around sa2h (12 cells)", marks=pytest.mark.slow),
    ],
)
def test_study_groups_are_recognised_as_the_designs_they_are(group: str, name: str) -> None:
    jobs = study_group(group)
    design = find_design({job.label: levels_of(job.semantic) for job in jobs}, FACTORS)
    assert design is not None
    assert design.name.startswith(name)


def test_a_start_of_noise_that_is_not_injected_and_a_seed_of_training_make_no_other_network(tmp_path: Path) -> None:
    made = {}
    for label, noise, start in (("sa2h", "inject", 0.2), ("sa2h-noise", "input", 0.0), ("sa2h-att", "inject", 0.2)):
        folder = write_run(tmp_path / "s", label, len(made))
        spec = json.loads((folder / "spec.json").read_text())
        spec["semantic"]["model"] |= {"noise": noise, "noise_start": start}
        made[label] = levels_of(spec["semantic"])
    design = find_design(made, FACTORS)
    assert design is not None
    assert (design.factors, set(design.cells.index)) == (["model.attenuation", "model.noise"], set(made))
    made["sa2h-quiet"] = made["sa2h"] | {"model.noise_start": 0.0}
    made["sa2h-long"] = made["sa2h"] | {"training.steps": 99}
    design = find_design(made, FACTORS)
    assert design is not None
    assert set(made) - set(design.cells.index) == {"sa2h-quiet", "sa2h-long"}


def test_a_metric_that_a_result_names_is_not_imported(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A result may come from anybody. A user's own metric has its label where the command names it."""
    monkeypatch.setattr(registry, "_OWN", {})
    for folder in study.glob("*/seed*"):
        change(folder, metrics=["all", "of_a_user.own"])
        table = pd.read_parquet(folder / "per_image.parquet")
        table.assign(metric=table["metric"].replace("mae", "brightness")).to_parquet(folder / "per_image.parquet")
    module = ModuleType("of_a_user")
    module.own = Metric("brightness", label="Brightness error", of_image=lambda _: 0.0)  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "of_a_user", module)
    assert len(usable_runs(study).runs) == 12
    assert metric_of("brightness").label == "brightness"
    choose_metrics(["all", "of_a_user.own"])
    assert metric_of("brightness").label == "Brightness error"


@pytest.mark.parametrize("name", ["pictures.npz", "provenance/made_with.json"])
def test_a_damaged_file_beside_the_scores_stops_nothing(study: Path, name: str) -> None:
    path = study / "sa2h" / "seed0" / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(b"" if name.endswith("npz") else b"\xe9{")
    runs = usable_runs(study).runs
    assert len(runs) == len(VARIANTS) * 3
    assert pictures(runs) == []
