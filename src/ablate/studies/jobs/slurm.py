"""Submit jobs to SLURM by submitit, and wait for them by asking `squeue`, so that killed jobs are noticed."""

import subprocess
import time
from collections.abc import Collection, Sequence
from pathlib import Path

import submitit
from hydra_plugins.hydra_submitit_launcher.config import BaseQueueConf
from hydra_plugins.hydra_submitit_launcher.submitit_launcher import SlurmLauncher
from omegaconf import OmegaConf

from ablate.studies.jobs.hydra_internals import JobReturn, JobStatus, Singleton


class QueueLauncher(SlurmLauncher):
    """A `SlurmLauncher` that returns when all jobs have ended, also jobs that were killed or queued again.

    submitit asks `sacct`, which fails on a cluster without an accounting database, and it raises an error for a
    killed job, which leaves no result. Here no results are read: the files on disk tell how a job has ended.
    """

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> list[JobReturn]:
        """Submit one array of jobs and wait for it."""
        params = dict(self.params)
        folder = params.pop("submitit_folder")
        executor = submitit.AutoExecutor(folder, cluster="slurm", slurm_max_num_timeout=params.pop("max_num_timeout"))
        every_cluster = OmegaConf.structured(BaseQueueConf)
        executor.update_parameters(**{k if k in every_cluster else f"slurm_{k}": v for k, v in params.items()})
        Path(str(self.config.hydra.sweep.dir)).mkdir(parents=True, exist_ok=True)
        arguments = [
            (list(overrides), "hydra.sweep.dir", number, f"job_id_for_{number}", Singleton.get_state())
            for number, overrides in enumerate(job_overrides, initial_job_idx)
        ]
        jobs = executor.map_array(self, *zip(*arguments, strict=True))
        where = f"`squeue --me` shows them, what they print is in {Path(folder).parent}"
        print(f"{len(jobs)} jobs go to SLURM; {where}", flush=True)
        wait_for([job.job_id for job in jobs])
        return [JobReturn(status=JobStatus.COMPLETED) for _ in jobs]


def wait_for(jobs: Collection[str], every_s: float = 15.0) -> None:
    """Return when the queue no longer lists any of the jobs."""
    while jobs := queued(jobs):
        time.sleep(every_s)


def queued(jobs: Collection[str]) -> list[str]:
    """The jobs that `squeue` lists as running or waiting; all of them where `squeue` fails."""
    listing = ["squeue", "--me", "--array", "--noheader", "--format=%i"]
    answer = subprocess.run(listing, capture_output=True, text=True, check=False)
    listed = set(answer.stdout.split())
    return [job for job in jobs if answer.returncode != 0 or job in listed]
