"""Publishing beside a training, so that a store that is slow or silent holds nothing up."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from ablate.dataset.processes import start_beside
from ablate.publish.store import open_store
from ablate.publish.study_view import study_run
from ablate.publish.training_view import publish_training
from ablate.publish.waiting import in_time, say, tried
from ablate.study.job import Job

_EVERY_S = 5.0
_LAST_S = 20.0


@contextmanager
def following(job: Job) -> Iterator[None]:
    """Publish the training of a job every few seconds while it is trained inside, and once when it has ended.

    What publishing raises is one line of the log; `task=compare` publishes what a store did not take. When the work
    inside has ended, a store is waited for `_LAST_S` at most.
    """
    ended = threading.Event()

    def repeat() -> None:
        while not ended.wait(_EVERY_S):
            tried(lambda: _publish(job, goes_on=True))
        tried(lambda: _publish(job, goes_on=False))

    thread = start_beside(repeat)
    try:
        yield
    finally:
        ended.set()
        thread.join(_LAST_S)
        if thread.is_alive():
            say(TimeoutError(f"no end after {_LAST_S:g} s"))


def published_end(job: Job) -> None:
    """Publish how a training has ended whose process could not: one that was killed."""
    tried(lambda: in_time(_LAST_S, lambda: _publish(job, goes_on=False)))


def _publish(job: Job, goes_on: bool) -> None:
    """Publish what is on disk of a job's training, with those of its scores that are there."""
    training = job.training
    if not training.about:  # stopped before it began
        return
    wanted = [key.file_name for key in job.wanted]
    scores = [name for name in wanted if (training.scores / name).exists()]
    store = open_store(job.settings)
    publish_training(store, study_run(store, job.settings), training, scores, goes_on)
