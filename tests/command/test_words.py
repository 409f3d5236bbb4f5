"""What people type is taken as it is meant, or refused in one line that says what to type."""

import re
import unicodedata
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ablate.command.compose import jobs_of
from ablate.command.composed import composed, parsed
from ablate.command.words import OPTIONS, readable
from ablate.setting import check_name
from ablate.settings.conf import keys, unknown_key
from ablate.settings.study import ConfigurationError
from ablate.tasks.entry import execute

LAST_PARTS = sorted({key.rpartition(".")[2] for key in keys() if "." in key})

REFUSED = [
    (["--preset", "tiny"], "--preset: a setting is typed without dashes: preset=tiny"),
    (["--preset=tiny"], "--preset: a setting is typed without dashes: preset=tiny"),
    (["-preset", "tiny"], "-preset: a setting is typed without dashes: preset=tiny"),
    (["--learning-rate", "1e-3"], "typed without dashes: training.learning_rate=1e-3"),
    (["--training.steps=5", "-m"], "typed without dashes: training.steps=5"),
    (["--gpus", "2"], "--gpus: no such option; allowed are key=value and --help"),
    (["study=leave_one_out"], "type +study=leave_one_out"),
    (["-m", "study=leave_one_out"], "type +study=leave_one_out"),
    (["seed=-1"], "seed=-1: allowed are whole numbers from 0"),
    (["seed=-1", "training.seed=3"], "seed=-1: allowed are whole numbers from 0"),
    (["training.steps=1e3"], "training.steps=1e3: allowed are whole numbers from 1; type training.steps=1000"),
    (["-m", "training.steps=1e3,2e3"], "type training.steps=1000"),
    (["training.steps=20.0"], "type training.steps=20"),
    (["dataset.frames=1.5"], "dataset.frames=1.5: allowed are whole numbers from 1"),
    (["training.steps=many"], "training.steps=many: allowed are whole numbers from 1"),
    (["dataset.split=frames"], "dataset.split=frames: allowed are site, frame"),
    (["training.learning_rate=0,001"], "type training.learning_rate=0.001"),
    (["-m", "training.learning_rate=0,001"], "type training.learning_rate=0.001"),
    (["-m", "training.l1_weight=10,05"], "type training.l1_weight=10.05"),
    (["training.beta1=0,9"], "type training.beta1=0.9"),
    (["-m", "training.beta1=0,9"], "type training.beta1=0.9"),
    (["-m", "training.steps=1,000"], "type training.steps=1000"),
    (["-m", "hydra/sweeper=optuna"], "pip install hydra-optuna-sweeper"),
    (["-m", "hydra/sweeper=optuna", "hydra.sweeper.n_trials=2", "seed=range(0,3)"], "pip install hydra-optuna-sweeper"),
    (["scene.folder=/x", "task=plan"], "scene.folder='/x': the built-in anatomy has no folder; add scene=folder"),
    (["-m", "scene.folder=/x,/y"], "scene.folder='/x': the built-in anatomy has no folder"),
    (["study_name=a:b"], "not ':'"),
    (["variant=[sa2h,nsa2h]"], "variant=[sa2h,nsa2h]: allowed is one for each job; type -m variant=sa2h,nsa2h"),
    (["-m", "variant=[sa2h,nsa2h],[full]"], "allowed is one for each job"),
    (["-m", "+study=[leave_one_out,encoding]"], "allowed is one for each job"),
    (["scene=[fetal,folder]"], "allowed is one for each job"),
    (
        ["~tracking"],
        "~tracking: a setting cannot be removed, but have another value: tracking.NAME=..., where NAME is one of",
    ),
    (["~seed"], "have another value: seed= whole numbers from 0"),
    (["~preset"], "have another value: preset= one of fine, laptop, "),
    (["~training.steps=6"], "have another value: training.steps= whole numbers from 1"),
    (["+variant=nsa2h"], "+variant: one is chosen already; type variant= one of "),
    (["++variant=nsa2h"], "+variant: one is chosen already; type variant= one of "),
    (["variant="], "variant=: allowed are custom, "),
    (["VARIANT=nsa2h"], "did you mean 'variant'?"),
    (["training/learning_rate=1e-3"], "did you mean 'training.learning_rate'?"),
    (["training[steps]=3"], "did you mean 'training.steps'?"),
    (["lr=1e-3"], "did you mean 'training.learning_rate'?"),
    (["training.lr=1e-3"], "did you mean 'training.learning_rate'?"),
    (["epochs=3"], "unknown key 'epochs'; allowed"),
    (["simulator.probe.frequency_mhz=5"], "did you mean 'probe.frequency_mhz'?"),
    (["seed=[0,1]"], "seed=[0,1]: allowed are whole numbers from 0; for several jobs, type -m seed=0,1"),
    (["seed=(0,1)"], "give it as seed= whole numbers from 0"),
    (["training.learning_rate=10^-3"], "give it as training.learning_rate= numbers above 0"),
    (["model={noise=input}"], "give it as model."),
    (["metrics=[psnr,", "mae]"], "give it without blanks, and every bracket closed"),
    (["metrics=psnr,mae"], "add -m, or type metrics=[psnr,mae]"),
    (["simulator.image_shape=400,600"], "add -m, or type simulator.image_shape=[400,600]"),
    (["-m", "variant=lsa2h,", "nsa2h"], "without the comma at its end, or the blank after it"),
    (["variant", "=", "nsa2h"], "no blank beside ="),
    (["training=quick"], "training: a group of settings; allowed are training."),
    (["tracking=null"], "tracking: a group of settings; allowed are tracking."),
    (["--config-path", "mine"], "--config-dir=FOLDER adds your files"),
    (["--config-name", "mine"], "--config-dir=FOLDER adds your files"),
    (["-m", "hydra/sweeper=basic", "seed=range(0,0)"], "-m: a sweep without a job"),
    (["preset=tiny", "+preset=quick"], "+preset: one is chosen already; type preset= one of "),
    (["+variant=nsa2h", "variant=sa2h"], "+variant: one is chosen already; type variant= one of "),
    (["+study=ladder", "study=noise"], "+study: one is chosen already; type study= one of "),
    (["seeds=0,1"], "'seeds=0,1' asks for several jobs: add -m; unknown key 'seeds'; did you mean 'seed'?"),
    (["model.dpeth=1,2"], "add -m; unknown key 'model.dpeth'; did you mean 'model.depth'?"),
    (["\N{EN DASH}m", "preset=tiny"], "\N{EN DASH}m: begins with a long dash; type -m"),
    (["\N{EM DASH}cfg", "job"], "begins with a long dash; type -cfg"),
    (["--cfg"], "--cfg: nothing follows it; allowed are job, hydra, all"),
    (["--cfg", "jobs"], "--cfg jobs: allowed are job, hydra, all; did you mean job?"),
    (["--cfg=preset"], "--cfg preset: allowed are job, hydra, all"),
    (["--cfg", "preset=tiny"], "--cfg: nothing follows it"),
    (["--info", "foo"], "--info foo: allowed are all, config, "),
    (["-cn"], "-cn: nothing follows it; allowed are a name or a path"),
    (["preset=tiny", "--package", "training"], "--package names what --cfg shows: add --cfg job"),
    (["study_name=x\u030c"], "not U+030C (Unicode: combining caron)"),
]


