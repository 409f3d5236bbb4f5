"""Run the jobs of a sweep on this machine, each in a process of its own."""

import multiprocessing
import os
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from multiprocessing.connection import wait
from multiprocessing.context import SpawnProcess
from pathlib import Path

import cloudpickle
from omegaconf import DictConfig

from ablate.config import ConfigurationError
from ablate.dataset.processes import allotted_cores, work_for_parent
from ablate.studies.jobs.devices import VISIBLE, devices_to_share, least_busy
from ablate.studies.jobs.hydra_internals import (
    HydraContext,
    JobReturn,
    JobStatus,
    Launcher,
    Singleton,
    TaskFunction,
    run_sweep_job,
)

_GRACE_S = 3.0  # after Ctrl-C, which reaches every process of a terminal
# What libraries of numerics read when they are loaded.
_THREADS = ("OMP", "OPENBLAS", "MKL", "BLIS", "NUMBA", "NUMEXPR")


class ProcessLauncher(Launcher):
    """Starts a process for each job, `n_jobs` at a time; one that dies takes no other with it.

    After Ctrl-C it waits until every process has saved the step that it is at. Processes whose launcher was killed end
    by themselves. Each has its share of the cores as threads, unless `OMP_NUM_THREADS` and the like say otherwise.
    Where the machine has several GPUs, each process sees one of them only, the one that fewest others have; then there
    are no more processes than GPUs, unless `n_jobs` says so.
    """

    def __init__(self, n_jobs: int = -1) -> None:
        if n_jobs == 0:
            raise ConfigurationError("hydra.launcher.n_jobs=0: allowed are 1 and more, or -1 for the number of cores")
        self._asked, self.n_jobs = n_jobs, n_jobs if n_jobs > 0 else max(1, allotted_cores() + 1 + n_jobs)
        self.devices: tuple[str, ...] = ()

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        """Keep what every job is run with; Hydra calls this."""
        self.context, self.task, self.config = hydra_context, task_function, config
        self.devices = devices_to_share(config)
        if self.devices and self._asked < 0:
            self.n_jobs = min(self.n_jobs, len(self.devices))

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> list[JobReturn]:
        """Run the jobs; return when all processes have ended, however they did."""
        Path(str(self.config.hydra.sweep.dir)).mkdir(parents=True, exist_ok=True)
        coming = list(enumerate(job_overrides, initial_job_idx))
        running: dict[int, tuple[SpawnProcess, str, str | None]] = {}
        try:
            while coming or running:
                while coming and len(running) < self.n_jobs:
                    number, overrides = coming.pop(0)
                    device = least_busy(self.devices, [taken for _, _, taken in running.values()])
                    process = self._started(number, overrides, device)
                    name = " ".join(o for o in overrides if not o.startswith("hydra"))
                    running[process.sentinel] = process, name, device
                for sentinel in wait(list(running)):
                    process, name, _ = running.pop(int(sentinel))  # type: ignore[arg-type]
                    process.join()
                    _tell(process.exitcode or 0, name)
        except KeyboardInterrupt:
            wait_for_all([process for process, _, _ in running.values()])
            raise
        return [JobReturn(status=JobStatus.COMPLETED) for _ in job_overrides]

    def _started(self, number: int, overrides: Sequence[str], device: str | None) -> SpawnProcess:
        arguments = self.context, self.config, self.task, list(overrides), number, Singleton.get_state()
        content = cloudpickle.dumps((run_sweep_job, arguments))
        process = multiprocessing.get_context("spawn").Process(target=work_for_parent, args=(content,))
        own = {f"{library}_NUM_THREADS": str(max(1, allotted_cores() // self.n_jobs)) for library in _THREADS}
        with _environment({name: own[name] for name in own.keys() - os.environ.keys()} | _only(device)):
            process.start()
        return process


def wait_for_all(processes: Sequence[SpawnProcess]) -> None:
    """Wait until processes that were interrupted have ended; those that do not know of it are told by SIGTERM."""
    for process in processes:
        process.join(_GRACE_S)
    for process in processes:
        process.terminate()
    for process in processes:
        process.join()


def _tell(code: int, name: str) -> None:
    if code < 0:
        by = signal.Signals(-code).name
        why = "; SIGKILL is often the system's, out of memory: try fewer hydra.launcher.n_jobs"
        print(f"{name}: its process was ended by {by}{why if by == 'SIGKILL' else ''}", file=sys.stderr)


def _only(device: str | None) -> dict[str, str]:
    return {} if device is None else {VISIBLE: device}


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    """Processes that are started meanwhile have these variables."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
