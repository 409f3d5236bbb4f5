"""The latest state wins: what a fast hand asks for is not computed one after the other."""

import threading
import time
from collections.abc import Callable

import pytest

from ablate.viewer.session import Quality
from ablate.viewer.worker import Worker

Shown = list[tuple[int, Quality]]
REST_S = 0.05


def until(holds: Callable[[], bool], within_s: float = 20.0) -> None:
    end = time.monotonic() + within_s
    while not holds():
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.005)


class Recorder:
    """Computes a number in some time, and keeps what is shown and what fails."""

    def __init__(self, takes_s: float) -> None:
        self.takes_s = takes_s
        self.shown: Shown = []
        self.failed: list[str] = []
        self.worker: Worker = Worker(self.compute, REST_S)
        self.worker.start(self.shown.append, lambda error: self.failed.append(str(error)))

    def compute(self, state: int, quality: Quality) -> tuple[int, Quality]:
        time.sleep(self.takes_s)
        if state < 0:
            raise ValueError(f"no such state: {state}")
        return state, quality


def test_a_thousand_poses_in_a_second_show_the_last_one_and_compute_a_handful() -> None:
    recorder = Recorder(takes_s=0.1)
    for number in range(1000):
        recorder.worker.submit(number)
        time.sleep(0.001)
    until(lambda: (999, Quality.full) in recorder.shown)
    recorder.worker.close()
    moving = [number for number, quality in recorder.shown if quality is Quality.coarse]
    assert moving == sorted(moving)
    assert moving[-1] == 999
    assert len(moving) == recorder.worker.computed[Quality.coarse] < 100
    assert recorder.worker.computed[Quality.full] <= 2  # one more only where the machine paused in between


def test_a_probe_at_rest_is_seen_coarsely_first_and_then_in_full_once() -> None:
    recorder = Recorder(takes_s=0.0)
    begun = time.monotonic()
    recorder.worker.submit(7)
    until(lambda: len(recorder.shown) == 2)
    assert time.monotonic() - begun >= REST_S
    time.sleep(3 * REST_S)
    recorder.worker.close()
    assert recorder.shown == [(7, Quality.coarse), (7, Quality.full)]


def test_views_in_full_of_a_state_that_has_been_replaced_are_dropped() -> None:
    started, go_on = threading.Event(), threading.Event()
    shown: Shown = []

    def compute(state: int, quality: Quality) -> tuple[int, Quality]:
        if (state, quality) == (1, Quality.full):
            started.set()
            assert go_on.wait(20)
        return state, quality

    worker: Worker = Worker(compute, REST_S)
    worker.start(shown.append, print)
    worker.submit(1)
    assert started.wait(20)
    worker.submit(2)
    go_on.set()
    until(lambda: (2, Quality.full) in shown)
    worker.close()
    assert (1, Quality.full) not in shown


def test_what_fails_is_told_and_the_next_state_is_computed() -> None:
    recorder = Recorder(takes_s=0.0)
    recorder.worker.submit(-1)
    until(lambda: recorder.failed == ["no such state: -1"])
    recorder.worker.submit(3)
    until(lambda: (3, Quality.full) in recorder.shown)
    recorder.worker.close()
    assert recorder.failed == ["no such state: -1"]


def test_a_paused_worker_computes_nothing_and_goes_on_with_the_last_state() -> None:
    recorder = Recorder(takes_s=0.0)
    recorder.worker.pause()
    recorder.worker.submit(1)
    recorder.worker.submit(2)
    time.sleep(3 * REST_S)
    assert not recorder.shown
    recorder.worker.resume()
    until(lambda: (2, Quality.full) in recorder.shown)
    recorder.worker.close()
    assert recorder.shown == [(2, Quality.coarse), (2, Quality.full)]


@pytest.mark.parametrize("quality", list(Quality))
def test_a_page_that_cannot_show_does_not_end_the_worker(quality: Quality) -> None:
    failed: list[str] = []

    def show(views: tuple[int, Quality]) -> None:
        if views[1] is quality:
            raise RuntimeError("the tab is closed")

    worker: Worker = Worker(lambda state, q: (state, q), REST_S)
    worker.start(show, lambda error: failed.append(str(error)))
    worker.submit(1)
    until(lambda: failed == ["the tab is closed"])
    worker.submit(2)
    until(lambda: len(failed) == 2)
    worker.close()
