"""Fixed pieces of work that are timed in turns with what a benchmark measures.

Milliseconds of two machines, or of one machine on two days, do not compare. Their ratios to the same convolution and to
the same loop do, as far as these are what the work consists of: networks are convolutions, and the rest is mostly
bound by memory and by Python.
"""

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from typing import TypeVar

import torch
from torch.nn import functional as F

T = TypeVar("T")
CHANNELS, SIDE = 32, 192  # of the maps that 3 x 3 filters are convolved with: 0.7 GFLOP
ADDITIONS = 200_000  # of the loop
ABOUT = (
    f"conv: times a 3 x 3 convolution of {CHANNELS} maps of {SIDE} x {SIDE} to as many, fp32, one thread; loop: times "
    f"{ADDITIONS:,} additions in Python. Both are taken in turns with what is measured; medians of ratios."
)


class Yardstick:
    """The times of the fixed work, a value a round."""

    def __init__(self) -> None:
        generator = torch.Generator().manual_seed(0)
        self._maps = torch.rand(1, CHANNELS, SIDE, SIDE, generator=generator)
        self._filters = torch.rand(CHANNELS, CHANNELS, 3, 3, generator=generator)
        self.convolutions: list[float] = []
        self.loops: list[float] = []
        self.tick()  # the first round does not count
        self.clear()

    def clear(self) -> None:
        """Forget all rounds."""
        self.convolutions.clear()
        self.loops.clear()

    def tick(self) -> None:
        """Take one round, beside one of what is measured."""
        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        start = time.perf_counter()
        with torch.inference_mode():
            F.conv2d(self._maps, self._filters, padding=1)
        between = time.perf_counter()
        total = 0
        for number in range(ADDITIONS):
            total += number
        end = time.perf_counter()
        torch.set_num_threads(threads)
        self.convolutions.append(1e3 * (between - start))
        self.loops.append(1e3 * (end - between))

    def ratios(self, times: Sequence[float]) -> tuple[float, float]:
        """Medians of the ratios of times, ms, a value a round, to the convolution and to the loop of their rounds."""
        pairs = [list(zip(times, fixed, strict=True)) for fixed in (self.convolutions, self.loops)]
        conv, loop = (median(ms / unit for ms, unit in rounds) for rounds in pairs)
        return conv, loop

    def line(self) -> str:
        """The medians themselves, for a benchmark whose rows are too long to take turns with."""
        conv, loop = median(self.convolutions), median(self.loops)
        return (
            f"Meanwhile a convolution of {SIDE} x {SIDE} took {conv:.1f} ms, and a loop {loop:.1f} ms (yardstick.py)."
        )

    def text(self, times: Sequence[float]) -> str:
        """The ratios in a table's cell."""
        conv, loop = self.ratios(times)
        return f"{conv:.2g} conv, {loop:.2g} loop"


def milliseconds(work: Callable[[], object]) -> float:
    """Time some work whose result comes back to the CPU."""
    start = time.perf_counter()
    work()
    return 1e3 * (time.perf_counter() - start)


def in_own_process(work: Callable[..., T], *arguments: object) -> T:
    """What a function of a module gives for these arguments in a new process, so that the peak of memory is its own."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return pool.submit(work, *arguments).result()


def peak_gib() -> float:
    """Largest resident memory of this process so far; getrusage would count what its parent had."""
    with Path("/proc/self/status").open() as file:
        return next(int(row.split()[1]) for row in file if row.startswith("VmHWM")) / 2**20
