"""What a run was made with is kept of every start, so that one that went on with other code can be told."""

import json
import logging
import re
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch

from ablate.command.compose import jobs_of
from ablate.study import provenance
from ablate.study.job import Job, claim
from ablate.study.provenance import end_provenance, write_provenance
from ablate.study.source_code import package_digest
from ablate.study.training import Training
from ablate.study.work import _logged
from support.finished_runs import WHOLE


@pytest.fixture
def job(tmp_path: Path) -> Job:
    (made,) = jobs_of([f"runs_dir={tmp_path}", "training.threads=1"])
    claim(made)
    return made


def start(job: Job) -> None:
    """What a process that begins to train writes."""
    write_provenance(job, Training(job.folder))


def code(monkeypatch: pytest.MonkeyPatch, commit: str, diff: str = "") -> None:
    """The repository is at this commit, with these changes."""
    state = {"git_commit": commit, "git_dirty": str(bool(diff)).lower(), "git_diff": diff}
    monkeypatch.setattr(provenance, "git_state", lambda: dict(state))


def stored(job: Job, name: str) -> Any:
    return json.loads((job.folder / "provenance" / name).read_text())


def stopped_at(job: Job, step: int) -> None:
    torch.save({"steps_done": step}, job.folder / "last.ckpt")


