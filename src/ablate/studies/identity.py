"""Which run is which: a hash of what decides the result, and the refusal to mix two results in one place."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ablate.config import StudySettings, plain
from ablate.metrics import FID_METRICS, choose_metrics
from ablate.studies.data import about_data
from ablate.studies.sweep import ConfigurationError, Job

# Where a job runs, how often it saves and what it is called do not change what comes out.
_INCIDENTAL_TRAINING = ("device", "threads", "checkpoint_every", "validate_every", "log_every")


def semantic(settings: StudySettings) -> dict[str, Any]:
    """Everything that decides the trained network, and nothing else, fit for JSON."""
    training = {k: v for k, v in plain(settings.training).items() if k not in _INCIDENTAL_TRAINING}
    encoding: dict[str, Any] = {"order": settings.encoding.name}
    if settings.encoding.name == "arbitrary":
        encoding["seed"] = settings.encoding_seed
    scored = {k: v for k, v in plain(settings.evaluation).items() if k not in ("pictures", "inception")}
    return {
        "data": about_data(settings),
        "encoding": encoding,
        "model": plain(settings.model),
        "training": training,
        "evaluation": scored,
        "crops": {k: v for k, v in plain(settings.crops).items() if k != "workers"},
        "seed": settings.seed,
    }


def shared(content: Mapping[str, Any]) -> dict[str, Any]:
    """What all runs of a study have in common: `semantic` without what a run is labelled with.

    Two variants are comparable only if they were trained alike on the same pairs.
    """
    training = {k: v for k, v in content["training"].items() if k != "seed"}
    rest = {k: content[k] for k in ("data", "crops", "evaluation")}
    return {**rest, "model.width": content["model"]["width"], "training": training}


def config_hash(settings: StudySettings) -> str:
    """First 16 hexadecimal digits of the SHA-256 of `semantic`."""
    return digest(semantic(settings))


def digest(value: Any) -> str:
    """First 16 hexadecimal digits of the SHA-256 of a JSON value."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:16]


def check_place(job: Job) -> None:
    """Refuse a run directory, or a study, that holds another configuration.

    Raises
    ------
    ConfigurationError
        Naming the keys that differ, each with its value there and here.
    """
    here = semantic(job.settings)
    for spec in sorted(job.settings.study_dir.glob("*/seed*/spec.json")):
        there = json.loads(spec.read_text())["semantic"]
        pair = (there, here) if spec.parent == job.folder else (shared(there), shared(here))
        differences = ", ".join(f"{k}: {a} there, {b} here" for k, a, b in _differences(*pair))
        if differences:
            raise ConfigurationError(
                f"{spec.parent} holds another configuration ({differences}); give this one a place with study_name=..."
            )


def claim_place(job: Job) -> None:
    """Write what this run is into its directory, before anything else is written there."""
    check_place(job)
    job.folder.mkdir(parents=True, exist_ok=True)
    if not (job.folder / "spec.json").exists():
        content = {
            "label": job.label,
            "hash": config_hash(job.settings),
            "semantic": semantic(job.settings),
            "settings": plain(job.settings),
        }
        write_json(job.folder / "spec.json", content)


def finished(job: Job) -> dict[str, Any] | None:
    """The result of this very configuration, when there is one and it has the metrics that are asked for."""
    result = read_result(job.folder, config_hash(job.settings))
    if result is None or "metrics" not in result:
        return result
    names = choose_metrics(job.settings.metrics).names
    with_network = job.settings.evaluation.inception is not None and not names.isdisjoint(FID_METRICS)
    if names - choose_metrics(result["metrics"]).names or (with_network and result["inception"] is None):
        return None
    return result


def with_earlier_metrics(job: Job) -> StudySettings:
    """The settings, asking for what an earlier call of the same job computed too."""
    s = job.settings
    before = read_result(job.folder, config_hash(s)) or {}
    metrics = sorted({*before.get("metrics", ()), *([s.metrics] if isinstance(s.metrics, str) else s.metrics)})
    inception = s.evaluation.inception or before.get("inception")
    return replace(s, metrics=metrics, evaluation=replace(s.evaluation, inception=inception))


def read_result(folder: Path, expected_hash: str) -> dict[str, Any] | None:
    """`result.json` of a run directory when its hash is the expected one."""
    path = folder / "result.json"
    if not path.exists():
        return None
    result: dict[str, Any] = json.loads(path.read_text())
    return result if result.get("hash") == expected_hash else None


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write whole or not at all."""
    partial = path.with_name(path.name + ".partial")
    partial.write_text(json.dumps(content, indent=2, sort_keys=True))
    partial.replace(path)


def _differences(a: Any, b: Any, key: str = "") -> Iterator[tuple[str, Any, Any]]:
    if isinstance(a, dict) and isinstance(b, dict):
        for k in sorted(a.keys() | b.keys()):
            yield from _differences(a.get(k), b.get(k), f"{key}.{k}".lstrip("."))
    elif a != b:
        yield key, a, b
