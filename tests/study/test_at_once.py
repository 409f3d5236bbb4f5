"""Two commands at once in one study: one compares, and one configuration is claimed."""

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from ablate.comparison import compare
from ablate.jobs.compose import jobs_of
from ablate.runs import place
from ablate.runs.job import Job
from ablate.runs.place import claim_place

from ablate.settings.study import ConfigurationError
from support.studies import TINY

A_WHILE_S = 0.3


def at_once(*calls: Callable[[], object]) -> list[object]:
    """What each call returns, or the ConfigurationError that it raises."""

    def outcome(call: Callable[[], object]) -> object:
        try:
            return call()
        except ConfigurationError as error:
            return error

    with ThreadPoolExecutor(len(calls)) as pool:
        return list(pool.map(outcome, calls))


def test_of_two_configurations_that_claim_a_fresh_study_at_once_one_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    check = place.check_place

    def slow(job: Job) -> None:
        check(job)
        time.sleep(A_WHILE_S)

    monkeypatch.setattr(place, "check_place", slow)
    one, other = (
        jobs_of([f"variant={variant}", f"training.steps={steps}", f"runs_dir={tmp_path}", *TINY])[0]
        for variant, steps in (("sa2h", 6), ("sa2h-att", 9))
    )
    outcomes = at_once(lambda: claim_place(one), lambda: claim_place(other))
    (refused,) = [outcome for outcome in outcomes if outcome is not None]
    assert "training.steps" in str(refused)
    assert len(list(tmp_path.glob("*/*/seed0/spec.json"))) == 1


def test_of_two_commands_that_compare_at_once_one_does_and_the_other_keeps_what_it_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (job,) = jobs_of([f"runs_dir={tmp_path}", *TINY])
    folder = job.settings.study_dir / "comparison"
    folder.mkdir(parents=True)
    made = []

    def compares(*_: object) -> str:
        if not (folder / "made_from.json").exists():
            time.sleep(A_WHILE_S)
            made.append("a comparison")
            (folder / "made_from.json").touch()
        return "shown"

    monkeypatch.setattr(compare, "_compare_study", compares)
    assert at_once(*2 * [lambda: compare.compare_study(job.settings)]) == ["shown", "shown"]
    assert made == ["a comparison"]
