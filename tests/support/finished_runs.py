"""Finished trainings without a training: what one leaves on disk, with values of a test's choice."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from ablate.evaluation import Scores
from ablate.storage import digest, write_json
from ablate.study.job import Job, claim
from ablate.study.run import Run
from ablate.study.scores import by_metric, wanted_scores, write_score
from ablate.study.training import ABOUT, Training

PARAMETERS = {"parameters_generator": 1.0, "parameters_discriminator": 1.0}
PIXELS = 16 * "0"
#: What every trained.json has.
WHOLE: dict[str, Any] = {
    "pixels": PIXELS,
    "scalars": PARAMETERS,
    "notes": [],
    "started": "2026-01-01T00:00:00+00:00",
    "ended": "2026-01-01T00:00:00+00:00",
}


def scores_of(values: Mapping[str, float], frames: int = 1, resimulated: bool = False) -> Scores:
    """Values of test frames as an evaluation has them, by metric; the frames of a metric have equal values."""
    rows = [
        {"frame": frame, "site": frame, "metric": metric, "value": float(value), "source": source, "split": "test"}
        for metric, value in values.items()
        for source in ("model", *(["resimulation"] if resimulated else []))
        for frame in range(frames)
    ]
    return Scores(pd.DataFrame(rows), {f"test/{metric}": float(value) for metric, value in values.items()})


def write_training(study: Path, label: str, identity: dict[str, Any], data: str = "fetal-0", **result: Any) -> Training:
    """A finished training that is what `identity` says, at its address in a study, and without scores."""
    about = {"label": label, "seed": identity["seed"], "changed": {}, "identity": identity, "hash": digest(identity)}
    settings = {"model": identity["model"], "seed": identity["seed"]}
    folder = study / f"{label}-seed{identity['seed']}-{digest(identity)[:8]}"
    folder.mkdir(parents=True)
    write_json(folder / ABOUT, {**about, "settings": settings, "data": data})
    Training(folder).write_result({**WHOLE, **result})
    return Training(folder)


def finish(job: Job, values: Mapping[str, float] | None = None, **result: Any) -> Run:
    """Write what a finished job has on disk: what it is, what it came to, and scores of its metrics.

    Without values they are those of every metric that it asks for.
    """
    training = claim(job)
    training.write_result({**WHOLE, **result})
    pixels = str({**WHOLE, **result}["pixels"])
    keys = wanted_scores(job.settings.metrics, job.settings.evaluation, pixels)
    if values is not None:
        keys = tuple(key for key in keys if key.metric in values)
    scores = scores_of(values or {key.metric: 20.0 for key in keys})
    for key, score in by_metric(scores, keys).items():
        write_score(training.scores, key, score)
    return Run(Training(training.folder), job.label, dict(job.changed), tuple(key.file_name for key in keys))


def timed(machine: str, network: str, *whole_ms: float) -> pd.DataFrame:
    """Rounds of a map of 1 ms and the rest in the network, as `frame_times` keeps them."""
    rows = [
        (machine, network, number, part, ms)
        for number, whole in enumerate(whole_ms, start=1)
        for part, ms in (("segmentation", 1.0), ("network", whole - 1))
    ]
    return pd.DataFrame(rows, columns=["machine", "network", "round", "part", "ms"])
