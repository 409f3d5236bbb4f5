"""How far rendered frames are from a reference, frame by frame and in the mean."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import stats
from skimage.exposure import match_histograms

from ablate.analysis.figures.runtime_figure import WORSE_BOUNDS
from ablate.analysis.scored import LEVEL
from ablate.metrics import METRICS, Pair, evaluate_image, metric_of
from ablate.ultrasound import Probe, fan_mask
from ablate.ultrasound.probe import pixel_size_mm

ENVELOPE = "envelope_rms"
#: On the whole image as in the tables of a study; `mae_smooth` in the fan, after a Gaussian that averages speckle.
IMAGE_ERRORS = tuple(METRICS[name] for name in ("mae", "psnr", "pchi2", "mae_smooth"))


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


def frame_errors(rendered: Frames, reference: Frames, probe: Probe) -> dict[str, list[float]]:
    """Each error of every frame of the same poses; an error that cannot be computed is left out.

    `envelope_rms` is left out where there are no envelopes or their grids differ: images are compared on the same
    pixels whatever the grid of samples.
    """
    errors: dict[str, list[float]] = {}
    envelopes = rendered.envelopes
    right = reference.envelopes
    if envelopes is not None and right is not None and envelopes.shape == right.shape:
        errors[ENVELOPE] = [envelope_rms(envelope, exact) for envelope, exact in zip(envelopes, right, strict=True)]
    shape = (reference.images.shape[1], reference.images.shape[2])
    mask = fan_mask(probe, shape)
    pixel_mm = pixel_size_mm(probe, shape)
    for image, target in zip(rendered.images, reference.images, strict=True):
        for name, error in evaluate_image(Pair(image, target, mask, pixel_mm=pixel_mm), IMAGE_ERRORS).items():
            errors.setdefault(name, []).append(error)
    return errors


def with_histogram_of(frames: Frames, reference: Frames, probe: Probe) -> Frames:
    """Frames whose histogram in the fan, of all together, is the reference's."""
    images, mask = frames.images.copy(), fan_mask(probe, frames.images.shape[1:])
    images[:, mask] = np.rint(match_histograms(images[:, mask], reference.images[:, mask]))
    return Frames(images)


def mean_errors(rendered: Frames, reference: Frames, probe: Probe) -> dict[str, float]:
    """Average each error of `frame_errors` over the frames.

    PSNR of identical images is infinite; they are left out of its mean, unless all are.
    """
    return {name: finite_mean(values) for name, values in frame_errors(rendered, reference, probe).items()}


def finite_mean(values: Sequence[float]) -> float:
    """The mean of those values that are finite; of none, the first."""
    finite = [value for value in values if np.isfinite(value)]
    return float(np.mean(finite)) if finite else values[0]


def relative_change(metric: str, error: float, other: float) -> float:
    """Compute the relative change of an error with another reference; PSNR is converted to the RMS error."""
    if error == other:
        return 0.0
    if metric == "psnr":
        return abs(10 ** ((error - other) / 20) - 1)
    return abs(other / error - 1) if error else float("inf")


def worse_than(per_frame: pd.DataFrame, series: str, setting: str) -> pd.DataFrame:
    """How much worse renderers are than one of them on the same frames, with 95 % intervals.

    Parameters
    ----------
    per_frame : DataFrame
        Columns series, setting, metric, frame, error: one row an error of a frame.
    series, setting : str
        The one that the others are compared with, as the re-simulation.

    Returns
    -------
    DataFrame
        Columns series, setting, metric, worse (in units of the metric; of the PSNR how much smaller) and
        `WORSE_BOUNDS`, by Student's t over the paired differences of the frames; NaN of one frame.
    """
    per_frame = per_frame[np.isfinite(per_frame["error"])]
    badness = [
        metric_of(metric).badness(error) for metric, error in zip(per_frame["metric"], per_frame["error"], strict=True)
    ]
    per_frame = per_frame.assign(badness=badness)
    chosen = per_frame[(per_frame["series"] == series) & (per_frame["setting"] == setting)]
    paired = per_frame.merge(chosen[["metric", "frame", "badness"]], on=["metric", "frame"], suffixes=("", "_there"))
    paired["worse"] = paired["badness"] - paired["badness_there"]
    statistics = paired.groupby(["series", "setting", "metric"], sort=False)["worse"].agg(["mean", "std", "count"])
    reach = statistics["std"] / np.sqrt(statistics["count"]) * stats.t.ppf((1 + LEVEL) / 2, statistics["count"] - 1)
    ends = {WORSE_BOUNDS[0]: statistics["mean"] - reach, WORSE_BOUNDS[1]: statistics["mean"] + reach}
    return statistics.rename(columns={"mean": "worse"})[["worse"]].assign(**ends).reset_index()
