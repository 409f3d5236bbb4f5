"""Which device and which arithmetic: decided once, in one place."""

from __future__ import annotations

from contextlib import AbstractContextManager

import torch

from ablate.training.settings import Precision


def chosen_device(device: str) -> torch.device:
    """Turn `auto`, `cpu` or `cuda` into a device.

    Raises
    ------
    RuntimeError
        Where `cuda` is asked for and there is none.
    """
    if device == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if device == "cuda" and not torch.cuda.is_available():
        raise RuntimeError("device=cuda: this machine has no usable GPU, allowed are cpu and auto")
    return torch.device(device)


def chosen_precision(precision: Precision, device: torch.device) -> Precision:
    """Turn `auto` into bf16 where the device multiplies it in hardware, else into fp32.

    On a CPU that means AVX-512 BF16 or AMX: one without them converts every operand and is slower than in fp32.
    """
    if precision is not Precision.auto:
        return precision
    if device.type == "cuda":
        fast = torch.cuda.is_bf16_supported(including_emulation=False)
    else:
        probes = ("_is_avx512_bf16_supported", "_is_amx_tile_supported")
        fast = any(getattr(torch.cpu, probe, lambda: False)() for probe in probes)
    return Precision.bf16 if fast else Precision.fp32


def autocast(precision: Precision, device: torch.device) -> AbstractContextManager[object]:
    """Compute convolutions in `precision` within this context."""
    enabled = chosen_precision(precision, device) is Precision.bf16
    return torch.autocast(device.type, torch.bfloat16, enabled=enabled)
