"""The scores of a run: of its generator, and of re-simulation, the same frames with other scatterers and paths."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from filelock import FileLock

from ablate.dataset import Part
from ablate.evaluation.scorer import ImageSource, Scorer, Scores
from ablate.metrics import METRICS, METRICS_VERSION
from ablate.metrics.stored_names import FLOOR_PREFIX, MODEL, RESIMULATED
from ablate.storage import digest, read_json, write_json

if TYPE_CHECKING:
    from ablate.dataset import Pairs  # only here: frames that are read otherwise need no Zarr


def resimulation_images(pairs: Pairs) -> ImageSource:
    """The re-simulated frames; an odd noise draw gives the target, which has other scatterers and paths again."""

    def images_of(frames: np.ndarray, draw: int) -> np.ndarray:
        return pairs.read("target" if draw % 2 else "resimulation", frames)

    return images_of


def resimulation_scores(scorer: Scorer, part: Part) -> Scores:
    """The floor, or the level, of every metric, which is the same for every run on a data set.

    The first of several jobs computes and stores it beside the data set, and the others wait. It is not stored where
    one of the metrics is a user's own, because the function may change under its name.
    """
    scorer = replace(scorer, settings=replace(scorer.settings, noise_draws=2))
    images_of = resimulation_images(scorer.pairs)
    if not scorer.metrics.keys() <= METRICS.keys():
        return scorer.score(part, images_of, draws_noise=True)
    made_from = {
        "version": METRICS_VERSION,
        "metrics": sorted(scorer.metrics),
        "inception": scorer.inception is not None,
    }
    kept = scorer.pairs.folder / "resimulation" / f"{part.name}-{digest(made_from)}.json"
    kept.parent.mkdir(exist_ok=True)
    with FileLock(kept.with_suffix(".lock")):
        with suppress(OSError, ValueError, KeyError):  # not made yet, or damaged
            return _read(kept)
        found = scorer.score(part, images_of, draws_noise=True)
        write_json(kept, {"per_image": found.per_image.to_dict("list"), "scalars": found.scalars})
        return _read(kept)


def _read(kept: Path) -> Scores:
    read = read_json(kept)
    return Scores(pd.DataFrame(read["per_image"]), read["scalars"])


def score_run(scorer: Scorer, images_of: ImageSource, draws_noise: bool) -> Scores:
    """Score a generator, and re-simulation where the data set has it; arguments as for `Scorer.score`."""
    tables: list[pd.DataFrame] = []
    scalars: dict[str, float] = {}
    notes: tuple[str, ...] = ()
    for part, prefix in ((Part.validation, "val"), (Part.test, "test")):
        scored = {MODEL: scorer.score(part, images_of, draws_noise)}
        if "resimulation" in scorer.pairs.maps:
            scored[RESIMULATED] = resimulation_scores(scorer, part)
        for source, found in scored.items():
            tables.append(found.per_image.assign(source=source, split=part.name))
            mark = FLOOR_PREFIX if source == RESIMULATED else ""
            scalars |= {f"{prefix}/{mark}{name}": value for name, value in found.scalars.items()}
        notes = scored[MODEL].notes
    return Scores(pd.concat(tables, ignore_index=True), scalars, notes)
