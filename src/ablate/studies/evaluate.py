"""One trained generator on frames it has never seen."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
import pandas as pd
import torch
from tqdm import tqdm

from ablate.anatomy import Tissue
from ablate.config import EvaluationSettings
from ablate.dataset import Pairs, Part, equally_spaced
from ablate.metrics import (
    FID_METRICS,
    SPECKLE_METRICS,
    ImageMetric,
    InceptionFeatures,
    Metrics,
    Pair,
    choose_metrics,
    evaluate_image,
    noise_sd,
    speckle_features,
)
from ablate.studies.set_scores import distances, not_computed
from ablate.ultrasound import ConvexProbe, fan_mask
from ablate.ultrasound.probe import pixel_polar

# (frames of the data set, number of the noise draw) -> (k, H, W) uint8
Render = Callable[[np.ndarray, int], np.ndarray]
_BATCH = 8
_SAME_FAN = 0.98  # of the pixels of two fans together lie in both
_GAS_MRAYL, _FLUID_MRAYL, _FLUID_SCATTER = 0.5, 2.0, 0.01  # blood scatters 0.006, thalamus, the darkest tissue, 0.017


@dataclass(frozen=True)
class Evaluation:
    """What one generator scored on one part of the data.

    Attributes
    ----------
    per_image : DataFrame
        Columns frame, site, metric, value: infinite PSNR where a prediction equals its target, NaN where a metric of
        the user's own failed.
    scalars : dict
        Mean of each per-image metric over its finite values, and what only a set of images has (`fd_speckle`,
        `noise_sd`, ...); `_low` and `_high` are the ends of a 95 % interval.
    notes : tuple of str
        Metrics that were asked for and not computed, and why.
    """

    per_image: pd.DataFrame
    scalars: dict[str, float]
    notes: tuple[str, ...] = ()


class _Scored(NamedTuple):
    values: dict[str, float]
    textures: tuple[np.ndarray, np.ndarray]  # features of image and target


@dataclass(frozen=True, eq=False)
class _Known:
    """What is known of every frame, and wanted of it."""

    pairs: Pairs
    mask: np.ndarray
    depth_mm: np.ndarray | None
    solid: np.ndarray
    metrics: Mapping[str, ImageMetric]
    textures: bool


def tissue_labels(tissues: tuple[Tissue, ...]) -> np.ndarray:
    """Labels of tissue: all but gas and fluid, which is as hard as water and scatters next to nothing."""
    found = [
        i + 1
        for i, t in enumerate(tissues)
        if t.impedance_mrayl > _GAS_MRAYL and (t.impedance_mrayl > _FLUID_MRAYL or t.scatter_power > _FLUID_SCATTER)
    ]
    return np.asarray(found, np.uint8)


def describes_fan(probe: ConvexProbe, mask: np.ndarray) -> bool:
    """Whether a fan is that of a probe, as far as pixels can tell; only then is it known how deep they lie."""
    expected = fan_mask(probe, (mask.shape[0], mask.shape[1]))
    return bool((expected & mask).sum() >= _SAME_FAN * (expected | mask).sum())


def evaluate(
    pairs: Pairs,
    part: Part,
    tissues: tuple[Tissue, ...],
    probe: ConvexProbe,
    render: Render,
    settings: EvaluationSettings,
    draws_noise: bool,
    metrics: Metrics | None = None,
    inception: InceptionFeatures | None = None,
) -> Evaluation:
    """Score `render` against the frames of one part; what the data set does not hold leaves out its metrics.

    Frames are read and scored side by side, by as many threads as torch is set to use.

    Parameters
    ----------
    pairs : Pairs
    part : Part
    tissues : tuple of Tissue
    probe : ConvexProbe
    render : callable (frames (k,) int64, noise draw) -> (k, H, W) uint8
    settings : EvaluationSettings
    draws_noise : bool
        Whether a second draw can differ; `noise_sd` is 0 where it cannot.
    metrics : Metrics, optional
        All when left out.
    inception : callable, optional
        From `load_inception`; without it there is no FID and no KID.

    Returns
    -------
    Evaluation
    """
    metrics = choose_metrics() if metrics is None else metrics
    mask, solid = pairs.mask(), tissue_labels(tissues)
    depth = pixel_polar(probe, pairs.shape)[0] if describes_fan(probe, mask) else None
    frames = pairs.frames(part)
    missing, notes = not_computed(metrics, mask, len(frames), inception)
    computed = metrics.of_set - missing
    speckle, fid = computed.intersection(SPECKLE_METRICS), computed.intersection(FID_METRICS)
    score = partial(_score, _Known(pairs, mask, depth, solid, metrics.of_image, textures=bool(speckle)))
    scored: list[_Scored] = []
    seen: list[tuple[np.ndarray, np.ndarray]] = []
    with (
        ThreadPoolExecutor(torch.get_num_threads()) as pool,
        tqdm(total=len(frames), desc=f"evaluate {part.name}", leave=False, mininterval=1.0, disable=None) as bar,
    ):
        for start in range(0, len(frames), _BATCH):
            batch = frames[start : start + _BATCH]
            images = render(batch, 0)
            scored += pool.map(score, batch, images)
            if fid and inception is not None:
                seen.append((inception(images), inception(pairs.read("high", batch))))
            bar.update(len(batch))
    per_image = _table(part, frames, pairs.sites[frames], [s.values for s in scored])
    finite = per_image[np.isfinite(per_image["value"])]
    scalars = {str(name): float(value) for name, value in finite.groupby("metric")["value"].mean().items()}
    for names, features in ((speckle, [s.textures for s in scored]), (fid, seen)):
        if names:
            found, wanted = (np.concatenate(side) for side in zip(*features, strict=True))
            scalars |= distances(sorted(names), found, wanted, pairs.sites[frames])
    if "noise_sd" in computed:
        spread = _spread(pairs, frames, solid, render, settings) if draws_noise else 0.0
        if spread is not None:
            scalars["noise_sd"] = spread
    return Evaluation(per_image, scalars, notes)


def _score(known: _Known, frame: int, image: np.ndarray) -> _Scored:
    """Everything of one frame: read, measured, and the texture of both pictures described."""
    target, labels = known.pairs.stored("high", frame), known.pairs.stored("segmentation", frame)
    has_attenuation = "attenuation" in known.pairs.maps
    pair = Pair(
        prediction=image,
        target=target,
        mask=known.mask,
        tissue_mask=np.isin(labels, known.solid),
        attenuation=known.pairs.read("attenuation", [frame])[0] if has_attenuation else None,
        depth_mm=known.depth_mm,
        segmentation=labels,
    )
    try:
        values = evaluate_image(pair, known.metrics)
    except Exception as error:
        error.add_note(f"of frame {frame}")
        raise
    if not known.textures:
        return _Scored(values, (np.empty(0), np.empty(0)))
    described, wanted = (speckle_features(picture[None], known.mask) for picture in (image, target))
    return _Scored(values, (described, wanted))


def _table(part: Part, frames: np.ndarray, sites: np.ndarray, values: list[dict[str, float]]) -> pd.DataFrame:
    """One row a frame and metric."""
    rows = [
        (int(frame), int(site), name, value)
        for frame, site, of_frame in zip(frames, sites, values, strict=True)
        for name, value in of_frame.items()
    ]
    table = pd.DataFrame(rows, columns=["frame", "site", "metric", "value"]).astype({"value": "float64"})
    for name, of_metric in table[table["value"].isna()].groupby("metric"):
        named = ", ".join(of_metric["frame"].astype(str))
        logging.getLogger(__name__).warning("%s is NaN on %s frame %s: not in its mean", name, part.name, named)
    return table


def _spread(
    pairs: Pairs, frames: np.ndarray, solid: np.ndarray, render: Render, settings: EvaluationSettings
) -> float | None:
    """Mean over some frames of the standard deviation over noise draws, in tissue, grey levels; None without tissue."""
    shown = equally_spaced(frames, settings.noise_frames)
    draws = np.stack([render(shown, draw) for draw in range(settings.noise_draws)])
    labels = pairs.read("segmentation", shown)
    found = [noise_sd(draws[:, k], np.isin(labels[k], solid)) for k in range(len(shown))]
    known = [f for f in found if f is not None]
    return float(np.mean(known)) if known else None


def resimulated(pairs: Pairs) -> Render:
    """The same frames with other scatterers, as a renderer: its scores are the floor, or the level, of a metric."""

    def render(frames: np.ndarray, draw: int) -> np.ndarray:
        return pairs.read("high" if draw % 2 else "high_again", frames)

    return render
