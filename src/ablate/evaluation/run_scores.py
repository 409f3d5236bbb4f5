"""The scores of a run: of its generator, and of re-simulation, the same frames with other scatterers and paths."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from filelock import FileLock

from ablate.dataset import Part, counted_clipping
from ablate.evaluation.scorer import ImageSource, Scorer
from ablate.evaluation.scores import PREFIXES, Scores, joined
from ablate.metrics import METRICS, METRICS_VERSION, FeatureKind, Metric
from ablate.metrics.metric import FLOOR_PREFIX, MODEL, RESIMULATED
from ablate.storage import digest, known_json, write_json

if TYPE_CHECKING:
    from ablate.dataset import Pairs  # only here: frames that are read otherwise need no Zarr

MOST_CLIPPED = 0.001  # of the fan's pixels, before a note says so
MOST_APART = 1  # grey levels between two renderings; a GPU may round differently each time


def resimulation_images(pairs: Pairs) -> ImageSource:
    """The re-simulated frames; an odd noise draw gives the target, which has other scatterers and paths again."""
    return lambda frames, draw: pairs.read("target" if draw % 2 else "resimulation", frames)


def resimulation_scores(scorer: Scorer, part: Part) -> Scores:
    """The floor, or the level, of every metric, which is the same for every run on a data set.

    The first of several jobs computes that of a metric and stores it beside the data set, and the others wait. A user's
    own metric is computed each time, because the function may change under its name.
    """
    scorer = replace(scorer, settings=replace(scorer.settings, noise_draws=2))
    package = {name: metric for name, metric in scorer.metrics.items() if name in METRICS}
    own = {name: metric for name, metric in scorer.metrics.items() if name not in METRICS}
    of_metrics = _kept_scores(replace(scorer, metrics=package), part)
    if own:
        scored = _score_resimulation(replace(scorer, metrics=own), part)
        of_metrics |= {name: scored.of_metric(name) for name in own}
    return joined([of_metrics[name] for name in scorer.metrics])


def _score_resimulation(scorer: Scorer, part: Part) -> Scores:
    moved_images = None if scorer.moved is None else resimulation_images(scorer.moved.pairs)
    return scorer.score(part, resimulation_images(scorer.pairs), draws_noise=True, moved_images=moved_images)


def _kept_scores(scorer: Scorer, part: Part) -> dict[str, Scores]:
    """Those of each metric from its file beside the data set; files that are missing or damaged are made."""
    folder = scorer.pairs.folder / "resimulation"
    folder.mkdir(exist_ok=True)
    files = {name: folder / f"{part.name}-{_kept_as(scorer, metric)}.json" for name, metric in scorer.metrics.items()}
    with FileLock(folder / f"{part.name}.lock"):
        kept = {name: _read_kept(file) for name, file in files.items()}
        of_metrics = {name: scores for name, scores in kept.items() if scores is not None}
        lacking = {name: metric for name, metric in scorer.metrics.items() if name not in of_metrics}
        if lacking:
            scored = _score_resimulation(replace(scorer, metrics=lacking), part)
            for name in lacking:
                of_metrics[name] = scored.of_metric(name)
                _write_kept(files[name], of_metrics[name])
    return of_metrics


def _kept_as(scorer: Scorer, metric: Metric) -> str:
    """The name of a metric and a digest of what else decides its scores."""
    with_inception = metric.uses(FeatureKind.inception) and scorer.inception is not None
    return f"{metric.name}-{digest({'version': METRICS_VERSION, 'inception': with_inception})}"


def _read_kept(file: Path) -> Scores | None:
    content = known_json(file)
    if not content:
        return None
    return Scores(pd.DataFrame(content["per_image"]), content["scalars"], content["missing"])


def _write_kept(file: Path, scores: Scores) -> None:
    per_image = scores.per_image.to_dict("list")
    write_json(file, {"per_image": per_image, "scalars": scores.scalars, "missing": scores.missing})


def score_run(
    scorer: Scorer, images_of: ImageSource, draws_noise: bool, moved_images: ImageSource | None = None
) -> Scores:
    """Score a generator on validation and test frames, and re-simulation where the data set has it.

    Which metrics are asked for is said by `scorer.metrics`, and `Scores.of_metric` gives those of each. They are the
    same whichever others are asked for. What is said about the generator's output, which share of it was clipped and
    whether a frame differs when it is rendered again with the same noise, is of the test frames.

    Parameters
    ----------
    scorer : Scorer
        Of the data set.
    images_of : ImageSource
        Renders its frames.
    draws_noise : bool
        Whether a second noise draw can give another image.
    moved_images : ImageSource, optional
        Renders the frames of `scorer.moved`; without it the metrics of motion are left out.
    """
    frame = scorer.pairs.frames(Part.test)[:1]
    once = images_of(frame, 0)  # before all others
    tables: list[pd.DataFrame] = []
    scalars: dict[str, float] = {}
    missing: dict[Part, dict[str, str]] = {}
    unrepeated: dict[str, str] = {}
    for part, prefix in PREFIXES.items():
        with counted_clipping() as clipping:
            scored = {MODEL: scorer.score(part, images_of, draws_noise, moved_images=moved_images)}
        if "resimulation" in scorer.pairs.maps:
            scored[RESIMULATED] = resimulation_scores(scorer, part)
        for source, scores in scored.items():
            tables.append(scores.per_image.assign(source=source, split=part.name))
            mark = FLOOR_PREFIX if source == RESIMULATED else ""
            scalars |= {f"{prefix}{mark}{name}": value for name, value in scores.scalars.items()}
        missing[part] = scored[MODEL].missing
        unrepeated |= scored[MODEL].unrepeated
    of_run = _of_both_parts(missing[Part.validation], missing[Part.test])
    about_output = (*_clipped(clipping), *_unrepeated(int(frame[0]), once, images_of(frame, 0)))
    return Scores(pd.concat(tables, ignore_index=True), scalars, of_run, unrepeated, about_output)


def _of_both_parts(validation: dict[str, str], test: dict[str, str]) -> dict[str, str]:
    """Why metrics are missing on test frames, and those that are missing on validation frames alone."""
    alone = {name: f"{reason} (of the validation frames alone)" for name, reason in validation.items()}
    return test | {name: reason for name, reason in alone.items() if name not in test}


def _clipped(counts: list[tuple[int, int]]) -> list[str]:
    """A sentence if pixels of the fan were clipped, from the clipped and all of each image."""
    clipped = sum(count for count, _ in counts)
    pixels = sum(count for _, count in counts)
    if clipped <= MOST_CLIPPED * pixels:
        return []
    return [
        f"The generator's output lies outside [-1, 1] in {100 * clipped / pixels:.2g} % of the pixels of the fan; "
        "these values were clipped to black or white."
    ]


def _unrepeated(frame: int, once: np.ndarray, again: np.ndarray) -> list[str]:
    """A sentence if a frame that was rendered before all others, (1, H, W) uint8, differs after them."""
    apart = int(np.abs(once.astype(np.int16) - again).max(initial=0))
    if apart <= MOST_APART:
        return []
    return [
        f"The generator renders frame {frame} differently each time with the same noise, by up to {apart} grey levels "
        "(dropout that is left on does this, and what it keeps of other frames): its scores differ from one scoring to "
        "the next."
    ]
