"""The scores of a run: of its generator, and of the baselines that need none."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ablate.dataset import Part, counted_clipping
from ablate.evaluation.baselines import Baseline, baseline_scores
from ablate.evaluation.scorer import ImageSource, Scorer
from ablate.evaluation.scores import PREFIXES, Scores
from ablate.metrics.metric import MODEL, SCALAR_PREFIXES

MOST_CLIPPED = 0.001  # of the fan's pixels, before a note says so
MOST_APART = 1  # grey levels between two renderings; a GPU may round differently each time


def score_run(
    scorer: Scorer,
    images_of: ImageSource,
    draws_noise: bool,
    moved_images: ImageSource | None = None,
    beam_images: ImageSource | None = None,
    beside: Sequence[Baseline] = (),
) -> Scores:
    """Score a generator on validation and test frames, and the baselines beside it.

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
    beam_images : ImageSource, optional
        Renders the frames of a generator in beam space before scan conversion.
    beside : sequence of Baseline
        Those of `baselines`.
    """
    frame = scorer.pairs.frames(Part.test)[:1]
    once = images_of(frame, 0)  # before all others
    tables: list[pd.DataFrame] = []
    scalars: dict[str, float] = {}
    missing: dict[Part, dict[str, str]] = {}
    unrepeated: dict[str, str] = {}
    for part, prefix in PREFIXES.items():
        with counted_clipping() as clipping:
            scored = {
                MODEL: scorer.score(part, images_of, draws_noise, moved_images=moved_images, beam_images=beam_images)
            }
        scored |= {baseline.name: baseline_scores(scorer, baseline, part) for baseline in beside}
        for source, scores in scored.items():
            tables.append(scores.per_image.assign(source=source, split=part.name))
            scalars |= {f"{prefix}{SCALAR_PREFIXES[source]}{name}": value for name, value in scores.scalars.items()}
        missing[part] = scored[MODEL].missing
        unrepeated |= scored[MODEL].unrepeated
    alone = {name: f"{why} (of the validation frames alone)" for name, why in missing[Part.validation].items()}
    both_parts = missing[Part.test] | {name: why for name, why in alone.items() if name not in missing[Part.test]}
    about_output = (*_clipped(clipping), *_unrepeated(int(frame[0]), once, images_of(frame, 0)))
    return Scores(pd.concat(tables, ignore_index=True), scalars, both_parts, unrepeated, about_output)


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
