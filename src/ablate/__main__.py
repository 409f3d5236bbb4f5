"""The one entry: `python -m ablate`, and the console script `ablate`."""

from __future__ import annotations

import sys

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from ablate.config import Task, register
from ablate.studies.sweep import ConfigurationError, asks_hydra, configuration_dir, job_from_hydra, jobs_of


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
        from ablate.studies import tasks  # heavy imports only after the command line is known to compose

        code = tasks.study(jobs, _launch) if task is Task.study else tasks.TASKS[task](jobs)
    except ConfigurationError as error:
        print(f"ablate: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit("ablate: interrupted; the same command continues where it stopped")
    sys.exit(code)


def _launch() -> None:
    register()
    hydra.main(version_base="1.3", config_path=str(configuration_dir()), config_name="config")(_job)()


def _job(config: DictConfig) -> None:
    """One job of a sweep, possibly in a process or on a machine of its own."""
    from ablate.studies.run import run_job

    run_job(job_from_hydra(config, list(HydraConfig.get().overrides.task)))


if __name__ == "__main__":
    main()
