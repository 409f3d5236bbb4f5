"""Which runs of a study can be compared with each other, and in words what is left aside and why."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from ablate.analysis import REFERENCE, listed
from ablate.studies.identity import read_result
from ablate.studies.results import Finished

_NEEDED = ["frame", "site", "metric", "value", "source", "split", "variant", "seed"]


@dataclass(frozen=True)
class UsableRuns:
    """Finished runs on the same pairs.

    Attributes
    ----------
    runs : tuple of Finished
    notes : tuple of str
        What was left aside, a sentence each; for the report.
    """

    runs: tuple[Finished, ...]
    notes: tuple[str, ...]


def usable_runs(study_dir: Path, reference: str = REFERENCE) -> UsableRuns:
    """Read what a study has finished; what cannot be used costs its run, never the comparison.

    Of runs on different pairs those on the reference's are taken, or else on the pairs that most runs have.

    Parameters
    ----------
    study_dir : Path
        Holds `<label>/seed<k>/`.
    reference : str

    Returns
    -------
    UsableRuns
    """
    runs: list[Finished] = []
    aside: dict[str, list[str]] = {}
    for folder in sorted(study_dir.glob("*/seed*/")):
        found = _read(folder)
        if isinstance(found, Finished):
            runs.append(found)
        elif found:
            aside.setdefault(found, []).append(f"{folder.parent.name}/{folder.name}")
    notes = [f"{_runs(names)} {reason}: {listed(names)}." for reason, names in aside.items()]
    datasets = [str(run.result["data"]) for run in runs if run.label == reference] or [
        str(r.result["data"]) for r in runs
    ]
    if datasets:
        chosen = Counter(datasets).most_common(1)[0][0]
        others = [run.name for run in runs if run.result["data"] != chosen]
        if others:
            notes.append(f"{_runs(others)} left aside, made from other pairs than {chosen}: {listed(others)}.")
        runs = [run for run in runs if run.result["data"] == chosen]
    return UsableRuns(tuple(runs), tuple(notes))


def _read(folder: Path) -> Finished | str:
    """A finished run, or why it is left aside; empty for a folder that is no run."""
    path = folder / "spec.json"
    if not path.exists():
        return ""
    try:
        spec = json.loads(path.read_text())
        if not (folder / "result.json").exists():
            return "not finished"
        result = read_result(folder, spec["hash"])
        if result is None:
            return "left aside, with a result of another configuration"
        run = Finished(folder, spec, result)
        if missing := {"label", "seed", "data", "scalars"} - result.keys():
            return f"left aside, without {', '.join(sorted(missing))} in result.json"
        frames = pd.read_parquet(folder / "per_image.parquet", columns=_NEEDED)
    except (OSError, ValueError, KeyError, TypeError) as error:  # json and pyarrow raise children of ValueError
        return f"left aside, unreadable ({type(error).__name__})"
    return run if (frames["split"] == "test").any() else "left aside, without a value on the test frames"


def _runs(names: list[str]) -> str:
    return f"{len(names)} run{'' if len(names) == 1 else 's'}"
