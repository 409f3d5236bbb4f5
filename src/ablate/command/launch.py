"""How jobs are started: one after another here, or each in a process of its own with `hydra/launcher=processes`."""

import multiprocessing
import os
import signal
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import wait
from multiprocessing.context import SpawnProcess
from typing import Any

import cloudpickle
from hydra.core.hydra_config import HydraConfig
from hydra.core.singleton import Singleton
from hydra.core.utils import run_job, setup_globals
from hydra.types import HydraContext
from omegaconf import DictConfig, open_dict

from ablate.command.composed import read_own_components
from ablate.command.schema import register
from ablate.dataset.processes import allotted_cores, work_for_parent
from ablate.settings.study import ConfigurationError
from ablate.study.job import Job

VISIBLE = "CUDA_VISIBLE_DEVICES"
_LINE = "TQDM_POSITION"  # which tqdm reads: jobs side by side each redraw a line of their own
_GRACE_S = 3.0  # after Ctrl-C, which reaches every process of a terminal
# What libraries of numerics read when they are loaded.
_THREADS = ("OMP", "OPENBLAS", "MKL", "BLIS", "NUMBA", "NUMEXPR")
Work = Callable[[Job], object]
#: A job of a sweep, its words of the command line, and its number.
Numbered = tuple[Job, Sequence[str], int]
Start = Callable[[Sequence[Numbered], Work], None]


@dataclass(frozen=True)
class Launch:
    """What starts the jobs of a command line; `start` returns when all have ended, whether or not they succeeded."""

    start: Callable[[Sequence[Job], Work], None]
    elsewhere: bool = False  # whether the jobs run on the nodes of a cluster
    compares: bool = True  # the study, when they have ended; not where another launcher starts each job by itself


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
        is_ours = type(error).__module__.startswith("ablate.")  # says what to do, as when a training diverges
        if is_ours or (isinstance(error, OSError) and error.errno is not None):  # or the system's, such as a full disk
            print(f"{job.name}: {error}", file=sys.stderr)
        else:
            traceback.print_exc()


def start_processes(launcher: Any) -> Start:
    """A function that starts a process for each job, `n_jobs` at a time; one that dies takes no other with it.

    After Ctrl-C it waits until every process has saved the step that it is at. Processes whose launcher was killed end
    by themselves. Each has its share of the cores as threads, unless `OMP_NUM_THREADS` and the like say otherwise.
    Where the machine has several GPUs, each process sees one of them only, the one that fewest others have.
    """
    asked = launcher.n_jobs
    if asked == 0 or not isinstance(asked, int):
        raise ConfigurationError(
            f"hydra.launcher.n_jobs={asked}: allowed are 1 and more, or -1 for the number of cores"
        )
    return partial(_start, launcher)


def processes_at_a_time(asked: int, jobs: int, gpus: int) -> int:
    """How many jobs run side by side: as many as were asked for, and for -1 one a core.

    Where the machine has several GPUs, -1 is one a GPU. Elsewhere it is one more than cores if the last job would
    otherwise run alone, beside idle cores: three jobs on two cores then take 1.5 times as long as one, not twice.
    """
    if asked > 0:
        return asked
    cores = max(1, allotted_cores() + 1 + asked)
    if gpus:
        return min(cores, gpus)
    return cores + 1 if asked == -1 and jobs % cores == 1 else cores


def _start(launcher: Any, jobs: Sequence[Numbered], work: Work) -> None:
    devices = devices_to_share(jobs[0][0].settings.training.device)
    n_jobs = processes_at_a_time(launcher.n_jobs, len(jobs), len(devices))
    coming = list(jobs)
    running: dict[int, tuple[SpawnProcess, str, str | None, int]] = {}
    try:
        while coming or running:
            while coming and len(running) < n_jobs:
                numbered = coming.pop(0)
                busy = [taken for _, _, taken, _ in running.values()]
                device = min(devices, key=busy.count, default=None)  # the one that fewest have
                arguments = launcher.hydra_context, launcher.config, numbered, work, Singleton.get_state()
                content = cloudpickle.dumps((run_in_process, arguments))
                line = min(set(range(n_jobs)) - {taken for *_, taken in running.values()})
                process = _started(content, n_jobs, device, line)
                running[process.sentinel] = process, numbered[0].name, device, line
            for sentinel in wait(list(running)):
                process, name, *_ = running.pop(int(sentinel))  # type: ignore[arg-type]
                process.join()
                if (code := process.exitcode or 0) < 0:
                    by = signal.Signals(-code).name
                    often = "; SIGKILL is often the system's, out of memory: try fewer hydra.launcher.n_jobs"
                    print(f"{name}: its process was ended by {by}{often if by == 'SIGKILL' else ''}", file=sys.stderr)
    except KeyboardInterrupt:
        wait_for_all([process for process, *_ in running.values()])
        raise


def run_in_process(
    context: HydraContext, master: DictConfig, numbered: Numbered, work: Work, singletons: Mapping[Any, Any]
) -> None:
    """Run one job of a sweep in a process of its own, as Hydra's launchers do.

    Parameters
    ----------
    context, master : HydraContext, DictConfig
        What Hydra gave the launcher: how to compose, and what it composed of the words that all jobs share.
    numbered : (Job, sequence of str, int)
        The job, its words of the command line, and its number.
    work : callable
        What is done for the job.
    singletons : mapping
        Hydra's state in the process of the launcher.
    """
    job, words, number = numbered
    setup_globals()
    register()
    Singleton.set_state(dict(singletons))
    config = context.config_loader.load_sweep_config(master, list(words))
    with open_dict(config):
        config.hydra.job.id, config.hydra.job.num = f"{config.hydra.job.name}_{number}", number
    HydraConfig.instance().set_config(config)
    read_own_components(config.hydra)
    run_job(lambda _: told(work, job), config, "hydra.sweep.dir", "hydra.sweep.subdir", context)


def _started(content: bytes, n_jobs: int, device: str | None, line: int) -> SpawnProcess:
    """A process that runs a pickled call, with its share of the threads, its GPU, and its line of a terminal."""
    process = multiprocessing.get_context("spawn").Process(target=work_for_parent, args=(content,))
    threads = {f"{library}_NUM_THREADS": str(max(1, allotted_cores() // n_jobs)) for library in _THREADS}
    environment = {name: count for name, count in threads.items() if name not in os.environ}
    environment |= {_LINE: str(line)} | ({} if device is None else {VISIBLE: device})
    before = os.environ.copy()
    os.environ.update(environment)
    try:
        process.start()
    finally:
        for name in environment.keys() - before.keys():
            del os.environ[name]
        os.environ.update(before)
    return process


def wait_for_all(processes: Sequence[SpawnProcess]) -> None:
    """Wait until processes that were interrupted have ended; those that do not know of it are told by SIGTERM."""
    for process in processes:
        process.join(_GRACE_S)
    for process in processes:
        process.terminate()
    for process in processes:
        process.join()


def devices_to_share(device: str) -> tuple[str, ...]:
    """The GPUs that the jobs of a sweep share, as `CUDA_VISIBLE_DEVICES` names them; none on a CPU or one GPU."""
    if device not in ("auto", "cuda"):
        return ()
    import torch  # takes seconds, and a sweep on CPUs does without

    count = torch.cuda.device_count()
    visible = os.environ.get(VISIBLE, ",".join(map(str, range(count))))
    named = [name.strip() for name in visible.split(",")][:count]
    return tuple(named) if len(named) > 1 else ()
