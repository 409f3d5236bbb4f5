"""Work on many rows, split among the threads that torch may use."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import torch

Result = TypeVar("Result")


def in_parts(work: Callable[[int, int], Result], rows: int, part: int) -> list[Result]:
    """Results of `work(begin, end)` for consecutive parts of `part` rows, in order.

    The parts do not depend on the number of threads, so neither does what is computed. Embree and compiled code
    let go of Python's lock.
    """
    begins = range(0, rows, part)
    ends = [min(begin + part, rows) for begin in begins]
    threads = min(torch.get_num_threads(), len(ends))
    if threads <= 1:
        return [work(begin, end) for begin, end in zip(begins, ends, strict=True)]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, begins, ends))
