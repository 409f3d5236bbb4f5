"""Two commands at once in one study: one compares, and one training has one place."""

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from ablate.command.compose import jobs_of
from ablate.study import compare
from ablate.study.job import claim
from ablate.study.run import listed_runs
from support.finished_runs import finish
from support.studies import TINY

A_WHILE_S = 0.3


def at_once(*calls: Callable[[], object]) -> list[object]:
    with ThreadPoolExecutor(len(calls)) as pool:
        return list(pool.map(lambda call: call(), calls))


def test_two_labels_of_one_training_that_claim_a_place_at_once_have_one(tmp_path: Path) -> None:
    one, other = (jobs_of([word, f"runs_dir={tmp_path}", *TINY])[0] for word in ("variant=sa2h-att", "variant=sa2h"))
    same = jobs_of(["model.attenuation=none", f"runs_dir={tmp_path}", *TINY])[0]
    places = [training.folder for training in at_once(lambda: claim(one), lambda: claim(same), lambda: claim(other))]  # type: ignore[attr-defined]
    assert places[0] == places[1] != places[2]
    assert len(list(tmp_path.glob("*/*/training.json"))) == 2


def test_of_two_commands_that_compare_at_once_one_does_and_the_other_keeps_what_it_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (job,) = jobs_of([f"runs_dir={tmp_path}", *TINY])
    finish(job)
    made = []
    write = compare.write_comparison

    def slow(*arguments: object) -> list[str]:
        made.append("a comparison")
        time.sleep(A_WHILE_S)
        return write(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(compare, "write_comparison", slow)
    asked = listed_runs([job])
    first, second = at_once(*2 * [lambda: compare.compare_study(asked, "a study", time_here=False).notes])
    assert first == second
    assert made == ["a comparison"]
