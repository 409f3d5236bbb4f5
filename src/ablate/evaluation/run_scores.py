"""The scores of a run: of its generator, and of re-simulation, the same frames with other scatterers and paths."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from filelock import FileLock

from ablate.dataset import Part, counted_clipping
from ablate.evaluation.scorer import ImageSource, Scorer, Scores
from ablate.metrics import METRICS, METRICS_VERSION
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

    The first of several jobs computes and stores it beside the data set, and the others wait. It is not stored where
    one of the metrics is a user's own, because the function may change under its name.
    """
    scorer = replace(scorer, settings=replace(scorer.settings, noise_draws=2))
    images_of = resimulation_images(scorer.pairs)
    if not scorer.metrics.keys() <= METRICS.keys():
        return scorer.score(part, images_of, draws_noise=True)
    known_by = {"version": METRICS_VERSION, "metrics": sorted(scorer.metrics), "inception": bool(scorer.inception)}
    kept = scorer.pairs.folder / "resimulation" / f"{part.name}-{digest(known_by)}.json"
    kept.parent.mkdir(exist_ok=True)
    with FileLock(kept.with_suffix(".lock")):
        if read := known_json(kept):
            return Scores(pd.DataFrame(read["per_image"]), read["scalars"])
        scores = scorer.score(part, images_of, draws_noise=True)
        write_json(kept, {"per_image": scores.per_image.to_dict("list"), "scalars": scores.scalars})
        return scores


def score_run(scorer: Scorer, images_of: ImageSource, draws_noise: bool) -> Scores:
    """Score a generator, and re-simulation where the data set has it; arguments as for `Scorer.score`.

    The notes also say which share of the generator's output was clipped, and whether a frame differs when it is
    rendered again with the same noise.
    """
    tables: list[pd.DataFrame] = []
    scalars: dict[str, float] = {}
    notes: tuple[str, ...] = ()
    for part, prefix in ((Part.validation, "val"), (Part.test, "test")):
        with counted_clipping() as counts:
            scored = {MODEL: scorer.score(part, images_of, draws_noise)}
        if "resimulation" in scorer.pairs.maps:
            scored[RESIMULATED] = resimulation_scores(scorer, part)
        for source, scores in scored.items():
            tables.append(scores.per_image.assign(source=source, split=part.name))
            mark = FLOOR_PREFIX if source == RESIMULATED else ""
            scalars |= {f"{prefix}/{mark}{name}": value for name, value in scores.scalars.items()}
        notes = (*scored[MODEL].notes, *_about_output(counts, images_of, scorer.pairs.frames(part)[:1]))
    return Scores(pd.concat(tables, ignore_index=True), scalars, notes)


def _about_output(counts: list[tuple[int, int]], images_of: ImageSource, frame: np.ndarray) -> list[str]:
    """What is wrong with a generator's output, a sentence each: clipped pixels, a frame that differs when repeated."""
    notes = []
    clipped, pixels = (sum(column) for column in zip((0, 0), *counts, strict=True))
    if clipped > MOST_CLIPPED * pixels:
        notes.append(
            f"The generator's output lies outside [-1, 1] in {100 * clipped / pixels:.2g} % of the pixels of the fan; "
            "these values were clipped to black or white."
        )
    once, again = (images_of(frame, 0).astype(np.int16) for _ in range(2))
    apart = int(np.abs(once - again).max(initial=0))
    if apart > MOST_APART:
        notes.append(
            f"The generator renders frame {frame[0]} differently each time with the same noise, by up to {apart} grey "
            "levels (dropout that is left on does this): its scores differ from one scoring to the next."
        )
    return notes
