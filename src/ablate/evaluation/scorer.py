"""Scores of images of the frames of a data set, such as those of a trained generator."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from tqdm import tqdm

from ablate.anatomy import Tissue, TissueKind
from ablate.dataset import Part
from ablate.evaluation.known import describes_fan, tissue_labels
from ablate.evaluation.moved import motion_values
from ablate.evaluation.scores import Scores, not_computed, without_values
from ablate.evaluation.settings import EvaluationSettings
from ablate.evaluation.values import means, values_table
from ablate.metrics import (
    FeatureKind,
    InceptionFeatures,
    Metric,
    Pair,
    Pixels,
    bootstrap_interval,
    choose_metrics,
    evaluate_image,
    is_own,
    speckle_features,
)
from ablate.metrics.metric import BOUNDS
from ablate.networks import Space
from ablate.threads import side_by_side
from ablate.ultrasound import Probe
from ablate.ultrasound.probe import pixel_polar, pixel_size_mm

if TYPE_CHECKING:
    from ablate.dataset import Pairs  # only here: frames that are read otherwise need no Zarr
    from ablate.dataset.motion import Moved

#: What gives images for frames: (numbers of the frames (k,), number of the noise draw) -> (k, H, W) uint8.
ImageSource = Callable[[np.ndarray, int], np.ndarray]
Features = tuple[np.ndarray, np.ndarray]  # of images and of their targets, a row each
_BATCH = 8
_REPEATED = 1e-6  # of a value, how far it may be from the same again: threads may round otherwise


class _Scored(NamedTuple):
    """Of some frames: the values of each by metric, and by their kind the features of all."""

    values: list[dict[str, float]]
    features: dict[FeatureKind, Features]


@dataclass(frozen=True, eq=False)
class Scorer:
    """Scores images against the targets of a data set.

    The scores of a metric do not depend on which others are asked for, and metrics that need what the data set does not
    hold are left out.

    Attributes
    ----------
    pairs : Pairs
        The data set.
    tissues : tuple of Tissue
        Behind the labels 1, 2, ... of the segmentation.
    probe : Probe
        Tells depths and sizes in mm where its fan is that of the data set.
    settings : EvaluationSettings
    metrics : dict of str to Metric
        Those that are asked for, by name.
    inception : InceptionFeatures or None
        From `load_inception`; without it there is no FID and no KID.
    moved : Moved or None
        Some test frames after motions of the probe, where there are such.
    """

    pairs: Pairs
    tissues: tuple[Tissue, ...]
    probe: Probe
    settings: EvaluationSettings = EvaluationSettings()
    metrics: Mapping[str, Metric] = field(default_factory=choose_metrics)
    inception: InceptionFeatures | None = None
    moved: Moved | None = None

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

    def score(
        self,
        part: Part,
        images_of: ImageSource,
        draws_noise: bool,
        frames: np.ndarray | None = None,
        moved_images: ImageSource | None = None,
        beam_images: ImageSource | None = None,
    ) -> Scores:
        """Score images of the frames of one part, in as many threads as torch is set to use.

        Parameters
        ----------
        part : Part
            Of the data set.
        images_of : ImageSource
            What renders the frames.
        draws_noise : bool
            Whether a second noise draw can give another image; where it cannot, each frame is rendered once.
        frames : (k,) int, optional
            Numbers of some frames of the part; all without it.
        moved_images : ImageSource, optional
            What renders the frames of `moved`; without it the metrics of motion are left out.
        beam_images : ImageSource, optional
            What renders the frames in beam space, (k, rows, scanlines) uint8, where the renderer works there.
        """
        frames = self.pairs.frames(part) if frames is None else frames
        missing = not_computed(self.metrics.values(), self._mask, len(frames), self.inception)
        computed = [metric for name, metric in self.metrics.items() if name not in missing]
        batches: list[_Scored] = []
        first = np.empty(0)
        with tqdm(total=len(frames), desc=f"evaluate {part.name}", leave=False, mininterval=1.0, disable=None) as bar:
            for start in range(0, len(frames), _BATCH):
                batch = frames[start : start + _BATCH]
                drawn = self._drawn(batch, images_of, draws_noise)
                scored = self._score_batch(batch, drawn, computed)
                if beam_images is not None:
                    self._score_on_grid(batch, beam_images(batch, 0), scored.values)
                batches.append(scored)
                first = first if start else drawn
                bar.update(len(batch))
        unrepeated = self._unrepeated(frames, first, batches[0].values) if batches else {}
        sites = self.pairs.sites[frames]
        values = [values for batch in batches for values in batch.values]
        if self.moved is not None and moved_images is not None and part is Part.test:
            motion = motion_values(computed, self.moved, self.tissues, images_of, moved_images)
            values = [frame_values | motion.get(int(k), {}) for k, frame_values in zip(frames, values, strict=True)]
        per_image = values_table(part, frames, sites, [self._in_order(frame_values) for frame_values in values])
        scalars = means(per_image)
        for kind in (FeatureKind.speckle, FeatureKind.inception):
            distances = [metric for metric in computed if metric.uses(kind)]
            if distances:
                scalars |= _distances(distances, [batch.features[kind] for batch in batches], sites)
        expected = [metric for metric in computed if not metric.of_motion or part is Part.test]
        return Scores(per_image, scalars, missing | without_values(expected, per_image), unrepeated)

    def _unrepeated(self, frames: np.ndarray, drawn: np.ndarray, values: list[dict[str, float]]) -> dict[str, str]:
        """Of each metric of the user's that gives other values of the first frames when all are scored, both values."""
        # Values of metrics of the network's grid were computed elsewhere.
        asked_again = {name: m for name, m in self.metrics.items() if is_own(m) and m.pixels is Pixels.image}
        if not asked_again:
            return {}
        repeating = replace(self, metrics=asked_again)
        found: dict[str, str] = {}
        for frame, draws, before in zip(frames, drawn, values, strict=False):
            after, _ = repeating._score_frame(int(frame), draws, with_texture=False)
            for name in asked_again.keys() - found.keys():
                once, again = before.get(name, math.nan), after.get(name, math.nan)
                both_nan = math.isnan(once) and math.isnan(again)
                if not both_nan and not math.isclose(once, again, rel_tol=_REPEATED):
                    found[name] = f"{once:.4g} of frame {frame}, and {again:.4g}"
        return {name: found[name] for name in self.metrics if name in found}

    def _drawn(self, frames: np.ndarray, images_of: ImageSource, draws_noise: bool) -> np.ndarray:
        """Images of some frames with as many draws of the noise as the metrics read, (k, draws, H, W) uint8."""
        reads_draws = any(metric.of_draws for metric in self.metrics.values())
        images = images_of(frames, 0)
        if not reads_draws:
            return images[:, None]
        if not draws_noise:  # two that are equal
            return np.broadcast_to(images[:, None], (len(images), 2, *images.shape[1:]))
        return np.stack([images, *(images_of(frames, draw) for draw in range(1, self.settings.noise_draws))], axis=1)

    def _score_batch(self, frames: np.ndarray, drawn: np.ndarray, computed: Collection[Metric]) -> _Scored:
        """Values and features of frames of which `drawn` holds the draws, (k, draws, H, W) uint8."""
        kinds = {kind for kind in FeatureKind if any(metric.uses(kind) for metric in computed)}
        with_texture = FeatureKind.speckle in kinds
        tasks = [
            partial(self._score_frame, int(frame), draws, with_texture)
            for frame, draws in zip(frames, drawn, strict=True)
        ]
        # A metric of the user's may not be made for threads, such as one that draws from NumPy's global generator.
        has_own = any(map(is_own, self.metrics.values()))
        scored = [task() for task in tasks] if has_own else side_by_side(*tasks)
        features: dict[FeatureKind, Features] = {}
        if with_texture:
            features[FeatureKind.speckle] = _stacked([texture for _, texture in scored])
        if FeatureKind.inception in kinds and self.inception is not None:
            images = np.ascontiguousarray(drawn[:, 0])
            features[FeatureKind.inception] = self.inception(images), self.inception(self.pairs.read("target", frames))
        return _Scored([values for values, _ in scored], features)

    def _score_frame(self, frame: int, draws: np.ndarray, with_texture: bool) -> tuple[dict[str, float], Features]:
        """The metrics of one frame, and the speckle features of image and target where they are wanted."""
        pair = self._pair(frame, draws[0])
        try:
            values = evaluate_image(pair, [metric for metric in self.metrics.values() if not metric.of_draws])
            if len(draws) > 1:
                draw_metrics = [metric for metric in self.metrics.values() if metric.of_draws]
                values |= evaluate_image(replace(pair, draws=draws), draw_metrics)
        except Exception as error:
            error.add_note(f"of frame {frame}")
            raise
        if not with_texture:
            return values, (np.empty(0), np.empty(0))
        image_features, target_features = (
            speckle_features(shown[None], self._mask) for shown in (pair.prediction, pair.target)
        )
        return values, (image_features, target_features)

    def _score_on_grid(self, frames: np.ndarray, images: np.ndarray, values: list[dict[str, float]]) -> None:
        """Replace the values of metrics of the network's grid by those in beam space."""
        metrics = [metric for metric in self.metrics.values() if metric.pixels is Pixels.network]
        mask = self.pairs.mask(Space.beam)
        for frame, image, frame_values in zip(frames, images, values, strict=True):
            labels = self.pairs.stored("segmentation", int(frame), Space.beam)
            target = self.pairs.stored("target", int(frame), Space.beam)
            pair = Pair(image, target, mask, np.isin(labels, tissue_labels(self.tissues)), segmentation=labels)
            for metric in metrics:
                frame_values.pop(metric.name, None)
            frame_values |= evaluate_image(pair, metrics)

    def _in_order(self, values: Mapping[str, float]) -> dict[str, float]:
        """Values of a frame in the order of the metrics."""
        return {name: values[name] for name in self.metrics if name in values}

    def _pair(self, frame: int, image: np.ndarray) -> Pair:
        """An image beside its target, with the maps that the data set has of the frame."""
        labels = self.pairs.stored("segmentation", frame)
        attenuation = self.pairs.read("attenuation", [frame])[0] if "attenuation" in self.pairs.maps else None
        return Pair(
            prediction=image,
            target=self.pairs.stored("target", frame),
            mask=self._mask,
            tissue_mask=np.isin(labels, tissue_labels(self.tissues)),
            bone_mask=np.isin(labels, tissue_labels(self.tissues, [TissueKind.bone])),
            attenuation=attenuation,
            segmentation=labels,
            **self._sizes,
        )


def _stacked(features: Collection[Features]) -> Features:
    """Features of several batches of images as one array, and those of their targets."""
    rendered, wanted = zip(*features, strict=True)
    return np.concatenate(rendered), np.concatenate(wanted)


def _distances(metrics: Collection[Metric], batches: Collection[Features], sites: np.ndarray) -> dict[str, float]:
    """Distances between features of images and of their targets; intervals, over the sites, need two.

    `sites`, (n,) int, is that of each image; rows of features go image by image.
    """
    rendered, wanted = _stacked(batches)
    groups = np.repeat(sites, len(rendered) // len(sites))
    scalars = {}
    for metric in metrics:
        if metric.of_set is None:
            continue
        # copies, as one of the user's may write to them
        scalars[metric.name] = metric.of_set.distance(rendered.copy(), wanted.copy())
        if len(np.unique(sites)) > 1:
            ends = bootstrap_interval(metric.of_set.distance, rendered, wanted, groups, metric.of_set.resamples)
            scalars |= {f"{metric.name}_{side}": end for side, end in zip(BOUNDS, ends, strict=True)}
    return scalars
