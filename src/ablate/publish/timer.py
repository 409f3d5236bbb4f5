"""Publishing beside a training, so that a store that is slow or silent holds nothing up."""

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache

from ablate.publish.store import open_store, reason
from ablate.publish.study_view import study_run
from ablate.publish.training_view import publish_training
from ablate.publish.waiting import in_time
from ablate.study.job import Job

_LOG = logging.getLogger(__name__)
_EVERY_S = 5.0
_LAST_S = 20.0


@contextmanager
def following(job: Job) -> Iterator[None]:
    """Publish the training of a job every few seconds while it is trained inside, and once when it has ended.

    What publishing raises is one line of the log; `task=compare` publishes what a store did not take.
    """

    def publish(goes_on: bool) -> None:
        training = job.training
        if not training.about:  # stopped before it began
            return
        wanted = [key.file_name for key in job.wanted]
        scores = [name for name in wanted if (training.scores / name).exists()]
        store = open_store(job.settings)
        publish_training(store, study_run(store, job.settings), training, scores, goes_on)

    ended = threading.Event()

    def repeat() -> None:
        while not ended.wait(_EVERY_S):
            _tried(lambda: publish(goes_on=True))

    thread = threading.Thread(target=repeat, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        try:
            thread.join(_LAST_S)
            in_time(_LAST_S, lambda: _tried(lambda: publish(goes_on=False)))
        except TimeoutError as error:
            _say(reason(error))


def _tried(work: Callable[[], object]) -> None:
    try:
        work()
    except Exception as error:  # whatever a store raises, the training goes on
        _say(reason(error))


@cache
def _say(why: str) -> None:
    """Say once a process why nothing is published: each job of a sweep would repeat it."""
    _LOG.warning("not published to MLflow for now, work goes on (%s)", why)
