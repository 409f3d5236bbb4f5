"""Work in parts: any number of threads, none of torch's teams, and nothing lost when a part fails."""

import multiprocessing
import subprocess
import sys
import threading
import time
from contextlib import nullcontext

import pytest
import torch

from ablate.threads import in_parts, side_by_side, without_teams


@pytest.fixture(autouse=True)
def three_threads() -> object:
    torch.set_num_threads(3)
    yield
    torch.set_num_threads(1)


@pytest.mark.parametrize(("rows", "part"), [(0, 4), (1, 4), (7, 3), (12, 4)])
def test_parts_cover_all_rows_once_and_in_order(rows: int, part: int) -> None:
    spans = in_parts(lambda begin, end: (begin, end), rows, part)
    assert [row for begin, end in spans for row in range(begin, end)] == list(range(rows))
    assert all(end - begin <= part for begin, end in spans)


def test_torch_starts_no_team_in_any_thread_and_has_its_threads_back() -> None:
    everybody = threading.Barrier(3, timeout=30)

    def work(*_: int) -> int:
        everybody.wait()  # so that no thread takes two parts
        return torch.get_num_threads()

    with without_teams() as threads:
        assert threads == 3
        assert torch.get_num_threads() == 1
        with without_teams() as nested:
            assert nested == 3
        assert in_parts(work, 3, 1) == [1, 1, 1]
    assert torch.get_num_threads() == 3


def test_threads_are_given_back_when_the_work_fails() -> None:
    def fail(begin: int, _: int) -> None:
        if begin == 2:
            raise KeyError("part 2")

    with pytest.raises(KeyError, match="part 2"), without_teams():
        in_parts(fail, 4, 1)
    assert torch.get_num_threads() == 3


def test_a_thread_that_waits_for_the_scheduler_delays_its_own_part_alone() -> None:
    """What a team of OpenMP threads cannot do: the others take the rest of the work meanwhile."""
    taken: dict[int, list[int]] = {}
    slow: list[int] = []

    def work(begin: int, _: int) -> None:
        me = threading.get_ident()
        if not slow:
            slow.append(me)
        taken.setdefault(me, []).append(begin)
        time.sleep(0.5 if me == slow[0] else 0.001)

    in_parts(work, 40, 1)
    assert len(taken[slow[0]]) < 10
    assert sum(map(len, taken.values())) == 40


@pytest.mark.parametrize("threads", [1, 2, 3, 8])
def test_tasks_side_by_side_share_the_threads_with_what_they_do_in_parts(threads: int) -> None:
    torch.set_num_threads(threads)
    most, running, lock = [0], [0], threading.Lock()

    def part(begin: int, _: int) -> int:
        with lock:
            running[0] += 1
            most[0] = max(most[0], running[0])
        time.sleep(0.002)
        with lock:
            running[0] -= 1
        return begin

    def task(rows: int) -> list[int]:
        return in_parts(part, rows, 1)

    with without_teams():
        for _ in range(5):
            assert side_by_side(lambda: task(7), lambda: task(3), lambda: task(0)) == [[*range(7)], [*range(3)], []]
    assert most[0] <= threads
    assert most[0] >= min(threads, 2)


def test_an_error_of_one_task_is_that_of_all() -> None:
    def fail() -> None:
        raise KeyError("second")

    with pytest.raises(KeyError, match="second"), without_teams():
        side_by_side(lambda: in_parts(slowly, 5, 1), fail)


def test_inference_mode_is_that_of_the_caller() -> None:
    for mode in (True, False):
        with torch.inference_mode(mode):
            assert set(in_parts(lambda *_: torch.is_inference_mode_enabled(), 6, 1)) == {mode}


def slowly(begin: int, _: int) -> tuple[str, int]:
    """A part, and which thread took it: long enough for a helper to wake up."""
    time.sleep(0.02)
    return threading.current_thread().name, begin


def threads_of(rows: int) -> set[threading.Thread]:
    """The threads, not their names, that take parts."""
    return set(in_parts(lambda *_: time.sleep(0.02) or threading.current_thread(), rows, 1))


def test_helpers_stay_from_call_to_call() -> None:
    torch.set_num_threads(2)
    first = threads_of(6)
    assert len(first) == 2
    assert threads_of(6) == first
    with without_teams():
        assert threads_of(6) == first


def test_helpers_have_the_number_of_torch_of_who_calls() -> None:
    def numbers() -> set[int]:
        return set(in_parts(lambda *_: time.sleep(0.02) or torch.get_num_threads(), 12, 1))

    assert numbers() == {3}
    other = threading.Thread(target=torch.set_num_threads, args=(5,))  # what threads that start now would have
    other.start()
    other.join()
    assert numbers() == {3}
    with without_teams():
        assert numbers() == {1}
    assert numbers() == {3}


@pytest.mark.parametrize("teams", [True, False])
def test_a_call_within_a_part_loses_nothing(teams: bool) -> None:
    """Also where a helper would wait for itself: with teams, each part calls for as many threads as there are."""
    with nullcontext() if teams else without_teams():
        nested = in_parts(lambda row, _: [part for _, part in in_parts(slowly, row, 1)], 8, 1)
    assert nested == [list(range(row)) for row in range(8)]


def test_a_call_does_not_wait_for_helpers_that_are_busy() -> None:
    torch.set_num_threads(2)
    nested_is_done, begun = threading.Event(), threading.Event()
    me = threading.get_ident()

    def work(*_: int) -> bool:
        if threading.get_ident() != me:  # the only helper, busy until the call of the other thread has come back
            begun.set()
            return nested_is_done.wait(10)
        assert begun.wait(10)
        in_parts(slowly, 4, 1)
        nested_is_done.set()
        return True

    assert in_parts(work, 2, 1) == [True, True]


def test_an_interrupted_call_leaves_no_thread_that_never_ends() -> None:
    """Python notes a thread after it has started; a signal between the two leaves one that nobody would wake."""
    program = """
import threading, torch
from ablate.threads import in_parts
torch.set_num_threads(2)
real = threading.Thread.start
def start(thread):
    real(thread)
    raise KeyboardInterrupt
threading.Thread.start = start
try:
    in_parts(lambda *_: None, 4, 1)
except KeyboardInterrupt:
    print("interrupted")
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    assert ended.stdout == "interrupted\n"


def test_a_process_that_was_forked_has_helpers_of_its_own() -> None:
    in_parts(slowly, 6, 1)
    with multiprocessing.get_context("fork").Pool(1) as child:
        names, parts = zip(*child.apply_async(in_parts, (slowly, 12, 1)).get(timeout=30), strict=True)
    assert len(set(names)) > 1
    assert parts == tuple(range(12))
