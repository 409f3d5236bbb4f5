"""How jobs are started, and what a process does with its own."""

import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ablate.runs.job import Job
from ablate.settings.study import ConfigurationError

Work = Callable[[Job], object]


@dataclass(frozen=True)
class Launch:
    """What starts the jobs of a command line.

    Attributes
    ----------
    start : callable
        Takes jobs and the work to do for each; returns when all have ended, whether or not they succeeded.
    elsewhere : bool
        Whether the jobs run on the nodes of a cluster.
    compares : bool
        Whether the study is compared when they have ended; not where another launcher starts each job by itself.
    """

    start: Callable[[Sequence[Job], Work], None]
    elsewhere: bool = False
    compares: bool = True


def start_here(jobs: Sequence[Job], work: Work) -> None:
    """Do the work for one job after another in this process."""
    for job in jobs:
        told(work, job)


def told(work: Work, job: Job) -> None:
    """Do the work for a job, and print what it raises.

    It is not raised: the files on disk tell that the job has not finished, and pickling it for the way back to a
    launcher may fail.
    """
    try:
        work(job)
    except Exception as error:
        is_the_systems = isinstance(error, OSError) and error.errno is not None  # such as a full disk
        if isinstance(error, ConfigurationError) or is_the_systems:
            print(f"{job.name}: {error}", file=sys.stderr)
        else:
            traceback.print_exc()