@pytest.mark.parametrize(("arguments", "words"), REFUSED, ids=[" ".join(a)[:40] for a, _ in REFUSED])
def test_a_slip_is_answered_with_what_to_type(
    arguments: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigurationError) as error:
        execute(arguments)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", LAST_PARTS)
def test_a_key_without_its_group_is_answered_with_every_key_that_it_may_be(name: str) -> None:
    full = [key for key in keys() if key.rpartition(".")[2] == name]
    said = unknown_key(name)
    assert all(re.search(rf"\b{re.escape(key)}\b", said) for key in full)
    wrong_group = "viewer" if not any(key.startswith("viewer.") for key in full) else "model"
    assert full[0] in unknown_key(f"{wrong_group}.{name}")


@settings(max_examples=60, deadline=None)
@given(
    key=st.sampled_from([key for key in keys() if len(key.rpartition(".")[2]) > 4]),
    place=st.integers(1, 4),
    data=st.data(),
)
def test_a_letter_that_is_missing_is_found(key: str, place: int, data: st.DataObject) -> None:
    group, _, last = key.rpartition(".")
    typed = last[:place] + last[place + 1 :]
    if any(other.rpartition(".")[2] == typed for other in keys()):
        return
    prefix = data.draw(st.sampled_from([f"{group}.".lstrip("."), ""]))
    assert "did you mean" in unknown_key(f"{prefix}{typed}")


