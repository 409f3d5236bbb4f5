"""The one entry: `python -m ablate`, and the console script `ablate`."""

from __future__ import annotations

import sys
import traceback
from functools import partial
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from ablate.config import Task, register
from ablate.studies.sweep import (
    ConfigurationError,
    asks_hydra,
    cluster_folder,
    configuration_dir,
    job_from_hydra,
    jobs_of,
)


def main() -> None:
    """Check the whole command line, then run its task; a bad input is one line on stderr and exit code 2."""
    multirun = {"-m", "--multirun"} & set(sys.argv[1:])
    if multirun:  # argparse takes it in front of the overrides only; people write it anywhere
        sys.argv[1:] = ["--multirun", *(a for a in sys.argv[1:] if a not in multirun)]
    if asks_hydra(sys.argv[1:]):
        _launch()
        return
    try:
        jobs = jobs_of(sys.argv[1:])
        task = jobs[0].settings.task
        cluster = cluster_folder(sys.argv[1:])
        from ablate.studies import tasks  # heavy imports only after the command line is known to compose

        launch = _launch if cluster is None else partial(_launch_on_cluster, len(jobs), cluster)
        if task is Task.study:
            code = tasks.study(jobs, launch, elsewhere=cluster is not None)
        elif task is Task.simulate and cluster is not None:
            code = tasks.simulate(jobs, launch)
        else:
            code = tasks.TASKS[task](jobs)
    except ConfigurationError as error:
        print(f"ablate: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit("ablate: interrupted; the same command continues where it stopped")
    sys.exit(code)


def _launch() -> None:
    register()
    hydra.main(version_base="1.3", config_path=str(configuration_dir()), config_name="config")(_job)()


def _launch_on_cluster(jobs: int, folder: Path) -> None:
    from ablate.studies.slurm import ended_jobs  # needs the extra `slurm`

    print(f"{jobs} jobs go to SLURM; `squeue --me` shows them, what they print is in {folder}", flush=True)
    with ended_jobs():
        _launch()


def _job(config: DictConfig) -> None:
    """One job of a sweep, possibly in a process or on a machine of its own.

    What stops it is printed where it happened and goes no further: Hydra would show it without its origin, and what
    is on disk tells that the job has not finished.
    """
    from ablate.studies.data import maps_needed, prepare_data
    from ablate.studies.run import run_job

    job = job_from_hydra(config, list(HydraConfig.get().overrides.task))
    try:
        if job.settings.task is Task.simulate:
            prepare_data(job.settings, maps_needed([job.settings.model]))
        else:
            run_job(job)
    except Exception:
        traceback.print_exc()


if __name__ == "__main__":
    main()
