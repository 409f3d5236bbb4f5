"""Submit jobs to SLURM by submitit, and wait for them by asking `squeue`, so that killed jobs are noticed."""

import subprocess
import time
from collections.abc import Collection, Sequence
from functools import partial
from pathlib import Path
from shutil import which
from typing import Any

import submitit
from hydra.core.singleton import Singleton
from omegaconf import OmegaConf

from ablate.command.launch import Numbered, Start, Work
from ablate.settings.study import ConfigurationError


def submit(launcher: Any) -> Start:
    """A function that submits one array of jobs and returns when all have ended, also those that were killed.

    submitit asks `sacct`, which fails on a cluster without an accounting database, and it raises an error for a killed
    job, which leaves no result. Here no results are read: the files on disk tell how a job has ended.
    """
    if which("srun") is None:
        raise ConfigurationError("hydra/launcher=slurm: there is no srun here; start it on a login node")
    return partial(_submit, launcher)


def _submit(launcher: Any, jobs: Sequence[Numbered], _work: Work) -> None:
    """Each job composes and does its task on its node, as Hydra's own launcher of submitit has it."""
    from hydra_plugins.hydra_submitit_launcher.config import BaseQueueConf

    params = dict(launcher.params)
    folder = params.pop("submitit_folder")
    executor = submitit.AutoExecutor(folder, cluster="slurm", slurm_max_num_timeout=params.pop("max_num_timeout"))
    every_cluster = OmegaConf.structured(BaseQueueConf)
    executor.update_parameters(**{k if k in every_cluster else f"slurm_{k}": v for k, v in params.items()})
    Path(str(launcher.config.hydra.sweep.dir)).mkdir(parents=True, exist_ok=True)
    arguments = [
        (list(words), "hydra.sweep.dir", number, f"job_id_for_{number}", Singleton.get_state())
        for _, words, number in jobs
    ]
    submitted = executor.map_array(launcher, *zip(*arguments, strict=True))
    where = f"`squeue --me` shows them, what they print is in {Path(folder).parent}"
    print(f"{'1 job goes' if len(jobs) == 1 else f'{len(jobs)} jobs go'} to SLURM; {where}", flush=True)
    wait_for([job.job_id for job in submitted])


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
