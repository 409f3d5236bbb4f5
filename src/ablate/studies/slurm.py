"""Waiting for jobs on SLURM by asking its queue, so that a killed job is noticed on every cluster."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from hydra.core.utils import JobReturn, JobStatus
from submitit.slurm.slurm import SlurmInfoWatcher, SlurmJob


class QueueWatcher(SlurmInfoWatcher):
    """The state of jobs as `squeue` tells it: what it lists is at work, what it does not list has ended.

    submitit asks `sacct`, which fails on a cluster without an accounting database; a killed job, which leaves no
    result, would then be waited for without end.
    """

    def _make_command(self) -> list[str] | None:
        listing = ["squeue", "--me", "--array", "--noheader", "--format=%i"]
        return listing if self._registered - self._finished else None

    def read_info(self, string: bytes | str) -> dict[str, dict[str, Any]]:
        """State of each job that is waited for, from what `squeue` printed."""
        listed = set((string if isinstance(string, str) else string.decode()).split())
        return {job: {"State": "RUNNING" if job in listed else "ENDED"} for job in self._registered - self._finished}

    def wait(self, every_s: float = 5.0) -> None:
        """Return when no job is left in the queue."""
        self.update()
        while self._registered - self._finished:
            time.sleep(every_s)
            self.update()


@contextmanager
def ended_jobs() -> Iterator[None]:
    """Around Hydra's launcher: leave when all jobs have ended, killed ones and those queued again among them."""
    watcher = SlurmJob.watcher = QueueWatcher(delay_s=60)
    SlurmJob.results = _ended  # type: ignore[assignment]
    yield
    watcher.wait()


def _ended(job: SlurmJob[Any]) -> list[JobReturn]:
    """In place of what a job returned: nothing is, and what is on disk tells how it ended."""
    job.wait()
    return [JobReturn(status=JobStatus.COMPLETED)]
