"""From a command line to what is done with its jobs, through `hydra.main`."""

import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import hydra
import hydra.experimental.callback
from hydra.core.hydra_config import HydraConfig
from hydra.core.utils import JobReturn, JobStatus
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

import ablate
from ablate.command.compose import job_of, jobs_of, refuse_other_launcher, swept_keys
from ablate.command.composed import CONFIG, VERSION_BASE, composed
from ablate.command.launch import Launch, Start, Work, start_here
from ablate.command.refusals import in_one_line, with_hint
from ablate.command.schema import register
from ablate.command.search import said_of_search
from ablate.command.words import readable
from ablate.setting import did_you_mean
from ablate.settings.conf import conf_folder
from ablate.settings.study import ConfigurationError, Task
from ablate.study.job import Job

_OURS = "hydra_plugins.ablate_plugins."  # whose launchers are given all jobs, and compare them when they have ended

register()  # on import: a launcher's process unpickles `run_one`, which imports this module, before it composes


class NotFinishedError(RuntimeError):
    """A job of a sweep has not finished; what stopped it was printed where it ran."""


class _Raised(BaseException):
    """Carries an exception of a task through Hydra, which would print it as its own."""

    def __init__(self, error: Exception) -> None:
        super().__init__(str(error))
        self.error = error


def execute(arguments: Sequence[str]) -> int:
    """Do what a command line asks for, given as the words after `python -m ablate`; returns the exit code.

    Hydra answers its own questions (`--help`, `--cfg job`, ...), but for `--version`. What cannot be run is a
    ConfigurationError before anything starts.
    """
    if "--version" in arguments:
        print(f"ablate {ablate.__version__}")
        return 0
    # Hydra documents this variable: it then raises what is wrong with a configuration instead of printing it.
    os.environ["HYDRA_FULL_ERROR"] = "1"
    command = hydra.main(version_base=VERSION_BASE, config_path=str(conf_folder()), config_name=CONFIG)(run_one)
    words = readable(arguments)
    with in_one_line(words):
        before, sys.argv = sys.argv, ["ablate", *words]  # which `hydra.main` reads
        try:
            command()
        except NotFinishedError:
            return 1
        except _Raised as raised:
            error = raised.error
        except SystemExit as end:  # `--help` of Hydra's parser, a word that it does not know, or jobs that failed
            return end.code if isinstance(end.code, int) else int(end.code is not None)
        else:
            return 0
        finally:
            sys.argv = before
    raise with_hint(error, words)


def run_one(config: DictConfig) -> float | None:
    """Hydra's task function: do the task of one job, and return its objective where one is asked for.

    Without `-m` it is the whole command. Where a launcher that is not ours runs it for each job of a sweep, the study
    is not compared: `Comparison` does this when all have ended.
    """
    hydra_config = HydraConfig.get()
    is_sweep = hydra_config.mode is RunMode.MULTIRUN
    launcher = hydra_config.runtime.choices["hydra/launcher"]
    try:
        if not is_sweep and any(word.startswith("hydra/launcher=") for word in _words(hydra_config, "hydra")):
            raise ConfigurationError(f"hydra/launcher={launcher} starts the jobs of a sweep: add -m")
        swept = [str(key) for key in (hydra_config.sweeper.get("swept") or hydra_config.sweeper.get("params") or ())]
        job = job_of(_words(hydra_config, "task"), swept if is_sweep else (), config=config)
        job = replace(job, source=hydra_config.sweeper.get("source") or job.source)  # that of the command
        code = _do([job], Launch(start_here, compares=not is_sweep))
    except Exception as error:
        if is_sweep:  # its launcher and its sweeper are told, as Hydra documents it
            raise
        raise _Raised(error) from error
    if code and is_sweep:
        raise NotFinishedError(f"{job.name}: not finished")
    if code:
        raise SystemExit(code)
    return objective(job)


def _words(hydra_node: Any, kind: str) -> list[str]:
    """Words of the command line as they were given: `${levels:8}` in one is resolved where the job is composed."""
    words = OmegaConf.to_container(hydra_node.overrides[kind], resolve=False)
    return [str(word) for word in words] if isinstance(words, list) else []


