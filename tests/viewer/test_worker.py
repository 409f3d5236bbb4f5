"""The latest state wins: what a fast hand asks for is not computed one after the other."""

import threading
import time
from collections.abc import Iterator

import pytest

from ablate.viewer.session import Quality
from ablate.viewer.worker import Worker
from support.viewed_body import until

Shown = list[tuple[int, Quality]]
REST_S = 0.05


class Recorder:
    """A worker that computes a number in some time, or as it is told; what it shows, and what fails."""

    def __init__(self) -> None:
        self.takes_s = 0.0
        self.broken: Quality | None = None
        self.shown: Shown = []
        self.failed: list[str] = []
        self.worker = Worker(self.compute, REST_S)
        self.worker.start(self.show, lambda error: self.failed.append(str(error)))

    def compute(self, state: int, quality: Quality) -> tuple[int, Quality]:
        time.sleep(self.takes_s)
        if state < 0:
            raise ValueError(f"no such state: {state}")
        return state, quality

    def show(self, views: tuple[int, Quality]) -> None:
        if views[1] is self.broken:
            raise RuntimeError("the tab is closed")
        self.shown.append(views)


@pytest.fixture
def recorder() -> Iterator[Recorder]:
    made = Recorder()
    yield made
    made.worker.close()


def test_a_thousand_poses_in_a_second_show_the_last_one_and_compute_a_handful(recorder: Recorder) -> None:
    recorder.takes_s = 0.1
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


def test_a_probe_at_rest_is_seen_coarsely_first_and_then_in_full_once(recorder: Recorder) -> None:
    begun = time.monotonic()
    recorder.worker.submit(7)
    until(lambda: len(recorder.shown) == 2)
    assert time.monotonic() - begun >= REST_S
    time.sleep(3 * REST_S)
    assert recorder.shown == [(7, Quality.coarse), (7, Quality.full)]


def test_views_in_full_of_a_state_that_has_been_replaced_are_dropped(
    recorder: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    started, go_on = threading.Event(), threading.Event()

    def compute(state: int, quality: Quality) -> tuple[int, Quality]:
        if (state, quality) == (1, Quality.full):
            started.set()
            assert go_on.wait(20)
        return state, quality

    monkeypatch.setattr(recorder.worker, "_compute", compute)
    recorder.worker.submit(1)
    assert started.wait(20)
    recorder.worker.submit(2)
    go_on.set()
    until(lambda: (2, Quality.full) in recorder.shown)
    assert (1, Quality.full) not in recorder.shown


def test_what_fails_is_told_and_the_next_state_is_computed(recorder: Recorder) -> None:
    recorder.worker.submit(-1)
    until(lambda: recorder.failed == ["no such state: -1"])
    recorder.worker.submit(3)
    until(lambda: (3, Quality.full) in recorder.shown)
    assert recorder.failed == ["no such state: -1"]


def test_a_paused_worker_computes_nothing_and_goes_on_with_the_last_state(recorder: Recorder) -> None:
    recorder.worker.pause()
    recorder.worker.submit(1)
    recorder.worker.submit(2)
    time.sleep(3 * REST_S)
    assert not recorder.shown
    recorder.worker.resume()
    until(lambda: (2, Quality.full) in recorder.shown)
    assert recorder.shown == [(2, Quality.coarse), (2, Quality.full)]


@pytest.mark.parametrize("quality", list(Quality))
def test_a_page_that_cannot_show_does_not_end_the_worker(recorder: Recorder, quality: Quality) -> None:
    recorder.broken = quality
    recorder.worker.submit(1)
    until(lambda: recorder.failed == ["the tab is closed"])
    recorder.worker.submit(2)
    until(lambda: len(recorder.failed) == 2)
