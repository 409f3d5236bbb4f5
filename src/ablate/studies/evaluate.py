"""One trained generator on frames it has never seen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from tqdm import tqdm

from ablate.anatomy import Tissue
from ablate.config import EvaluationSettings
from ablate.dataset import Pairs, Part, equally_spaced
from ablate.metrics import Pair, evaluate_image, frechet_distance, kernel_distance, noise_sd, speckle_features
from ablate.ultrasound import ConvexProbe, fan_mask
from ablate.ultrasound.probe import pixel_polar

# (frames of the data set, number of the noise draw) -> (k, H, W) uint8
Render = Callable[[np.ndarray, int], np.ndarray]
_BATCH = 8
_GAS_MRAYL, _FLUID_MRAYL, _FLUID_SCATTER = 0.5, 2.0, 0.01  # blood scatters 0.006, thalamus, the darkest tissue, 0.017
_SAME_FAN = 0.98  # of the pixels of two fans together lie in both


@dataclass(frozen=True)
class Evaluation:
    """What one generator scored on one part of the data.

    Attributes
    ----------
    per_image : DataFrame
        Columns frame, site, metric, value.
    scalars : dict
        Mean of each per-image metric, and what only a set of images has (`fd_speckle`, `noise_sd`, ...).
    """

    per_image: pd.DataFrame
    scalars: dict[str, float]


def tissue_labels(tissues: tuple[Tissue, ...]) -> np.ndarray:
    """Labels of tissue: neither gas nor fluid, which is as hard as water and scatters next to nothing; bone is tissue."""
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
) -> Evaluation:
    """Score `render` against the frames of one part; what the data set does not hold leaves out its metrics.

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

    Returns
    -------
    Evaluation
    """
    mask, solid = pairs.mask(), tissue_labels(tissues)
    depth = pixel_polar(probe, pairs.shape)[0] if describes_fan(probe, mask) else None
    has_attenuation = "attenuation" in pairs.maps
    frames = pairs.frames(part)
    rows: list[dict[str, object]] = []
    target_features, features = [], []
    for start in tqdm(
        range(0, len(frames), _BATCH), desc=f"evaluate {part.name}", leave=False, mininterval=1.0, disable=None
    ):
        batch = frames[start : start + _BATCH]
        images, targets = render(batch, 0), pairs.read("high", batch)
        labels = pairs.read("segmentation", batch)
        attenuation = pairs.read("attenuation", batch) if has_attenuation else [None] * len(batch)
        for k, frame in enumerate(batch):
            pair = Pair(
                prediction=images[k],
                target=targets[k],
                mask=mask,
                tissue_mask=np.isin(labels[k], solid),
                attenuation=attenuation[k],
                depth_mm=depth,
                segmentation=labels[k],
            )
            site = int(pairs.sites[frame])
            rows += [
                {"frame": int(frame), "site": site, "metric": name, "value": value}
                for name, value in evaluate_image(pair).items()
            ]
        features.append(speckle_features(images, mask))
        target_features.append(speckle_features(targets, mask))
    per_image = pd.DataFrame(rows)
    finite = per_image[np.isfinite(per_image["value"])]
    scalars = {str(name): float(value) for name, value in finite.groupby("metric")["value"].mean().items()}
    found, wanted = np.concatenate(features), np.concatenate(target_features)
    scalars["fd_speckle"] = frechet_distance(found, wanted)
    scalars["kd_speckle"] = kernel_distance(found, wanted)
    spread = _spread(pairs, frames, solid, render, settings) if draws_noise else 0.0
    if spread is not None:
        scalars["noise_sd"] = spread
    return Evaluation(per_image, scalars)


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
