"""Processor, memory, disk, network and GPU while a run is trained: MLflow's own monitors, logged to disk first."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from ablate.tracking.background import Background
from ablate.tracking.local_log import LocalLog, points, read_log

EVERY_S = 10.0  # as MLflow itself samples
_GROUP = "system/"  # MLflow shows these on a page of their own


@contextmanager
def system_metrics(folder: Path, log: LocalLog, every_s: float = EVERY_S) -> Iterator[None]:
    """Log how busy the machine is to the log of a run, in `folder`, for as long as the body runs.

    The step counts samples. A resumed run goes on counting.
    """
    lines, _ = read_log(folder)
    taken = max((point.step for point in points(lines) if point.key.startswith(_GROUP)), default=-1) + 1
    monitors = _monitors()

    def sample() -> None:
        nonlocal taken
        values: dict[str, float] = {}
        for monitor in monitors:
            monitor.collect_metrics()
            values |= monitor.aggregate_metrics()
            monitor.clear_metrics()
        log.metrics({f"{_GROUP}{name}": value for name, value in values.items()}, taken)
        taken += 1

    background = Background(sample, every_s)
    try:
        yield
    finally:
        background.close()


def _monitors() -> list[Any]:
    from mlflow.system_metrics.metrics.cpu_monitor import CPUMonitor
    from mlflow.system_metrics.metrics.disk_monitor import DiskMonitor
    from mlflow.system_metrics.metrics.gpu_monitor import GPUMonitor
    from mlflow.system_metrics.metrics.network_monitor import NetworkMonitor

    found: list[Any] = [CPUMonitor(), DiskMonitor(), NetworkMonitor()]
    with suppress(ImportError, RuntimeError):  # no NVIDIA GPU, or not its package
        found.append(GPUMonitor())
    return found
