"""Errors of frames against a reference, on the linear envelope and on the displayed image."""

from dataclasses import dataclass

import numpy as np

from ablate.metrics import METRICS, Pair, evaluate_image
from ablate.ultrasound import Probe, fan_mask
from ablate.ultrasound.probe import pixel_size_mm

ENVELOPE = "envelope_rms"


@dataclass(frozen=True)
class Frames:
    """Rendered poses: images, (n, H, W) uint8, and envelopes, (n, samples, scanlines) float32.

    Envelopes are linear, before gain, noise and logarithm. A generator has none.
    """

    images: np.ndarray
    envelopes: np.ndarray | None = None


def envelope_rms(envelope: np.ndarray, reference: np.ndarray) -> float:
    """Compute the root of the sum of squared differences over that of the reference; sums are in float64.

    It is 0 if both are zero everywhere, and infinite if only the reference is.
    """
    difference = float(np.sum(np.square(np.subtract(envelope, reference, dtype=np.float64))))
    power = float(np.sum(np.square(reference, dtype=np.float64)))
    if power == 0:
        return 0.0 if difference == 0 else float("inf")
    return (difference / power) ** 0.5


#: On the whole image as in the tables of a study; `mae_smooth` in the fan, after a Gaussian that averages speckle.
IMAGE_ERRORS = tuple(METRICS[name] for name in ("mae", "psnr", "pchi2", "mae_smooth"))


def mean_errors(rendered: Frames, reference: Frames, probe: Probe) -> dict[str, float]:
    """Average each error over the frames of the same poses; an error that cannot be computed is left out.

    `envelope_rms` is left out where there are no envelopes or their grids differ: images are compared on the same
    pixels whatever the grid of samples. PSNR of identical images is infinite; they are left out of its mean, unless all
    are.
    """
    found: dict[str, list[float]] = {}
    here, there = rendered.envelopes, reference.envelopes
    if here is not None and there is not None and here.shape == there.shape:
        found[ENVELOPE] = [envelope_rms(a, b) for a, b in zip(here, there, strict=True)]
    shape = (reference.images.shape[1], reference.images.shape[2])
    mask, pixel_mm = fan_mask(probe, shape), pixel_size_mm(probe, shape)
    for image, target in zip(rendered.images, reference.images, strict=True):
        for name, error in evaluate_image(Pair(image, target, mask, pixel_mm=pixel_mm), IMAGE_ERRORS).items():
            found.setdefault(name, []).append(error)
    return {name: _mean(values) for name, values in found.items()}


def _mean(values: list[float]) -> float:
    finite = [v for v in values if np.isfinite(v)]
    return float(np.mean(finite)) if finite else values[0]


def relative_change(metric: str, error: float, other: float) -> float:
    """Compute the relative change of an error with another reference; PSNR is converted to the RMS error."""
    if error == other:
        return 0.0
    if metric == "psnr":
        return abs(10 ** ((error - other) / 20) - 1)
    return abs(other / error - 1) if error else float("inf")
