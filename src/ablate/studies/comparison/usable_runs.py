"""Choose the runs of a study that can be compared with each other, and say which are left aside and why."""

import json
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from ablate.analysis import REFERENCE, listed
from ablate.metrics import METRICS_VERSION, choose_metrics
from ablate.metrics.stored_names import SOURCES, STORED_COLUMNS
from ablate.studies.comparison.results import Finished
from ablate.studies.identity import read_result, scored_by, shared_pairs


@dataclass(frozen=True)
class UsableRuns:
    """Finished runs of a study.

    Attributes
    ----------
    runs : tuple of Finished
        On the same pairs, so that they can be compared frame by frame.
    blocks : tuple of Finished
        On pairs that differ from these in the anatomy alone. They take part in the effects of components.
    notes : tuple of str
        What was left aside, a sentence each; for the report.
    """

    runs: tuple[Finished, ...]
    blocks: tuple[Finished, ...]
    notes: tuple[str, ...]

    @property
    def all(self) -> tuple[Finished, ...]:
        return (*self.runs, *self.blocks)


def usable_runs(study_dir: Path, reference: str = REFERENCE) -> UsableRuns:
    """Read the finished runs of a study, `<label>/seed<k>/`. A run that cannot be used is left aside.

    Of runs on different pairs those on the reference's are taken, or else on the pairs that most runs have; and as
    blocks those on the same pairs of other anatomies.
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
    blocks: list[Finished] = []
    if runs:
        of_reference = [run for run in runs if run.label == reference]
        chosen = Counter(str(run.result["data"]) for run in of_reference or runs).most_common(1)[0][0]
        others = [run for run in runs if run.result["data"] != chosen]
        runs = [run for run in runs if run.result["data"] == chosen]
        blocks = [run for run in others if _another_anatomy(run, runs[0])]
        if names := [run.name for run in others if run not in blocks]:
            notes.append(f"{_runs(names)} left aside, made from other pairs than {chosen}: {listed(names)}.")
        if names := [run.name for run in blocks]:
            takes = "takes" if len(names) == 1 else "take"
            notes.append(
                f"{_runs(names)} on another anatomy than {chosen} {takes} part in effects and verdicts only: "
                f"{listed(names)}."
            )
    for name in dict.fromkeys(name for run in (*runs, *blocks) for name in run.result.get("metrics", ())):
        with suppress(ValueError):  # imports a user's own metric for its label; one that is gone is shown by its name
            choose_metrics([name])
    return UsableRuns(tuple(runs), tuple(blocks), tuple(notes))


def _another_anatomy(run: Finished, other: Finished) -> bool:
    """Whether the pairs of two runs differ in the anatomy and in nothing else."""
    here, there = (each.spec["semantic"].get("data") for each in (run, other))
    return here is not None and there is not None and shared_pairs(here) == shared_pairs(there)


def _read(folder: Path) -> Finished | str:
    """A finished run, or the reason why it is left aside; an empty string for a folder that is not a run."""
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
        if (version := scored_by(result)) != METRICS_VERSION:
            return f"left aside, scored by version {version} of the metrics, not {METRICS_VERSION}: start it again"
        run = Finished(folder, spec, result)
        if missing := {"label", "seed", "data", "scalars"} - result.keys():
            return f"left aside, without {', '.join(sorted(missing))} in result.json"
        frames = pd.read_parquet(folder / "per_image.parquet", columns=list(STORED_COLUMNS))
    except (OSError, ValueError, KeyError, TypeError) as error:  # json and pyarrow raise children of ValueError
        return f"left aside, unreadable ({type(error).__name__})"
    if unknown := set(frames["source"]) - set(SOURCES):
        names = ", ".join(map(str, sorted(unknown)))
        return f"left aside, made by an earlier version (source {names} in per_image.parquet): start it again"
    return run if (frames["split"] == "test").any() else "left aside, without a value on the test frames"


def _runs(names: list[str]) -> str:
    return f"{len(names)} run{'' if len(names) == 1 else 's'}"
