"""Scores of the images of some frames as values, and why a metric has none."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from ablate.dataset import Part
from ablate.metrics import METRICS, FeatureKind, InceptionFeatures, Metric, patches_inside
from ablate.metrics.features import CENTRE, PATCH
from ablate.metrics.metric import BOUNDS, SCALAR_PREFIXES

#: What stands before the scalars of a part in the scores of a run.
PREFIXES = {Part.validation: "val/", Part.test: "test/"}


@dataclass(frozen=True)
class Scores:
    """Scores of the images of some frames, or of a run.

    Attributes
    ----------
    per_image : DataFrame
        Columns frame, site, metric, value, and in the scores of a run source (`model`, or that of a baseline) and
        split: infinite PSNR where an image equals its target, NaN or infinite where a user's own metric failed.
    scalars : dict of str to float
        The mean of each per-image metric over its finite values, and what only a set of images has (`fd_speckle`, ...);
        `_lower` and `_upper` are the ends of a 95 % interval. Those of a run have names such as `test/psnr`,
        `test/floor_psnr` and `val/psnr`.
    missing : dict of str to str
        By metric that was asked for and not computed the reason, the end of a sentence.
    unrepeated : dict of str to str
        By metric of the user's that gave another value of the same image when it was asked again, the values.
    about_output : tuple of str
        Of a run, sentences about values that were clipped, and images that differ when they are rendered again.
    """

    per_image: pd.DataFrame
    scalars: dict[str, float]
    missing: dict[str, str] = field(default_factory=dict)
    unrepeated: dict[str, str] = field(default_factory=dict)
    about_output: tuple[str, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences about metrics that were not computed, those of one reason together, and about what is unsteady."""
        by_reason: dict[str, list[str]] = {}
        for name, reason in self.missing.items():
            by_reason.setdefault(reason, []).append(name)
        not_computed = [f"{' and '.join(names)}: not computed, {reason}." for reason, names in by_reason.items()]
        why = "it draws random numbers, or keeps what it has seen: its scores differ from one scoring to the next"
        unrepeated = [f"{name}: {values} when it was asked again; {why}." for name, values in self.unrepeated.items()]
        return (*not_computed, *unrepeated, *self.about_output)

    def of_metric(self, name: str) -> Scores:
        """The scores of one metric, as if it alone had been asked for."""
        scalars = {
            f"{part}{mark}{name}{bound}"
            for part in ("", *PREFIXES.values())
            for mark in SCALAR_PREFIXES.values()
            for bound in ("", *(f"_{side}" for side in BOUNDS))
        }
        return Scores(
            per_image=self.per_image[self.per_image["metric"] == name].reset_index(drop=True),
            scalars={key: value for key, value in self.scalars.items() if key in scalars},
            missing={key: reason for key, reason in self.missing.items() if key == name},
            unrepeated={key: values for key, values in self.unrepeated.items() if key == name},
            about_output=self.about_output,
        )


def joined(scores: Sequence[Scores]) -> Scores:
    """The scores of different metrics of the same images as one; rows are frame by frame, as of one scoring."""
    scalars: dict[str, float] = {}
    missing: dict[str, str] = {}
    unrepeated: dict[str, str] = {}
    about_output: dict[str, None] = {}
    for each in scores:
        scalars |= each.scalars
        missing |= each.missing
        unrepeated |= each.unrepeated
        about_output |= dict.fromkeys(each.about_output)
    per_image = _frame_by_frame([each.per_image for each in scores])
    return Scores(per_image, scalars, missing, unrepeated, tuple(about_output))


def averaged(scores: Sequence[Scores]) -> Scores:
    """Means of several scorings of the same frames, such as of the weights of several steps of a training.

    A value that one of them lacks is the mean of the others. Reasons and sentences are those of the last.
    """
    if len(scores) == 1:
        return scores[0]
    last = scores[-1]
    tables = pd.concat([each.per_image for each in scores], ignore_index=True)
    keys = [column for column in tables if column != "value"]
    means = tables.groupby(keys, sort=False, dropna=False)["value"].mean()
    per_image = means.reset_index().reindex(columns=last.per_image.columns)
    names = dict.fromkeys(name for each in scores for name in each.scalars)
    scalars = {name: float(np.mean([each.scalars[name] for each in scores if name in each.scalars])) for name in names}
    return Scores(per_image, scalars, last.missing, last.unrepeated, last.about_output)


def _frame_by_frame(tables: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """Tables of metrics one below the other, and the rows of a frame, of one source and part, together."""
    with_rows = [table for table in tables if len(table)] or tables[:1]
    table = pd.concat(with_rows, ignore_index=True)
    run_columns = [column for column in ("source", "split") if column in table]
    keys = [table["frame"].to_numpy(), *(pd.factorize(table[column])[0] for column in run_columns)]
    return table.iloc[np.lexsort(keys)].reset_index(drop=True)  # the last key leads; equal rows stay in order


def not_computed(
    metrics: Collection[Metric], mask: np.ndarray, frames: int, inception: InceptionFeatures | None
) -> dict[str, str]:
    """Reasons, the ends of sentences, why some distances cannot be computed, by their names.

    Parameters
    ----------
    metrics : collection of Metric
        Those that are asked for.
    mask : (H, W) bool
        The fan of each frame.
    frames : int
        How many there are.
    inception : InceptionFeatures or None
        None where no weights were given.
    """
    reasons: dict[FeatureKind, str] = {}
    texture_metrics = " and ".join(metric.name for metric in METRICS.values() if metric.uses(FeatureKind.speckle))
    instead = f"; {texture_metrics} are these distances of a texture descriptor, not of Inception's features"
    if min(mask.shape) < CENTRE:
        size = f"{mask.shape[0]} x {mask.shape[1]} px"
        too_small = f"frames of {size} are smaller than the {CENTRE} px centre that they are made of"
        reasons[FeatureKind.inception] = too_small + instead
    elif inception is None:
        no_weights = "no Inception weights were given (evaluation.inception=path/to/file or =download)"
        reasons[FeatureKind.inception] = no_weights + instead
    if patches_inside(mask, PATCH).sum() * frames < 2:
        reasons[FeatureKind.speckle] = f"fewer than two patches of {PATCH} x {PATCH} px lie inside the fan"
    return {metric.name: reason for features, reason in reasons.items() for metric in metrics if metric.uses(features)}


def without_values(metrics: Collection[Metric], per_image: pd.DataFrame) -> dict[str, str]:
    """The reason, the end of a sentence, why metrics of images have no value of any frame, by their names."""
    what = (
        "bone, shadow, tissue, patches in the fan, a map of attenuation, a known depth of the pixels, or the same "
        "frame after a motion"
    )
    names = {metric.name for metric in metrics if not metric.of_set} - set(per_image["metric"])
    return dict.fromkeys(sorted(names), f"as no frame has what is needed ({what})")
