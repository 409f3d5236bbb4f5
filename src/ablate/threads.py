"""Work split among threads that do not wait for each other.

Torch splits each of its operations among a team of OpenMP threads, and the whole team waits until its last member has
finished. Where another program uses a core, one member waits for the scheduler, some milliseconds, and all others spin
meanwhile, once for each of the hundreds of short operations of a frame. Here a thread takes the next part of the work
when it has finished its own, so one that has to wait delays its own part alone.
"""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from functools import cache
from typing import Any, TypeVar

import torch

Result = TypeVar("Result")
# How many threads `in_parts` may use where torch uses one, within `without_teams`.
_allowed: ContextVar[int | None] = ContextVar("allowed threads", default=None)


@contextmanager
def torch_threads(count: int) -> Iterator[int]:
    """Have torch use so many threads, or as many as before with 0; gives their number.

    They are those of the thread that calls it, and of the threads that are started meanwhile.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(count or before)
    try:
        yield torch.get_num_threads()
    finally:
        torch.set_num_threads(before)


@contextmanager
def without_teams() -> Iterator[int]:
    """Within, torch computes on the thread that calls it, `in_parts` on as many as torch had; gives their number."""
    outer = _allowed.get()
    if outer is not None:
        yield outer
        return
    threads = torch.get_num_threads()
    token = _allowed.set(threads)
    try:
        with torch_threads(1):
            yield threads
    finally:
        _allowed.reset(token)


@cache
def _helpers(count: int, process: int) -> ThreadPoolExecutor:
    """Threads that stay, as their start costs as much as a short stage does; a process that was forked has its own."""
    return ThreadPoolExecutor(count, f"in_parts of {process}")


def in_parts(work: Callable[[int, int], Result], rows: int, part: int) -> list[Result]:
    """Results of `work(begin, end)` for consecutive parts of `part` rows, in order.

    The parts do not depend on the number of threads, so neither does what is computed. Embree, compiled code and torch
    let go of Python's lock.
    """
    begins = range(0, rows, part)
    torch_count = torch.get_num_threads()  # torch keeps this by thread, and the next
    inference = torch.is_inference_mode_enabled()
    allowed = _allowed.get() or torch_count
    helpers = min(allowed, len(begins)) - 1
    results: dict[int, Result] = {}
    left = iter(begins)

    def take_parts() -> None:
        with torch.inference_mode(inference):
            for begin in left:
                results[begin] = work(begin, min(begin + part, rows))

    def help_out() -> None:
        torch.set_num_threads(torch_count)
        take_parts()

    futures: list[Future[None]] = []
    try:
        for _ in range(helpers):
            futures.append(_helpers(allowed - 1, os.getpid()).submit(copy_context().run, help_out))
        take_parts()
    except BaseException:
        _helpers.cache_clear()  # ends them: one that was interrupted as it started would wait for work for ever
        raise
    finally:
        futures = [future for future in futures if not future.cancel()]  # a helper may be busy with other work
        wait(futures)
    for future in futures:
        future.result()
    return [results[begin] for begin in begins]


def side_by_side(*tasks: Callable[[], Any]) -> list[Any]:
    """Results, in order, of tasks that do not need each other, the longest first; a task may itself work `in_parts`."""
    return in_parts(lambda begin, _: tasks[begin](), len(tasks), 1)
