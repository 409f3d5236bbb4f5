"""What a training takes from the machine: its device, its arithmetic, its memory."""

import ctypes
import sys
from contextlib import AbstractContextManager

import torch

from ablate.training.settings import TrainingPrecision

# Parameters of mallopt(3) in glibc, and the largest values that it takes.
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
_LARGEST_TRIM, _LARGEST_MMAP = 2**31 - 1, 32 * 2**20


def chosen_device(device: str) -> torch.device:
    """Turn `auto`, `cpu` or `cuda` into a device; RuntimeError where `cuda` is asked for and there is none.

    Examples
    --------
    >>> chosen_device("cpu")
    device(type='cpu')
    """
    if device == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if device == "cuda" and not torch.cuda.is_available():
        raise RuntimeError("device=cuda: this machine has no usable GPU, allowed are cpu and auto")
    return torch.device(device)


def chosen_precision(precision: TrainingPrecision, device: torch.device) -> TrainingPrecision:
    """Turn `auto` into bf16 where the device multiplies it in hardware, else into fp32.

    On a CPU that means AVX-512 BF16 or AMX: one without them converts every operand and is slower than in fp32.
    """
    if precision is not TrainingPrecision.auto:
        return precision
    if device.type == "cuda":
        fast = torch.cuda.is_bf16_supported(including_emulation=False)
    else:
        probes = ("_is_avx512_bf16_supported", "_is_amx_tile_supported")
        fast = any(getattr(torch.cpu, probe, lambda: False)() for probe in probes)
    return TrainingPrecision.bf16 if fast else TrainingPrecision.fp32


def autocast(precision: TrainingPrecision, device: torch.device) -> AbstractContextManager[object]:
    """Compute convolutions in `precision` within this context."""
    enabled = chosen_precision(precision, device) is TrainingPrecision.bf16
    return torch.autocast(device.type, torch.bfloat16, enabled=enabled)


def keep_freed_memory() -> None:
    """Take large blocks from the heap and never give its end back, for the rest of the process.

    A step frees and asks again for the same hundreds of megabytes. By default glibc returns them to the system and
    gets them back page by page, each one zeroed: a tenth of a step's time. Does nothing where the C library is
    another.
    """
    if sys.platform != "linux":
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, _LARGEST_MMAP)
        mallopt(_TRIM_THRESHOLD, _LARGEST_TRIM)
