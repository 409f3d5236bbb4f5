"""The identity of a run: a hash of the settings that decide its result; no folder may mix two of them."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ablate.config import ConfigurationError, StudySettings, json_ready
from ablate.dataset import Encoding
from ablate.metrics import METRIC_SETS, METRICS_VERSION, choose_metrics, needs_inception
from ablate.storage import digest, write_json
from ablate.studies.jobs.job import Job
from ablate.studies.pairs.data import about_data

# These settings say where a job runs and how often it saves or reports; they do not change its result.
_INCIDENTAL_TRAINING = ("device", "threads", "checkpoint_every", "validate_every", "log_every")


def semantic(settings: StudySettings) -> dict[str, Any]:
    """The settings that decide the trained network and its scores, as JSON values."""
    training = {k: v for k, v in json_ready(settings.training).items() if k not in _INCIDENTAL_TRAINING}
    arbitrary = settings.encoding is Encoding.arbitrary
    encoding = {"order": settings.encoding.name} | ({"seed": settings.encoding_seed} if arbitrary else {})
    scored = {k: v for k, v in json_ready(settings.evaluation).items() if k not in ("pictures", "inception")}
    return {
        "data": about_data(settings),
        "encoding": encoding,
        "model": json_ready(settings.model),
        "training": training,
        "evaluation": scored,
        "crops": {k: v for k, v in json_ready(settings.crops).items() if k != "workers"},
        "seed": settings.seed,
    }


def shared(content: Mapping[str, Any]) -> dict[str, Any]:
    """The part of `semantic` that is the same for all runs of a study: pairs, training, width, crops, evaluation.

    The pairs of two runs may show two anatomies; see `shared_pairs`. The rest is what labels tell apart: components,
    encoding, seed, and the adversarial loss.
    """
    training = {k: v for k, v in content["training"].items() if k not in ("seed", "loss")}
    rest = {k: content[k] for k in ("crops", "evaluation")}
    data = shared_pairs(content["data"])
    return {**rest, "data": data, "model.width": content["model"]["width"], "training": training}


def shared_pairs(data: Mapping[str, Any]) -> dict[str, Any]:
    """What `about_data` says without the seed of the anatomy; anatomies are the blocks of a study."""
    return {**data, "scene": {k: v for k, v in data["scene"].items() if k != "seed"}}


def config_hash(settings: StudySettings) -> str:
    """First 16 hexadecimal digits of the SHA-256 of `semantic`."""
    return digest(semantic(settings))


def check_place(job: Job) -> None:
    """Refuse a run directory, or a study, that holds another configuration.

    The ConfigurationError names the keys that differ, each with its value there and here.
    """
    here = semantic(job.settings)
    for spec in sorted(job.settings.study_dir.glob("*/seed*/spec.json")):
        there = json.loads(spec.read_text())["semantic"]
        pair = (there, here) if spec.parent == job.folder else (shared(there), shared(here))
        differences = ", ".join(f"{k}: {a} there, {b} here" for k, a, b in _differences(*pair))
        if differences:
            another = f"{spec.parent} holds another configuration ({differences})"
            raise ConfigurationError(f"{another}; give this one a place with study_name=...")


def claim_place(job: Job) -> None:
    """Write `spec.json`, which says what a run is, before anything else is written into its folder."""
    check_place(job)
    job.folder.mkdir(parents=True, exist_ok=True)
    if not (job.folder / "spec.json").exists():
        known_by = {"label": job.label, "hash": config_hash(job.settings)}
        decided_by = {"semantic": semantic(job.settings), "settings": json_ready(job.settings)}
        write_json(job.folder / "spec.json", {**known_by, **decided_by})


def finished(job: Job) -> dict[str, Any] | None:
    """The result of a job, or None where it has none of the same configuration with all metrics that are asked for.

    A result that was scored by another version of the metrics is not finished: the run is scored again.
    """
    result = read_result(job.folder, config_hash(job.settings))
    if result is None or scored_by(result) != METRICS_VERSION:
        return None
    metrics = choose_metrics(job.settings.metrics)
    with_network = job.settings.evaluation.inception is not None and needs_inception(metrics)
    if metrics.keys() - choose_metrics(result["metrics"]).keys() or (with_network and result["inception"] is None):
        return None
    return result


def scored_by(result: Mapping[str, Any]) -> int:
    """The `METRICS_VERSION` that a result was scored by; version 1 did not store it."""
    return int(result.get("metrics_version", 1))


def with_earlier_metrics(job: Job) -> StudySettings:
    """The settings of a job, which also ask for the metrics that an earlier call of the same job computed."""
    s = job.settings
    before = read_result(job.folder, config_hash(s)) or {}
    asked = [*before.get("metrics", ()), *([s.metrics] if isinstance(s.metrics, str) else s.metrics)]
    # By name: a set such as `all` may have more of them when the run is looked at again.
    metrics = sorted({name for entry in asked for name in METRIC_SETS.get(entry, (entry,))})
    inception = s.evaluation.inception or before.get("inception")
    return replace(s, metrics=metrics, evaluation=replace(s.evaluation, inception=inception))


def read_result(folder: Path, expected_hash: str) -> dict[str, Any] | None:
    """`result.json` of a run directory when its hash is the expected one."""
    path = folder / "result.json"
    if not path.exists():
        return None
    result: dict[str, Any] = json.loads(path.read_text())
    return result if result.get("hash") == expected_hash else None


def _differences(a: Any, b: Any, key: str = "") -> Iterator[tuple[str, Any, Any]]:
    if isinstance(a, dict) and isinstance(b, dict):
        for k in sorted(a.keys() | b.keys()):
            yield from _differences(a.get(k), b.get(k), f"{key}.{k}".lstrip("."))
    elif a != b:
        yield key, a, b
