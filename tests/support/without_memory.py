"""Read batches while 1, 5 or all allocations from the n-th on fail, for many n, each in a fork; prints what hangs."""

import _testcapi
import os
import signal
import sys
import time

import torch

from ablate.dataset import crops
from ablate.dataset.crops import CropLoader

crops._LOST_S = 0.05  # all 24 batches lost take a second
_HUNG_S = 5.0


class _Crops:
    """Batches that take small objects of Python, which is where a thread finds no memory."""

    def __getitem__(self, step: int) -> dict[str, torch.Tensor]:
        numbers = [str(step + i) for i in range(60)]
        time.sleep(0.001)
        return {"numbers": torch.ones(len(numbers))}


def _read(first: int, count: int) -> None:
    batches = iter(CropLoader(_Crops(), 0, 12, 1))  # type: ignore[arg-type]
    next(batches)
    _testcapi.set_nomemory(first, first + count)
    try:
        for loader in (batches, CropLoader(_Crops(), 0, 12, 1)):  # type: ignore[arg-type]
            for _ in loader:
                pass
    finally:
        _testcapi.remove_mem_hooks()


def _hangs(first: int, count: int) -> bool:
    if not (child := os.fork()):
        try:
            _read(first, count)
        finally:
            os._exit(1)
    until = time.monotonic() + _HUNG_S
    while not os.waitpid(child, os.WNOHANG)[0]:
        if time.monotonic() > until:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return True
        time.sleep(0.002)
    return False


if __name__ == "__main__":
    tried = [(n, count) for count in (1, 5, 10**9) for n in range(0, 1600, int(sys.argv[1]))]
    hung = [case for case in tried if _hangs(*case)]
    print(f"{len(hung)} of {len(tried)} hang", *hung[:5])
