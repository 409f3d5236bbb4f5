"""The integral attenuation map A: how much of the pulse's amplitude is left at each point."""

import math
from functools import partial

import numpy as np

from ablate.threads import in_parts
from ablate.ultrasound.compiled import compiled, exponential
from ablate.ultrasound.stages import Stage, stage

DB_PER_NEPER = 20 / math.log(10)  # 8.686
_LINES_OF_A_PART = 32
_PERCENT = 98.0  # of A, which is made 1


@stage(Stage.attenuation_sum)
def integral_attenuation(labels: np.ndarray, losses_db_mm: np.ndarray, spacing_mm: float) -> np.ndarray:
    """exp(-cumulative sum of mu), mu = alpha f^b dz / 8.686, divided by its 98th percentile, at most 1.

    `labels` and the result, float32, are (scanlines, samples); the losses, (tissues,), are one way.
    The sum stays in the log domain, so thousands of dB neither underflow nor divide by zero.
    """
    nepers = losses_db_mm * (spacing_mm / DB_PER_NEPER)
    total, amplitude = np.empty(labels.shape), np.empty(labels.shape, np.float32)
    in_parts(partial(_add_up, labels, nepers, total), len(labels), _LINES_OF_A_PART)
    position = (1 - _PERCENT / 100) * (total.size - 1)  # of it in the falling order, interpolated as numpy.percentile
    below, after = int(position), min(int(position) + 1, total.size - 1)
    enough = total[:, after // len(total)].max()  # at least after + 1 sums are no larger, because lines grow
    few = np.concatenate([line[: np.searchsorted(line, enough, side="right")] for line in total])
    a, b = np.partition(few, (below, after))[[below, after]]  # a <= b: the larger amplitude first
    scale = a - math.log1p((position - below) * math.expm1(a - b))
    in_parts(partial(_fall, total, scale, amplitude), len(labels), _LINES_OF_A_PART)
    return amplitude


@compiled
def _add_up(labels: np.ndarray, nepers: np.ndarray, total: np.ndarray, begin: int, end: int) -> None:
    """Fill the sums, (lines, samples), of some lines."""
    for line in range(begin, end):
        summed = 0.0
        for sample in range(labels.shape[1]):
            summed += nepers[labels[line, sample]]
            total[line, sample] = summed


@compiled
def _fall(total: np.ndarray, scale: float, amplitude: np.ndarray, begin: int, end: int) -> None:
    """Fill exp(min(scale - total, 0)) of some lines."""
    for line in range(begin, end):
        for sample in range(total.shape[1]):
            amplitude[line, sample] = exponential(min(scale - total[line, sample], 0.0))