def test_every_start_is_listed_and_the_report_names_all_commits(
    job: Job, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        code(monkeypatch, "aaa", "+one\n")
        start(job)
        stopped_at(job, 40)
        start(job)
        assert not caplog.messages, "the same code"
        code(monkeypatch, "bbb")
        (again,) = jobs_of([f"runs_dir={job.settings.results}", "training.threads=2"])
        stopped_at(job, 60)
        start(again)
    (warning,) = caplog.messages
    assert warning.startswith("step 60: training goes on with other code or hardware (git_commit aaa, now bbb")
    assert "threads 1, now 2" in warning
    starts = stored(job, "starts.json")["starts"]
    assert [(s["git_commit"], s["step"], s["threads"]) for s in starts] == [
        ("aaa", 0, 1),
        ("aaa", 40, 1),
        ("bbb", 60, 2),
    ]
    assert starts[-1]["command"] == f"python -m ablate runs_dir={job.settings.results} training.threads=2"
    assert ["git_diff" in s for s in starts] == [True, True, False]
    about = stored(job, "made_with.json")
    assert (about["git_commit"], about["git_dirty"], about["threads"]) == ("aaa, bbb", "true", "1, 2")
    assert about["torch"].partition("+")[0] == torch.__version__.partition("+")[0]  # 2.13.0, of whatever build
    assert job.training.made_with["git_commit"] == "aaa, bbb"


def test_a_change_of_uncommitted_code_alone_is_told(
    job: Job, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    for diff in ("+one\n", "+two\n"):
        code(monkeypatch, "aaa", diff)
        start(job)
        stopped_at(job, 40)
    assert "step 40: training goes on with other code or hardware (git_diff" in caplog.text
    kept = sorted((job.folder / "provenance").glob("uncommitted*.diff"))
    assert {path.read_text() for path in kept} == {"+one\n", "+two\n"}
    assert (job.folder / "provenance" / "uncommitted.diff").read_text() == "+two\n"


def test_changed_code_is_told_where_the_package_lies_in_no_repository(
    job: Job, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    package = tmp_path / "site-packages" / "ablate"
    (package / "training").mkdir(parents=True)
    monkeypatch.setattr(provenance, "git_state", lambda: {})
    for name in ("loaded_digest", "package_digest"):  # of processes that have just begun
        monkeypatch.setattr(provenance, name, partial(package_digest, package))
    for line in ("LOSS = 1\n", "LOSS = 1\n", "LOSS = 2\n"):
        assert not caplog.messages
        (package / "training" / "module.py").write_text(line)
        start(replace(job, source=package_digest(package)))
        stopped_at(job, 40)
    assert "step 40: training goes on with other code or hardware (source " in caplog.text


@pytest.mark.parametrize("at_start", [True, False], ids=["before it began", "as it trained"])
def test_files_that_change_under_a_process_are_not_what_it_trained_by(
    job: Job, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, at_start: bool
) -> None:
    code(monkeypatch, "aaa")
    assert job.source == package_digest(), "nobody edits this checkout now"
    files = {False: job.source, True: "later"}
    monkeypatch.setattr(provenance, "package_digest", lambda: files[at_start])
    start(job)
    monkeypatch.setattr(provenance, "package_digest", lambda: "later")
    (note,) = end_provenance(Training(job.folder))
    (start_,) = stored(job, "starts.json")["starts"]
    assert (start_["source"], start_["source_at_end"]) == (job.source, "later")
    assert ("source_at_start" in start_, "git_commit" in start_) == (at_start, not at_start), "no commit of other files"
    assert note.startswith(f"It was trained by source {job.source} of ablate")
    assert [m for m in caplog.messages if "the code of ablate changes" in m] == [
        f"the code of ablate changes while the command runs: the files are of source later now, "
        f"and this job runs by {job.source}"
    ]


def test_a_process_that_loads_other_files_than_its_command_says_so(
    job: Job, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    code(monkeypatch, "bbb")
    for name in ("loaded_digest", "package_digest"):
        monkeypatch.setattr(provenance, name, lambda: "later")
    start(job)
    (start_,) = stored(job, "starts.json")["starts"]
    assert (start_["source"], start_["source_of_command"], start_["git_commit"]) == ("later", job.source, "bbb")
    assert f"this job runs by source later, and its command began with {job.source}" in caplog.text
    (note,) = end_provenance(Training(job.folder))
    assert f"(later, {job.source})" in note


def test_nothing_is_said_of_files_that_stay(job: Job, caplog: pytest.LogCaptureFixture) -> None:
    start(job)
    assert end_provenance(Training(job.folder)) == []
    assert not caplog.messages
    assert "source_at_end" not in stored(job, "starts.json")["starts"][0]


def test_a_finished_training_that_is_scored_again_goes_on_with_nothing(
    job: Job, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    code(monkeypatch, "aaa")
    start(job)
    stopped_at(job, 60)
    job.training.write_result(WHOLE)
    code(monkeypatch, "bbb")
    start(job)
    assert not caplog.messages
    assert stored(job, "made_with.json")["git_commit"] == "aaa, bbb"


def test_minimal_provenance_has_no_changes_and_no_environment(job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    (minimal,) = jobs_of([f"runs_dir={job.settings.results}", "tracking.provenance=minimal"])
    assert minimal.hash == job.hash
    for diff in ("+canary one\n", "+canary two\n"):
        code(monkeypatch, "aaa", diff)
        start(job)
    monkeypatch.setattr(provenance, "environment", lambda: "canary==1\n")
    start(job)
    start(minimal)
    files = {path.name: path.read_text() for path in (job.folder / "provenance").iterdir()}
    assert files.keys() == {"config.json", "made_with.json", "starts.json"}
    assert not any("canary" in text for text in files.values())
    assert job.training.starts[-1]["git_commit"] == "aaa"


@pytest.mark.parametrize("quiet", [True, False])
def test_a_run_has_a_log_with_times_and_levels(job: Job, quiet: bool, capsys: pytest.CaptureFixture[str]) -> None:
    (job,) = jobs_of([f"runs_dir={job.settings.results}", *(["verbose=quiet"] if quiet else [])])
    host = logging.NullHandler()
    logging.getLogger().addHandler(host)
    try:
        with suppress(KeyboardInterrupt), _logged(job, job.folder):
            logging.getLogger("ablate.training").info("step 1 of 2")
            logging.getLogger("ablate.training").info("step 2 of 2", extra={"in_bar": True})
            logging.getLogger("ablate.training").warning("bad")
            logging.getLogger("matplotlib").info("of a library")
            raise KeyboardInterrupt("Ctrl-C\n of somebody")
        logging.getLogger("ablate.study").warning("of no training")
        assert host in logging.getLogger().handlers, "the program around it keeps its own"
        assert not logging.getLogger("ablate").handlers
    finally:
        logging.getLogger().removeHandler(host)
    printed = capsys.readouterr().err.replace(f"{job.name}: ", "").splitlines()
    assert printed == [*([] if quiet else ["step 1 of 2"]), "bad"], "a bar shows the second step"
    first, second, third, last = (job.folder / "log.txt").read_text().splitlines()
    assert re.fullmatch(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d,\d{3} INFO ablate.training: step 1 of 2", first)
    assert second.endswith(" INFO ablate.training: step 2 of 2")
    assert third.endswith(" WARNING ablate.training: bad")
    assert last.endswith(" ERROR ablate.study.work: stopped by KeyboardInterrupt: Ctrl-C of somebody")
