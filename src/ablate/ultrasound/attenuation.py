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
def integral_attenuation(labels: np.ndarray, losses_db_mm: np.ndarray, spacing_mm: float, each: int = 1) -> np.ndarray:
    """exp(-cumulative sum of mu), mu = alpha f^b dz / 8.686, divided by its 98th percentile, at most 1.

    The sum stays in the log domain, so thousands of dB neither underflow nor divide by zero.

    Parameters
    ----------
    labels : (scanlines, samples) uint8
        The tissue of each sample.
    losses_db_mm : (tissues,) float
        What each tissue takes of the amplitude, one way.
    spacing_mm : float
        From sample to sample.
    each : int
        Samples of a row.

    Returns
    -------
    (scanlines, rows) float32
        The means of `each` samples, in [0, 1].
    """
    nepers = losses_db_mm * (spacing_mm / DB_PER_NEPER)
    total, amplitude = np.empty(labels.shape), np.empty((len(labels), -(-labels.shape[1] // each)), np.float32)
    in_parts(partial(_add_up, labels, nepers, total), len(labels), _LINES_OF_A_PART)
    position = (1 - _PERCENT / 100) * (total.size - 1)  # of it in the falling order, interpolated as numpy.percentile
    below, after = int(position), min(int(position) + 1, total.size - 1)
    enough = total[:, after // len(total)].max()  # at least after + 1 sums are no larger, because lines grow
    a, b = np.partition(total[total <= enough], (below, after))[[below, after]]  # a <= b: the larger amplitude first
    scale = a - math.log1p((position - below) * math.expm1(a - b))
    in_parts(partial(_fall, total, scale, each, amplitude), len(labels), _LINES_OF_A_PART)
    return amplitude


@compiled
def _add_up(labels: np.ndarray, nepers: np.ndarray, total: np.ndarray, begin: int, end: int) -> None:
    """Fill the sums, (lines, samples), of some lines."""
    for line in range(begin, end, 2):  # two at a time, because each sum waits for the one before
        other, summed, others = min(line + 1, end - 1), 0.0, 0.0
        for sample in range(labels.shape[1]):
            summed += nepers[labels[line, sample]]
            others += nepers[labels[other, sample]]
            total[line, sample], total[other, sample] = summed, others


@compiled
def _fall(total: np.ndarray, scale: float, each: int, amplitude: np.ndarray, begin: int, end: int) -> None:
    """Fill the means of exp(min(scale - total, 0)) of some lines, and change these sums."""
    samples, rows = total.shape[1], amplitude.shape[1]
    for line in range(begin, end):
        for sample in range(samples):
            total[line, sample] = exponential(min(scale - total[line, sample], 0.0))
        for row in range(rows):
            summed, first, stop = 0.0, row * each, min((row + 1) * each, samples)
            for sample in range(first, stop):
                summed += total[line, sample]
            amplitude[line, row] = summed / (stop - first)
