"""How long a frame takes with each network of a study, as it is kept: in `times.json`, machine by machine."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ablate.comparison.blocks import without_anatomy
from ablate.metrics.stored_names import BOUNDS, FRAME_TIME
from ablate.storage import digest, read_json, write_json

TIMES = "times.json"  # in the folder of a study
NETWORK = "network"  # the part of a frame's time that is not one of its maps


@dataclass(frozen=True)
class FrameTime:
    """Milliseconds of each part of a frame, the maps that the network reads and the network, a value a round."""

    parts: Mapping[str, Sequence[float]]

    @property
    def quartiles(self) -> tuple[float, float, float]:
        """Lower quartile, median and upper quartile of the whole frame."""
        lower, middle, upper = np.percentile(np.sum(list(self.parts.values()), axis=0), (25, 50, 75))
        return float(lower), float(middle), float(upper)


Times = dict[str, dict[str, FrameTime]]  # by machine, the one timed last at the end, and by network


def network_of(semantic: Mapping[str, Any]) -> str:
    """What decides the time of a frame on a machine: the network, its arithmetic, and what its maps are made from.

    The weights do not, nor does the anatomy of a block, so several runs have one time. `semantic` is from `spec.json`.
    """
    precision = semantic.get("training", {}).get("precision")
    return digest({"model": semantic["model"], "precision": precision, "data": without_anatomy(semantic["data"])})


def read_times(study_dir: Path) -> Times:
    """What is kept for a study; nothing where the file is missing or damaged."""
    try:
        machines = read_json(study_dir / TIMES)["machines"]
        return {
            str(machine["name"]): {str(k): _frame_time(parts) for k, parts in machine["networks"].items()}
            for machine in machines
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def _frame_time(parts: Mapping[str, Sequence[float]]) -> FrameTime:
    found = FrameTime({str(name): [float(ms) for ms in values] for name, values in parts.items()})
    if not all(np.isfinite(found.quartiles)):
        raise ValueError(f"{TIMES}: a time that is not finite")
    return found


def write_times(study_dir: Path, times: Times) -> None:
    """Keep the times of a study."""
    machines = [
        {"name": machine, "networks": {network: dict(time.parts) for network, time in of.items()}}
        for machine, of in times.items()
    ]
    write_json(study_dir / TIMES, {"machines": machines})


def shown_machine(times: Times, networks: Iterable[str]) -> str | None:
    """The one machine whose times are compared: on which most of these networks were timed, and of several the last."""
    wanted = set(networks)
    counts = {machine: len(wanted & of.keys()) for machine, of in times.items()}
    most = max(counts.values(), default=0)
    return next(machine for machine in reversed(counts) if counts[machine] == most) if most else None


def time_rows(study_dir: Path, runs: Mapping[tuple[str, int, str], str]) -> pd.DataFrame:
    """Times of the machine that is shown: columns variant, seed, data, metric, value (the median), lower, upper.

    The bounds are quartiles over the rounds. `runs` holds the network of each run by its variant, seed and data.
    """
    times = read_times(study_dir)
    of = times.get(shown_machine(times, runs.values()) or "", {})
    rows = []
    for (variant, seed, data), network in runs.items():
        if network in of:
            lower, middle, upper = of[network].quartiles
            rows.append((variant, seed, data, FRAME_TIME, middle, lower, upper))
    return pd.DataFrame(rows, columns=["variant", "seed", "data", "metric", "value", *BOUNDS])


def all_times(study_dir: Path, labels: Mapping[str, str]) -> pd.DataFrame:
    """Everything that is kept: columns variant, machine, ms, lower, upper, rounds, and the median of each part.

    `labels` names the network of each variant.
    """
    rows = []
    for machine, of in read_times(study_dir).items():
        for variant, network in labels.items():
            if (time := of.get(network)) is not None:
                lower, middle, upper = time.quartiles
                parts = {f"{part}_ms": float(np.median(ms)) for part, ms in time.parts.items()}
                rounds = len(next(iter(time.parts.values())))
                about = {"variant": variant, "machine": machine, "ms": middle, "lower": lower, "upper": upper}
                rows.append({**about, "rounds": rounds, **parts})
    return pd.DataFrame(rows)


def untimed(study_dir: Path, labels: Mapping[str, str]) -> list[str]:
    """Sentences about the variants that have no time beside the others'."""
    times = read_times(study_dir)
    shown = shown_machine(times, labels.values())
    if shown is None:
        return []
    missing: dict[str, list[str]] = {}
    for variant, network in labels.items():
        if network not in times[shown]:
            elsewhere = [machine for machine, of in times.items() if network in of]
            missing.setdefault(elsewhere[-1] if elsewhere else "", []).append(variant)
    return [
        f"Times are those of {shown}; none from there: {', '.join(names)} "
        f"({f'timed on {machine}, see times.csv' if machine else 'not timed'})."
        for machine, names in missing.items()
    ]
