"""Start composed jobs in this process or by the launcher that the command line names."""

import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from ablate.config import ConfigurationError
from ablate.studies.jobs.hydra_internals import ComposedConfigLoader, ConfigSearchPath, run_single, run_sweep
from ablate.studies.jobs.job import Job

Work = Callable[[Job], object]


@dataclass(frozen=True)
class ComposedJob:
    """A job, the overrides that a launcher knows it by, and the whole configuration that Hydra made of them."""

    job: Job
    overrides: tuple[str, ...]
    config: DictConfig


@dataclass(frozen=True)
class Launch:
    """What starts jobs of a command line."""

    composed: tuple[ComposedJob, ...]
    master: DictConfig | None  # what the jobs of a sweep have in common, its launcher included; None for a single job
    search_path: ConfigSearchPath
    cluster: Path | None  # where the jobs print that SLURM runs; None where they run on this machine

    def __call__(self, jobs: Sequence[Job], work: Work) -> None:
        """Do `work` for each of the jobs. Returns when all have ended, whether or not they succeeded."""
        chosen = [c for c in self.composed if c.job in jobs]
        task = _Task(tuple(c.job for c in chosen), work)
        loader = ComposedConfigLoader(self.search_path, {c.overrides: c.config for c in chosen})
        try:
            if self.master is None:
                run_single(chosen[0].config, loader, task)
            else:
                run_sweep(self.master, loader, [c.overrides for c in chosen], task)
        except Exception:  # for example, a worker was killed; the files on disk tell which jobs have finished
            traceback.print_exc()


@dataclass(frozen=True)
class _Task:
    """The function that a launcher pickles, and calls in the process of each job.

    An exception is printed there and not raised: pickling it for the way back may fail, and the files on disk tell
    that the job has not finished.
    """

    jobs: tuple[Job, ...]
    work: Work

    def __call__(self, _: DictConfig) -> None:
        number = HydraConfig.get().job.num if len(self.jobs) > 1 else 0  # Hydra numbers the jobs of sweeps only
        try:
            self.work(self.jobs[number])
        except Exception as error:
            is_the_systems = isinstance(error, OSError) and error.errno is not None  # such as a full disk
            if isinstance(error, ConfigurationError) or is_the_systems:
                print(f"{self.jobs[number].name}: {error}", file=sys.stderr)
            else:
                traceback.print_exc()
