"""Files of the user's own that a command starts from or sweeps over count as what is typed does."""

import logging
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ablate.command.compose import cells, jobs_of
from ablate.command.composed import parsed
from ablate.command.launch import Launch
from ablate.settings.study import ConfigurationError
from ablate.study.job import Job
from ablate.tasks import entry
from ablate.tasks.entry import execute

Asked = Callable[..., list[Job]]

PRIMARY = "defaults:\n  - config\n  - _self_\nseed: 7\ntraining: {steps: 4}\n"


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Asked]:
    """The jobs that the program makes of a command line, whoever launches them; nothing is started."""
    root = logging.getLogger()
    before, level = [*root.handlers], root.level

    def call(*arguments: str) -> list[Job]:
        found: list[Job] = []

        def do(jobs: Sequence[Job], _: Launch) -> int:
            found.extend(jobs)
            return 0

        monkeypatch.setattr(entry, "_do", do)
        monkeypatch.chdir(tmp_path)  # a primary file that was saved has Hydra's own folder, outputs/
        assert execute(["--config-dir", str(tmp_path), *arguments, "task=plan"]) == 0
        return found

    yield call
    for handler in {*root.handlers} - {*before}:  # Hydra's own, of a primary file that was saved
        root.removeHandler(handler)
        handler.close()
    root.setLevel(level)


@pytest.mark.parametrize("launcher", ["processes", "basic"])
def test_a_primary_file_counts_in_every_job_of_a_sweep(asked: Asked, tmp_path: Path, launcher: str) -> None:
    (tmp_path / "mine.yaml").write_text(PRIMARY)
    own = ["--config-name", "mine", "preset=tiny"]
    (alone,) = asked(*own)
    swept = asked(*own, "-m", f"hydra/launcher={launcher}", "variant=sa2h,nsa2h")
    assert [job.name for job in (alone, *swept)] == ["sa2h/seed7", "sa2h/seed7", "nsa2h/seed7"]
    assert {job.settings.training.steps for job in (alone, *swept)} == {4}
    assert swept[0].hash == alone.hash


@pytest.mark.parametrize(
    ("lines", "arguments", "labels"),
    [
        ("model: {depth: 3}", [], ["sa2h.depth-3"]),
        ("model: {depth: 3}", ["model.depth=2"], ["sa2h.depth-2"]),
        ("model: {depth: 3}", ["-m", "variant=sa2h,sa2h-att"], ["sa2h.depth-3", "sa2h-att.depth-3"]),
        (
            "model: {depth: 3}",
            ["-m", "model.noise=none,input"],
            ["sa2h.depth-3.noise-none", "sa2h.depth-3.noise-input"],
        ),
        ("encoding: arbitrary\nseed: 2", ["variant=nsa2h"], ["nsa2h.encoding-arbitrary"]),
        ("training: {loss: minimax, steps: 9}", [], ["sa2h.loss-minimax"]),
    ],
)
def test_a_label_says_what_a_primary_file_changes(
    asked: Asked, tmp_path: Path, lines: str, arguments: list[str], labels: list[str]
) -> None:
    """As it does where the same is typed."""
    (tmp_path / "mine.yaml").write_text(f"defaults:\n  - config\n  - override preset: tiny\n  - _self_\n{lines}\n")
    assert [job.label for job in asked("--config-name", "mine", *arguments)] == labels


def test_a_configuration_that_was_saved_is_the_job_that_it_was_saved_from(
    asked: Asked, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert execute(["preset=tiny", "variant=nsa2h", "--cfg", "job"]) == 0
    (tmp_path / "saved.yaml").write_text(capsys.readouterr().out)
    (saved,) = asked("--config-name", "saved")
    (typed,) = jobs_of(["preset=tiny", "variant=nsa2h"])
    assert (saved.label, saved.hash) == (typed.label, typed.hash)
    (changed,) = asked("--config-name", "saved", "model.depth=2")
    assert changed.label == "nsa2h.depth-2"


STARTS = "  - override /hydra/launcher: basic\n"
OF_FILES = {
    "launcher": (STARTS, "", []),
    "its settings": ("", "hydra: {launcher: {n_jobs: 3}}\n", []),
    "settings of another": ("", "hydra: {launcher: {n_jobs: 3}}\n", ["hydra/launcher=joblib"]),
    "sweeper": ("  - override /hydra/sweeper: basic\n", "", []),
}


@pytest.mark.parametrize("what", OF_FILES)
def test_what_starts_all_jobs_is_not_chosen_by_one_of_them(asked: Asked, tmp_path: Path, what: str) -> None:
    chosen, more, typed = OF_FILES[what]
    (tmp_path / "variant").mkdir()
    text = f"# @package _global_\ndefaults:\n  - sa2h\n{chosen}variant: own\n{more}"
    (tmp_path / "variant" / "own.yaml").write_text(text)
    with pytest.raises(ConfigurationError, match=r"^variant=own: a file chooses hydra/.*type both beside -m$"):
        asked("-m", "variant=sa2h,own", *typed)


def test_a_file_that_is_not_swept_chooses_the_launcher(
    asked: Asked, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "study").mkdir()
    (tmp_path / "study" / "own.yaml").write_text(f"# @package _global_\ndefaults:\n{STARTS}")
    monkeypatch.setattr(entry, "run_sweep", lambda *_: pytest.fail("not by our launcher"))
    assert len(asked("-m", "+study=own", "seed=0,1")) == 2


def test_a_folder_of_hydra_for_each_job_is_refused(asked: Asked) -> None:
    for words in (["hydra.job.chdir=true"], ["-m", "hydra.job.chdir=true", "seed=0,1"]):
        with pytest.raises(ConfigurationError, match=r"^hydra\.job\.chdir=true: allowed is false"):
            asked(*words)


WORDS = st.sampled_from(
    ["model={depth:3}", "model={noise:input}", "model={noise:none,depth:2}", "model.depth=4", "model.noise=input",
     "training={steps:3}", "training.steps=5", "seed=2", "seed=3", "variant=sa2h-att", "model={}"]
)  # fmt: skip


def set_one_after_another(words: Sequence[str]) -> dict[str, object]:
    """What is left when every word sets its keys."""
    values: dict[str, object] = {}
    for override in parsed(words):
        value = override.value()
        group = override.key_or_group
        values |= {f"{group}.{k}": v for k, v in value.items()} if isinstance(value, dict) else {group: value}
    return values


@given(words=st.lists(WORDS, max_size=6))
def test_a_sweep_of_one_job_sets_what_the_job_alone_does(words: list[str]) -> None:
    """As Hydra reads them without `-m`: each word sets its keys, the last counts."""
    (line,) = cells(None, words)
    assert set_one_after_another(line) == set_one_after_another(words)


def test_groups_of_keys_are_swept_beside_each_other() -> None:
    jobs = jobs_of(
        ["-m", "preset=tiny", "model={depth:3},{depth:2}", "model={noise:input}", "training={steps:7},{steps:8}"]
    )
    assert [(job.settings.model.depth, job.settings.training.steps) for job in jobs] == [(3, 7), (3, 8), (2, 7), (2, 8)]
    assert {job.settings.model.noise.name for job in jobs} == {"input"}
    assert len({job.label for job in jobs}) == 4
    (together,) = jobs_of(["-m", "preset=tiny", "model={depth:3}", "model={noise:input}"])
    assert together.label == "sa2h.depth-3.noise-input"
