"""Scores of images of the frames of a data set, such as those of a trained generator, and reasons for gaps in them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from tqdm import tqdm

from ablate.anatomy import Tissue, TissueKind
from ablate.dataset import Part
from ablate.evaluation.settings import EvaluationSettings
from ablate.metrics import (
    METRICS,
    FeatureKind,
    InceptionFeatures,
    Metric,
    Pair,
    bootstrap_interval,
    choose_metrics,
    evaluate_image,
    patches_inside,
    speckle_features,
)
from ablate.metrics.features import CENTRE, PATCH
from ablate.metrics.metric import BOUNDS, SCORE_COLUMNS
from ablate.threads import side_by_side
from ablate.ultrasound import Probe, fan_mask
from ablate.ultrasound.probe import pixel_polar, pixel_size_mm

if TYPE_CHECKING:
    from ablate.dataset import Pairs  # only here: frames that are read otherwise need no Zarr

#: What gives images for frames: (numbers of the frames (k,), number of the noise draw) -> (k, H, W) uint8.
ImageSource = Callable[[np.ndarray, int], np.ndarray]
Features = tuple[np.ndarray, np.ndarray]  # of images and of their targets, a row each
_BATCH = 8
_SAME_FAN = 0.98  # of the pixels of two fans together lie in both


@dataclass(frozen=True)
class Scores:
    """Scores of the images of some frames.

    `per_image` has columns frame, site, metric, value: infinite PSNR where an image equals its target, NaN or infinite
    where a user's own metric failed. The scores of a run have the columns source (`model`, `resimulation`) and split
    too. `scalars` are the mean of each per-image metric over its finite values, and what only a set of images has
    (`fd_speckle`, ...); `_lower` and `_upper` are the ends of a 95 % interval. The scores of a run have names such as
    `test/psnr`, `test/floor_psnr` and `val/psnr`. `notes` tell of metrics that were asked for and not computed. Of a
    run they also tell of values that were clipped, and of images that differ when they are rendered again.
    """

    per_image: pd.DataFrame
    scalars: dict[str, float]
    notes: tuple[str, ...] = ()


def tissue_labels(
    tissues: tuple[Tissue, ...], kinds: Collection[TissueKind] = (TissueKind.soft, TissueKind.bone)
) -> np.ndarray:
    """Labels of some kinds of tissue, uint8; those of soft tissue and bone leave out gas and fluid."""
    return np.array([i + 1 for i, t in enumerate(tissues) if t.kind in kinds], np.uint8)


def describes_fan(probe: Probe, mask: np.ndarray) -> bool:
    """Whether a fan is that of a probe, up to a few pixels; only then are the depths of the pixels known."""
    expected = fan_mask(probe, (mask.shape[0], mask.shape[1]))
    return bool((expected & mask).sum() >= _SAME_FAN * (expected | mask).sum())


def not_computed(
    metrics: Collection[Metric], mask: np.ndarray, frames: int, inception: InceptionFeatures | None
) -> tuple[frozenset[str], tuple[str, ...]]:
    """Return the names of distances that cannot be computed, and the reasons, a sentence each.

    `mask`, (H, W) bool, is the fan of each of `frames` frames.
    """
    of_inception, of_texture = FeatureKind.inception, FeatureKind.speckle
    reasons = {}
    if min(mask.shape) < CENTRE:
        size = f"{mask.shape[0]} x {mask.shape[1]} px"
        reasons[of_inception] = f"frames of {size} are smaller than the {CENTRE} px centre that they are made of"
    elif inception is None:
        reasons[of_inception] = "no Inception weights were given (evaluation.inception=path/to/file or =download)"
    if patches_inside(mask, PATCH).sum() * frames < 2:
        reasons[of_texture] = f"fewer than two patches of {PATCH} x {PATCH} px lie inside the fan"
    missing = {features: [m.name for m in metrics if m.uses(features)] for features in reasons}
    notes = {kind: f"{' and '.join(names)}: not computed, {reasons[kind]}" for kind, names in missing.items() if names}
    if of_inception in notes:
        others = " and ".join(m.name for m in METRICS.values() if m.uses(of_texture))
        notes[of_inception] += f"; {others} are these distances of a texture descriptor, not of Inception's features"
    return frozenset().union(*missing.values()), tuple(f"{note}." for note in notes.values())


@dataclass(frozen=True, eq=False)
class Scorer:
    """Scores images against the targets of a data set.

    Metrics that need what the data set does not hold are left out.
    """

    pairs: Pairs
    tissues: tuple[Tissue, ...]  # behind the labels 1, 2, ... of the segmentation
    probe: Probe
    settings: EvaluationSettings = EvaluationSettings()
    metrics: Mapping[str, Metric] = field(default_factory=choose_metrics)
    inception: InceptionFeatures | None = None  # from `load_inception`; without it there is no FID and no KID

    @cached_property
    def _mask(self) -> np.ndarray:
        return self.pairs.mask()

    @cached_property
    def _sizes(self) -> dict[str, Any]:
        """Depth and size of a pixel, where they are known."""
        if not describes_fan(self.probe, self._mask):
            return {}
        shape = self.pairs.shape
        return {"depth_mm": pixel_polar(self.probe, shape)[0], "pixel_mm": pixel_size_mm(self.probe, shape)}

    def score(self, part: Part, images_of: ImageSource, draws_noise: bool, frames: np.ndarray | None = None) -> Scores:
        """Score images of the frames of one part, or of some of them, in as many threads as torch is set to use.

        `draws_noise` tells whether a second noise draw can give another image; where it cannot, each frame is rendered
        once.
        """
        frames = self.pairs.frames(part) if frames is None else frames
        sites = self.pairs.sites[frames]
        missing, notes = not_computed(self.metrics.values(), self._mask, len(frames), self.inception)
        computed = [metric for name, metric in self.metrics.items() if name not in missing]
        speckle, fid = ([m for m in computed if m.uses(kind)] for kind in (FeatureKind.speckle, FeatureKind.inception))
        # A metric of the user's may not be made for threads, such as one that draws from NumPy's global generator.
        ours = self.metrics.keys() <= METRICS.keys()
        draws = self.settings.noise_draws if any(metric.of_draws for metric in computed) else 1

        def score_batch(batch: np.ndarray, images: np.ndarray) -> list[tuple[dict[str, float], Features]]:
            if draws_noise:
                drawn = np.stack([images, *(images_of(batch, draw) for draw in range(1, draws))], axis=1)
            else:
                drawn = np.broadcast_to(images[:, None], (len(images), min(draws, 2), *images.shape[1:]))
            tasks = [partial(self._score_frame, *of, bool(speckle)) for of in zip(batch, drawn, strict=True)]
            return side_by_side(*tasks) if ours else [task() for task in tasks]

        scored: list[tuple[dict[str, float], Features]] = []
        of_inception: list[Features] = []
        with tqdm(total=len(frames), desc=f"evaluate {part.name}", leave=False, mininterval=1.0, disable=None) as bar:
            for start in range(0, len(frames), _BATCH):
                batch = frames[start : start + _BATCH]
                images = images_of(batch, 0)
                scored += score_batch(batch, images)
                if fid and self.inception is not None:
                    of_inception.append((self.inception(images), self.inception(self.pairs.read("target", batch))))
                bar.update(len(batch))
        per_image = _table(part, frames, sites, [values for values, _ in scored])
        finite = per_image[np.isfinite(per_image["value"])]
        scalars = {str(name): float(value) for name, value in finite.groupby("metric")["value"].mean().items()}
        for of_sets, features in ((speckle, [texture for _, texture in scored]), (fid, of_inception)):
            if of_sets:
                rendered, wanted = (np.concatenate(side) for side in zip(*features, strict=True))
                groups = np.repeat(sites, len(rendered) // len(sites))  # rows of features go image by image
                scalars |= _distances(of_sets, rendered, wanted, groups)
        if absent := sorted({m.name for m in computed if not m.of_set} - set(per_image["metric"])):
            what = "bone, shadow, tissue, patches in the fan, a map of attenuation, or a known depth of the pixels"
            notes = (*notes, f"{' and '.join(absent)}: not computed, as no frame has what is needed ({what}).")
        return Scores(per_image, scalars, notes)

    def _score_frame(self, frame: int, draws: np.ndarray, with_texture: bool) -> tuple[dict[str, float], Features]:
        """The metrics of one frame, and the speckle features of image and target where they are wanted."""
        image = draws[0]
        target, labels = self.pairs.stored("target", frame), self.pairs.stored("segmentation", frame)
        attenuation = self.pairs.read("attenuation", [frame])[0] if "attenuation" in self.pairs.maps else None
        solid = np.isin(labels, tissue_labels(self.tissues))
        bone = np.isin(labels, tissue_labels(self.tissues, [TissueKind.bone]))
        maps: dict[str, Any] = {"attenuation": attenuation, "segmentation": labels, **self._sizes}
        several = draws if len(draws) > 1 else None
        pair = Pair(image, target, self._mask, tissue_mask=solid, bone_mask=bone, draws=several, **maps)
        try:
            values = evaluate_image(pair, self.metrics.values())
        except Exception as error:
            error.add_note(f"of frame {frame}")
            raise
        if not with_texture:
            return values, (np.empty(0), np.empty(0))
        return values, (speckle_features(image[None], self._mask), speckle_features(target[None], self._mask))


def _distances(metrics: list[Metric], rendered: np.ndarray, wanted: np.ndarray, sites: np.ndarray) -> dict[str, float]:
    """Distances between features of images and of their targets, (n, d) each; intervals, over `sites`, need two."""
    scalars = {}
    for name, of_set in ((metric.name, metric.of_set) for metric in metrics if metric.of_set):
        scalars[name] = of_set.distance(rendered, wanted)
        if len(np.unique(sites)) > 1:
            ends = bootstrap_interval(of_set.distance, rendered, wanted, sites, of_set.resamples)
            scalars |= {f"{name}_{side}": end for side, end in zip(BOUNDS, ends, strict=True)}
    return scalars


def _table(part: Part, frames: np.ndarray, sites: np.ndarray, values: list[dict[str, float]]) -> pd.DataFrame:
    """One row a frame and metric."""
    rows = [
        (int(frame), int(site), name, value)
        for frame, site, of_frame in zip(frames, sites, values, strict=True)
        for name, value in of_frame.items()
    ]
    table = pd.DataFrame(rows, columns=list(SCORE_COLUMNS)).astype({"value": "float64"})
    infinite = np.isinf(table["value"]) & ~table["metric"].isin(METRICS)  # PSNR of identical images is, by definition
    for (name, value), rows in table[table["value"].isna() | infinite].groupby(["metric", "value"], dropna=False):
        word, named = "NaN" if np.isnan(value) else "infinite", ", ".join(rows["frame"].astype(str))
        logging.getLogger(__name__).warning("%s is %s on %s frame %s: not in its mean", name, word, part.name, named)
    return table
