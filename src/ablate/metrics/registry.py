"""Every metric of the package, one entry each. A new metric is a function and an entry here."""

from collections.abc import Callable, Iterable

import numpy as np

from ablate.metrics.distances import frechet_distance, kernel_distance
from ablate.metrics.fidelity import mae, psnr
from ablate.metrics.mechanism.draws import crps, noise_sd
from ablate.metrics.mechanism.grid_lines import nyquist_excess
from ablate.metrics.mechanism.octaves import octave_sd
from ablate.metrics.mechanism.shadows import shadow_contrast
from ablate.metrics.mechanism.structure import mae_smooth
from ablate.metrics.mechanism.thin_structures import thin_contrast
from ablate.metrics.metric import Direction, FeatureKind, Group, ImageMetric, Metric, Resimulation, SetDistance, Shown
from ablate.metrics.pair import Pair
from ablate.metrics.patch_histograms import patches_inside, rms
from ablate.validation import check_name

#: Raise it when a metric gives another value for the same images: kept scores, of runs and of re-simulation, are then
#: made anew.
METRICS_VERSION = 2


def _whole(metric: Callable[..., float]) -> ImageMetric:
    return lambda pair: metric(pair.prediction, pair.target)


def _in_fan(metric: Callable[..., float | None]) -> ImageMetric:
    return lambda pair: metric(pair.prediction, pair.target, pair.mask) if pair.mask.any() else None


def _pchi2(pair: Pair) -> float | None:
    return rms(pair.chi2_map)


def _pchi2_fan(pair: Pair) -> float | None:
    return rms(pair.chi2_map, patches_inside(pair.mask))


def _pchi2_tissue(pair: Pair) -> float | None:
    return None if pair.tissue_mask is None else rms(pair.chi2_map, patches_inside(pair.tissue_mask & pair.mask))


def _shadow_contrast(pair: Pair) -> float | None:
    if pair.attenuation is None or pair.tissue_mask is None or pair.segmentation is None or pair.depth_mm is None:
        return None
    labels = np.where(pair.tissue_mask, pair.segmentation, 0)
    return shadow_contrast(pair.prediction, pair.target, pair.attenuation, pair.mask, labels, pair.depth_mm)


def _mae_smooth(pair: Pair) -> float | None:
    return mae_smooth(pair.prediction, pair.target, pair.mask, pair.pixel_mm) if pair.mask.any() else None


def _thin_contrast(pair: Pair) -> float | None:
    if pair.bone_mask is None or pair.depth_mm is None or pair.pixel_mm is None:
        return None
    return thin_contrast(pair.prediction, pair.target, pair.mask, pair.bone_mask, pair.depth_mm, pair.pixel_mm)


def _octave_sd(pair: Pair) -> float | None:
    if pair.tissue_mask is None:
        return None
    return octave_sd(pair.prediction, pair.target, pair.tissue_mask & pair.mask)


def _noise_sd(pair: Pair) -> float | None:
    return None if pair.draws is None or pair.tissue_mask is None else noise_sd(pair.draws, pair.tissue_mask)


def _crps(pair: Pair) -> float | None:
    return None if pair.draws is None or pair.tissue_mask is None else crps(pair.draws, pair.target, pair.tissue_mask)


_FD_SPECKLE = SetDistance(FeatureKind.speckle, frechet_distance)
_KD_SPECKLE = SetDistance(FeatureKind.speckle, kernel_distance)
_FID = SetDistance(FeatureKind.inception, frechet_distance, resamples=100)  # of 2048 features each takes seconds
_KID = SetDistance(FeatureKind.inception, kernel_distance)

HIGHER, LOWER, ZERO, UNJUDGED = Direction
FLOOR, LEVEL, NEITHER = Resimulation
PIXEL, PATCH, SET, MECHANISM, SIMULATION, COST, OWN = Group
GREY = "grey levels"
_DRAWN = Shown.panels | Shown.screen

