"""How far frames are from their reference: on the linear envelope, and on the image as it is shown."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ablate.metrics import mae, mae_smooth, patch_chi2, psnr, rms

ENVELOPE = "envelope_rms"


@dataclass(frozen=True)
class Shots:
    """The same poses as one renderer shows them.

    Attributes
    ----------
    images : (n, H, W) uint8
    envelopes : (n, samples, scanlines) float32, or None
        Linear, before gain, noise and logarithm; a generator has none.
    """

    images: np.ndarray
    envelopes: np.ndarray | None = None


def envelope_rms(envelope: np.ndarray, reference: np.ndarray) -> float:
    """Relative error of a linear envelope, root of the sum of squares over that of the reference; sums in float64.

    Parameters
    ----------
    envelope, reference : (samples, scanlines) float

    Returns
    -------
    float
        0 where both are silent, infinite where only the reference is.
    """
    difference = float(np.sum(np.square(np.subtract(envelope, reference, dtype=np.float64))))
    power = float(np.sum(np.square(reference, dtype=np.float64)))
    if power == 0:
        return 0.0 if difference == 0 else float("inf")
    return (difference / power) ** 0.5


#: On the whole image as in the tables of a study; `mae_smooth` in the fan, after a Gaussian that averages speckle away.
IMAGE_ERRORS: dict[str, Callable[[np.ndarray, np.ndarray, np.ndarray], float | None]] = {
    "mae": lambda image, target, _: mae(image, target),
    "psnr": lambda image, target, _: psnr(image, target),
    "pchi2": lambda image, target, _: rms(patch_chi2(image, target)),
    "mae_smooth": mae_smooth,
}


def mean_errors(shots: Shots, reference: Shots, mask: np.ndarray) -> dict[str, float]:
    """Mean over the frames of every error that can be had.

    Parameters
    ----------
    shots, reference : Shots
        Of the same poses. `envelope_rms` is left out where there are no envelopes or their grids differ: images are
        compared on the same pixels whatever the grid of samples.
    mask : (H, W) bool
        The fan.

    Returns
    -------
    dict of str to float
        PSNR of identical images is infinite; they are left out of its mean, unless all are.
    """
    found: dict[str, list[float]] = {}
    here, there = shots.envelopes, reference.envelopes
    if here is not None and there is not None and here.shape == there.shape:
        found[ENVELOPE] = [envelope_rms(a, b) for a, b in zip(here, there, strict=True)]
    for name, error in IMAGE_ERRORS.items():
        values = [error(a, b, mask) for a, b in zip(shots.images, reference.images, strict=True)]
        if known := [v for v in values if v is not None]:
            found[name] = known
    return {name: _mean(values) for name, values in found.items()}


def _mean(values: list[float]) -> float:
    finite = [v for v in values if np.isfinite(v)]
    return float(np.mean(finite)) if finite else values[0]


def moved(metric: str, error: float, other: float) -> float:
    """By which share an error changes when it is taken to another reference; of PSNR, the RMS error it stands for."""
    if error == other:
        return 0.0
    if metric == "psnr":
        return abs(10 ** ((error - other) / 20) - 1)
    return abs(other / error - 1) if error else float("inf")
