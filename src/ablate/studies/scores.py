"""The scores of a run: its generator's and, once for a data set, those of re-simulation, on validation and test."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace

import pandas as pd
from filelock import FileLock

from ablate.config import StudySettings
from ablate.dataset import Part
from ablate.metrics import (
    FID_METRICS,
    IMAGE_METRICS,
    METRICS_VERSION,
    InceptionFeatures,
    Metrics,
    choose_metrics,
    inception_file,
    load_inception,
)
from ablate.metrics.inception import CENTRE
from ablate.networks import draws_noise
from ablate.studies.data import Data
from ablate.studies.evaluate import Evaluation, Render, evaluate, resimulated
from ablate.studies.identity import digest, write_json
from ablate.training import chosen_device


@dataclass(frozen=True)
class Scores:
    """What a run scored.

    Attributes
    ----------
    per_image : DataFrame
        Columns frame, site, metric, value, source (`model`, `floor`), split.
    scalars : dict
        By name: `test/psnr`, `test/floor_psnr`, `val/psnr`, ...
    notes : tuple of str
        Metrics that were asked for and not computed, and why.
    """

    per_image: pd.DataFrame
    scalars: dict[str, float]
    notes: tuple[str, ...]


def score(settings: StudySettings, data: Data, render: Render) -> Scores:
    """Score a generator, and re-simulation where the data set has it.

    Parameters
    ----------
    settings : StudySettings
    data : Data
    render : callable
        As for `evaluate`.

    Returns
    -------
    Scores
    """
    metrics = choose_metrics(settings.metrics)
    inception = _inception(settings, data, metrics)
    tables: list[pd.DataFrame] = []
    scalars: dict[str, float] = {}
    notes: tuple[str, ...] = ()
    for part, prefix in ((Part.validation, "val"), (Part.test, "test")):
        noisy = draws_noise(settings.model)
        scored = {"model": _evaluate(settings, data, part, render, noisy, metrics, inception)}
        if "high_again" in data.pairs.maps:
            scored["floor"] = _floor(settings, data, part, metrics, inception)
        for source, found in scored.items():
            tables.append(found.per_image.assign(source=source, split=part.name))
            mark = "floor_" if source == "floor" else ""
            scalars |= {f"{prefix}/{mark}{name}": value for name, value in found.scalars.items()}
        notes = scored["model"].notes
    return Scores(pd.concat(tables, ignore_index=True), scalars, notes)


def _evaluate(
    s: StudySettings,
    data: Data,
    part: Part,
    render: Render,
    draws: bool,
    metrics: Metrics,
    inception: InceptionFeatures | None,
) -> Evaluation:
    return evaluate(data.pairs, part, data.tissues, s.probe, render, s.evaluation, draws, metrics, inception)


def _inception(settings: StudySettings, data: Data, metrics: Metrics) -> InceptionFeatures | None:
    where = settings.evaluation.inception
    if where is None or min(data.pairs.shape) < CENTRE or metrics.of_set.isdisjoint(FID_METRICS):
        return None
    return load_inception(inception_file(where), str(chosen_device(settings.training.device)))


def _floor(
    settings: StudySettings, data: Data, part: Part, metrics: Metrics, inception: InceptionFeatures | None
) -> Evaluation:
    """Scores of the frames simulated again with other scatterers: the same for every run on a data set.

    They are kept beside it, so that the first of several jobs computes them and the others wait for that; not those
    of a user's own metrics, which may change under their names.
    """
    s = replace(settings, evaluation=replace(settings.evaluation, noise_draws=2))
    again = resimulated(data.pairs)
    if not metrics.of_image.keys() <= IMAGE_METRICS.keys():
        return _evaluate(s, data, part, again, True, metrics, inception)
    made_from = {
        "version": METRICS_VERSION,
        "metrics": sorted(metrics.names),
        "inception": inception is not None,
        "noise_frames": s.evaluation.noise_frames,
    }
    kept = data.pairs.folder / "resimulation" / f"{part.name}-{digest(made_from)}.json"
    kept.parent.mkdir(exist_ok=True)
    with FileLock(kept.with_suffix(".lock")):
        if not kept.exists():
            found = _evaluate(s, data, part, again, True, metrics, inception)
            values = {column: found.per_image[column].tolist() for column in found.per_image}
            write_json(kept, {"per_image": values, "scalars": found.scalars})
    read = json.loads(kept.read_text())
    return Evaluation(pd.DataFrame(read["per_image"]), read["scalars"])