# The entries of `METRICS`, in the order of every table and figure.
_ENTRIES = (
    Metric("psnr", "PSNR", "dB", HIGHER, LEVEL, PIXEL, 2, Shown.everywhere, _whole(psnr)),
    Metric("psnr_fan", "PSNR in fan", "dB", HIGHER, LEVEL, PIXEL, 2, of_image=_in_fan(psnr)),
    Metric("mae", "MAE", GREY, LOWER, LEVEL, PIXEL, 2, Shown.everywhere, _whole(mae)),
    Metric("mae_fan", "MAE in fan", GREY, LOWER, LEVEL, PIXEL, 2, of_image=_in_fan(mae)),
    Metric("pchi2", "pχ²", "", LOWER, FLOOR, PATCH, 3, Shown.everywhere, _pchi2),
    Metric("pchi2_fan", "pχ² in fan", "", LOWER, FLOOR, PATCH, 3, of_image=_pchi2_fan),
    Metric("pchi2_tissue", "pχ² in tissue", "", LOWER, FLOOR, MECHANISM, 3, of_image=_pchi2_tissue),
    Metric("fd_speckle", "FD speckle", "", LOWER, FLOOR, SET, 2, Shown.everywhere, of_set=_FD_SPECKLE),
    Metric("kd_speckle", "KD speckle", "", LOWER, FLOOR, SET, 3, of_set=_KD_SPECKLE),
    Metric("fid", "FID", "", LOWER, FLOOR, SET, 2, Shown.table | Shown.report, of_set=_FID),
    Metric("kid", "KID", "", LOWER, FLOOR, SET, 3, of_set=_KID),
    Metric(
        "shadow_contrast", "Shadow contrast", GREY, LOWER, FLOOR, MECHANISM, 1, _DRAWN | Shown.report, _shadow_contrast
    ),
    Metric("mae_smooth", "Smooth MAE", GREY, LOWER, LEVEL, MECHANISM, 2, _DRAWN, _mae_smooth),
    Metric("thin_contrast", "Thin contrast", GREY, LOWER, FLOOR, MECHANISM, 1, _DRAWN, _thin_contrast),
    Metric("nyquist_excess", "Nyquist excess", "dB", LOWER, FLOOR, MECHANISM, 2, _DRAWN, _in_fan(nyquist_excess)),
    Metric("octave_sd", "Octave sd", "dB", LOWER, FLOOR, MECHANISM, 2, of_image=_octave_sd),
    Metric("crps", "CRPS", GREY, LOWER, FLOOR, MECHANISM, 2, _DRAWN, of_draws=_crps),
    Metric("noise_sd", "Noise sd", GREY, UNJUDGED, LEVEL, MECHANISM, 1, _DRAWN, of_draws=_noise_sd),
    Metric("envelope_rms", "Envelope error", "relative RMS", LOWER, LEVEL, SIMULATION, 4),
    Metric("ms_per_frame", "Time", "ms/frame", LOWER, NEITHER, COST, 1, Shown.screen | Shown.report),
    Metric("parameters", "Parameters", "", UNJUDGED, NEITHER, COST, 0, Shown.table | Shown.report),
)
METRICS: dict[str, Metric] = {metric.name: metric for metric in _ENTRIES}
_OWN: dict[str, Metric] = {}  # of the user, since they were chosen


def register(metric: Metric) -> Metric:
    """Make a user's metric known to tables, figures and statistics, in place of an earlier one of that name.

    Raises ValueError when the package has a metric of that name, or the name cannot be that of a file.
    """
    check_name("name", metric.name)
    if metric.name in METRICS:
        raise ValueError(f"{metric.name} is the name of another metric")
    _OWN[metric.name] = metric
    return metric


def metric_of(name: str) -> Metric:
    """The entry of a metric; one that is not known is shown under its own name and not judged."""
    return METRICS.get(name) or _OWN.get(name) or Metric(name)


def shown_in(place: Shown) -> list[str]:
    """Names of the metrics that are shown in a place, those of the package first."""
    return [metric.name for metric in (*METRICS.values(), *_OWN.values()) if metric.shown & place]


def evaluate_image(pair: Pair, metrics: Iterable[Metric] = METRICS.values()) -> dict[str, float]:
    """Every per-image metric that this pair allows, by name.

    Metrics that the frame offers nothing for (no shadow in it, no tissue mask, no draws) are left out. `psnr` may be
    inf. No metric of the package is NaN, but one of the user's may be.
    """
    found = {}
    for metric in metrics:
        try:
            measure = metric.of_image if pair.draws is None else metric.of_image or metric.of_draws
            value = None if measure is None else measure(pair)
            if value is not None:
                found[metric.name] = float(value)
        except Exception as error:
            error.add_note(f"by the metric {metric.name}")
            raise
    return found