PATHS = ("scene.folder", "runs_dir", "pose", "runs", "dataset.poses", "evaluation.inception")


@pytest.mark.parametrize("key", PATHS)
def test_a_tilde_is_the_home_of_the_user(key: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/anna")
    task = {"pose": "render", "runs": "view"}.get(key, "study")
    (job,) = jobs_of([f"task={task}", f"{key}=~/own/x"])
    group, _, name = key.rpartition(".")
    assert getattr(getattr(job.settings, group) if group else job.settings, name) == "/home/anna/own/x"
    assert keys()[key].declared.is_path


def test_what_hydra_writes_goes_to_the_home_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/anna")
    assert composed(readable(["runs_dir=~/r"])).hydra.sweep.dir == "/home/anna/r/.hydra"


def test_variables_of_the_environment_are_filled_in(monkeypatch: pytest.MonkeyPatch) -> None:
    """A number of SLURM's in a number; a path in single quotes or in a file, which no shell has read."""
    monkeypatch.setenv("HERE", "/home/anna")
    monkeypatch.setenv("NUMBER", "5")
    (job,) = jobs_of(["runs_dir=$HERE/r", "seed=${oc.env:NUMBER}", "training.steps=${oc.env:NUMBER}"])
    assert job.settings.runs_dir == "/home/anna/r"
    assert (job.settings.seed, job.settings.training.seed, job.settings.training.steps) == (5, 5, 5)
    assert composed(["runs_dir=$HERE/r"]).hydra.sweep.dir == "/home/anna/r/.hydra"


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("training: {stepz: 5}", "In 'mine': unknown key 'training.stepz'; did you mean 'training.steps'?"),
        ("seed: many", "seed=many: allowed are whole numbers from 0"),
    ],
)
def test_a_slip_in_a_file_is_answered_as_one_on_the_command_line(tmp_path: Path, line: str, said: str) -> None:
    (tmp_path / "mine.yaml").write_text(f"defaults: [config, _self_]\n{line}\n")
    with pytest.raises(ConfigurationError) as error:
        execute(["preset=tiny", "--config-dir", str(tmp_path), "--config-name", "mine"])
    assert said in str(error.value)


NAMES = st.text(st.characters(codec="utf-8", categories=("Ll", "Lu", "Lo", "Nd")), min_size=1, max_size=12)


@settings(max_examples=60, deadline=None)
@given(name=NAMES)
def test_a_name_of_any_letters_is_taken_as_it_is_typed(name: str) -> None:
    """In every form of Unicode that a keyboard or macOS gives."""
    whole = unicodedata.normalize("NFC", name)
    try:
        check_name("study_name", whole)
    except ValueError:
        return
    if whole in ("null", "true", "false") or whole.isascii():
        return
    for form in ("NFC", "NFD"):
        typed = unicodedata.normalize(form, whole)
        (word,) = readable([f"study_name={typed}"])
        assert parsed([word])[0].value() == typed


@pytest.mark.parametrize("form", ["NFC", "NFD"])
def test_both_forms_of_a_name_are_one_study(form: str) -> None:
    (job,) = jobs_of([f"study_name={unicodedata.normalize(form, 'fünf')}"])
    assert job.settings.study == unicodedata.normalize("NFC", "fünf")


def test_the_options_are_those_of_hydra(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["--hydra-help"]) == 0
    flags = capsys.readouterr().out.partition("Flags")[2] or "--help"
    named = set(re.findall(r"(?<![\w-])--?[a-z][a-z-]*(?=[ ,\n])", flags))
    assert named <= OPTIONS.keys() | {"--"}


@pytest.mark.parametrize(
    "typed",
    [
        ["preset=tiny", "--config-name", "mine", "seed=0,1", "-m"],
        ["-m", "preset=tiny", "--config-name", "mine", "seed=0,1"],
        ["--config-name", "mine", "preset=tiny", "-m", "seed=0,1"],
    ],
)
def test_settings_and_options_come_in_any_order(typed: list[str]) -> None:
    read = readable(typed)
    assert read[:2] == ["preset=tiny", "seed=0,1"]
    assert read[read.index("--config-name") + 1] == "mine"


def test_what_follows_an_option_is_no_setting() -> None:
    assert readable(["--info", "searchpath"]) == ["--info", "searchpath"]
    assert readable(["--info", "preset=tiny"]) == ["preset=tiny", "--info"]