def run_sweep(
    master: DictConfig, job_overrides: Sequence[Sequence[str]], first_number: int, start: Start, elsewhere: bool = False
) -> list[JobReturn]:
    """Do the task of all jobs of a sweep, for our launchers.

    Parameters
    ----------
    master : DictConfig
        What Hydra composed of the words that all jobs share.
    job_overrides : sequence of sequences of str
        The words of each job.
    first_number : int
        Of the first job, where a sweeper launches its jobs in batches.
    start : callable
        Starts those of the jobs that are to be run.
    elsewhere : bool
        Whether they run on the nodes of a cluster.
    """
    lines = [[word for word in line if not word.startswith("hydra.")] for line in job_overrides]
    swept, fixed = swept_keys(lines, _words(master.hydra, "task")), _words(master.hydra, "hydra")
    HydraConfig.instance().set_config(master)  # as Hydra does for a job: it says what the command starts from
    configs = [composed([*fixed, *line]) for line in lines]
    for line, config in zip(lines, configs, strict=True):
        refuse_other_launcher(master, config, [word for word in line if word.partition("=")[0] in swept])
    jobs = [job_of(line, swept, fixed, config) for line, config in zip(lines, configs, strict=True)]
    if not jobs:  # Hydra's own sweeper launches them too
        raise ConfigurationError("-m: a sweep without a job; allowed is at least one value of each key")

    def start_some(chosen: Sequence[Job], work: Work) -> None:
        numbers = [jobs.index(job) for job in chosen]
        start([(jobs[n], job_overrides[n], first_number + n) for n in numbers], work)

    sees_all = jobs[0].settings.objective is None and not _in_batches(master)
    launch = Launch(start_some, elsewhere, compares=sees_all)
    try:
        code = _do(jobs, launch)
    except Exception as error:
        raise _Raised(error) from error
    is_search = jobs[0].settings.objective is not None and jobs[0].settings.task is Task.study
    if code and not is_search:
        raise SystemExit(code)
    return [_returned(job, line, failed=is_search and not job.finished) for job, line in zip(jobs, lines, strict=True)]


def _returned(job: Job, line: Sequence[str], failed: bool) -> JobReturn:
    """What a sweeper is told of a job; of one that failed, `max_failure_rate` decides whether the search goes on."""
    returned = JobReturn(overrides=line, status=JobStatus.FAILED if failed else JobStatus.COMPLETED)
    returned.return_value = NotFinishedError(f"{job.name}: not finished") if failed else objective(job)
    return returned


def objective(job: Job) -> float | None:
    """The score of a finished run that `objective=` names; None where none is asked for."""
    name = job.settings.objective
    if name is None or job.settings.task is not Task.study:
        return None
    from ablate.study.run import run_of

    scalars = run_of(job).scalars if job.finished else {}
    if name not in scalars:
        allowed = f"allowed are {', '.join(scalars)}{did_you_mean(name, scalars)}"
        raise ConfigurationError(f"objective={name}: {job.name} has no such score; {allowed}")
    return float(scalars[name])


def _do(jobs: Sequence[Job], launch: Launch) -> int:
    from ablate.tasks.run_task import run_task  # heavy imports only after the command line is known to compose

    return run_task(jobs, launch)


class Comparison(hydra.experimental.callback.Callback):
    """A callback of Hydra's: compares the study of a sweep when all jobs have ended, where none saw all of them.

    That is where another launcher than ours has run each by itself, or a sweeper has launched them in batches. Of a
    search it prints the best trial instead.
    """

    def on_multirun_end(self, config: DictConfig, **_: object) -> None:
        """Compare what lies on disk when all jobs have ended."""
        if config.objective is not None and config.task == Task.study:
            HydraConfig.instance().set_config(config)  # as Hydra does for a job
            for line in said_of_search(config):
                print(line)
            return
        is_ours = str(config.hydra.launcher.get("_target_")).startswith(_OURS)
        is_compared = is_ours and not _in_batches(config)
        if is_compared or config.task != Task.study:
            return
        words = [*_words(config.hydra, "hydra"), *_words(config.hydra, "task")]
        HydraConfig.instance().set_config(config)
        jobs = jobs_of(["-m", *words, "task=compare"])
        begun = [job for job in jobs if job.settings.study_dir.is_dir()]
        if not begun:
            return
        try:
            code = _do(begun, Launch(start_here))
        except ConfigurationError as error:  # of which Hydra would print a warning
            raise _Raised(error) from error
        if code:
            raise SystemExit(code)


def _in_batches(config: DictConfig) -> bool:
    """Whether Hydra's sweeper launches the jobs of a command a few at a time."""
    return OmegaConf.select(config, "hydra.sweeper.max_batch_size") is not None
