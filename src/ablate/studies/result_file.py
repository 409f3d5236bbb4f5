"""`result.json`, which a run writes last: read as data, whoever wrote it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ablate.storage import read_json

# Keys that came later, with what they were before.
_CAME_LATER: Mapping[str, Any] = {"metrics": "all", "metrics_version": 1, "inception": None, "notes": []}
_COUNTED = {"parameters_generator", "parameters_discriminator"}  # the scalars that every run has


def read_result(folder: Path, expected_hash: str) -> dict[str, Any] | None:
    """`result.json` of a run directory when its hash is the expected one, and it is whole; with all keys."""
    try:
        result = {**_CAME_LATER, **read_json(folder / "result.json")}
    except (OSError, ValueError):
        return None
    return None if result.get("hash") != expected_hash or unusable_keys(result) else result


def unusable_keys(result: Mapping[str, Any]) -> list[str]:
    """The keys that are missing from a `result.json`, or hold what no run writes there."""
    found = {**_CAME_LATER, **result}
    kinds: dict[str, Any] = {"label": str, "seed": int, "data": str, "metrics_version": int}
    wrong = [key for key, kind in kinds.items() if not isinstance(found.get(key), kind)]
    if not isinstance(found["inception"], str | None):
        wrong.append("inception")
    if not isinstance(found["metrics"], str) and not _is_list_of_text(found["metrics"]):
        wrong.append("metrics")
    if not _is_list_of_text(found["notes"]):
        wrong.append("notes")
    scalars = found.get("scalars")
    if not isinstance(scalars, dict) or not all(isinstance(value, int | float) for value in scalars.values()):
        wrong.append("scalars")
    elif not _COUNTED <= scalars.keys():
        wrong += sorted(f"scalars.{name}" for name in _COUNTED - scalars.keys())
    return wrong


def _is_list_of_text(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(entry, str) for entry in value)


def scored_by(result: Mapping[str, Any]) -> int:
    """The `METRICS_VERSION` that a result was scored by; version 1 did not store it."""
    return int(result.get("metrics_version", _CAME_LATER["metrics_version"]))
