"""Finished runs without a training: what a run writes, with values of a test's choice."""

from collections.abc import Mapping
from typing import Any

import pandas as pd
from ablate.runs.job import Job
from ablate.runs.place import claim_place
from ablate.runs.run import Run

from ablate.metrics import METRICS_VERSION
from ablate.storage import write_json

PARAMETERS = {"parameters_generator": 1.0, "parameters_discriminator": 1.0}


#: What every result.json has besides what names the run.
WHOLE: dict[str, Any] = {
    **{"data": "fetal-0", "pixels": "0", "scalars": PARAMETERS, "notes": []},
    **dict.fromkeys(("started", "ended", "first_scored"), "2026-01-01T00:00:00+00:00"),
    **{"metrics": ["all"], "sources": {}, "metrics_version": METRICS_VERSION, "inception": None},
}


def result_of(job: Job, **changes: Any) -> dict[str, Any]:
    """A result as a run writes it."""
    return {**WHOLE, "hash": job.hash, "label": job.label, "seed": job.settings.seed, **changes}


def scores_of(job: Job, values: Mapping[str, float] | None = None, frames: int = 1) -> pd.DataFrame:
    """Values of test frames as a run stores them, by metric; the frames of a metric have equal values."""
    rows = [
        {"frame": frame, "site": frame, "metric": metric, "value": float(value), "source": "model", "split": "test"}
        for metric, value in (values or {"psnr": 20.0}).items()
        for frame in range(frames)
    ]
    return pd.DataFrame(rows).assign(variant=job.label, seed=job.settings.seed)


def finish(job: Job, values: Mapping[str, float] | None = None, **changes: Any) -> Run:
    """Write what a finished run of the job has on disk: specification, scores, result."""
    claim_place(job)
    scores_of(job, values).to_parquet(job.run.scores_file)
    write_json(job.folder / "result.json", result_of(job, **changes))
    return job.run


def timed(machine: str, network: str, *whole_ms: float) -> pd.DataFrame:
    """Rounds of a map of 1 ms and the rest in the network, as `frame_times` keeps them."""
    rows = [
        (machine, network, number, part, ms)
        for number, whole in enumerate(whole_ms, start=1)
        for part, ms in (("segmentation", 1.0), ("network", whole - 1))
    ]
    return pd.DataFrame(rows, columns=["machine", "network", "round", "part", "ms"])
