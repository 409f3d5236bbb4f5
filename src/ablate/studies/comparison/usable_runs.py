"""Choose the runs of a study that can be compared with each other, and say which are left aside and why."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from ablate.analysis import REFERENCE, listed
from ablate.metrics import METRICS_VERSION
from ablate.metrics.stored_names import SOURCES, STORED_COLUMNS
from ablate.storage import digest, read_json
from ablate.studies.comparison.answers import components_of
from ablate.studies.comparison.results import Finished
from ablate.studies.identity import shared_pairs
from ablate.studies.result_file import scored_by, unusable_keys
from ablate.validation import check_name


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
    return UsableRuns(tuple(runs), tuple(blocks), tuple(notes))


def _another_anatomy(run: Finished, other: Finished) -> bool:
    """Whether the pairs of two runs differ in the anatomy and in nothing else."""
    here, there = (shared_pairs(each.spec["semantic"]["data"]) for each in (run, other))
    return here == there


def _read(folder: Path) -> Finished | str:
    """A finished run, or the reason why it is left aside; an empty string for a folder that is not a run."""
    path = folder / "spec.json"
    if not path.exists():
        return ""
    try:
        spec = read_json(path)
        if digest(spec["semantic"]) != spec["hash"]:
            return "left aside, with a spec.json that is not what its hash says"
        if not (folder / "result.json").exists():
            return "not finished"
        result = read_json(folder / "result.json")
        if result.get("hash") != spec["hash"]:
            return "left aside, with a result of another configuration"
        if wrong := unusable_keys(result):
            return f"left aside, without a usable {', '.join(wrong)} in result.json: start it again"
        if (version := scored_by(result)) != METRICS_VERSION:
            return f"left aside, scored by version {version} of the metrics, not {METRICS_VERSION}: start it again"
        run = Finished(folder, spec, result)
        components_of(run), shared_pairs(spec["semantic"]["data"])  # an error where these cannot be told
        frames = pd.read_parquet(folder / "per_image.parquet", columns=list(STORED_COLUMNS))
        for metric in set(frames["metric"]):
            check_name("metric", str(metric))  # it becomes part of the name of a figure's file
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:  # pyarrow's are ValueErrors
        return f"left aside, unreadable ({type(error).__name__})"
    if (set(frames["variant"]), set(frames["seed"])) != ({run.label}, {run.seed}):
        return "left aside, with values of another run in per_image.parquet: start it again"
    if unknown := set(frames["source"]) - set(SOURCES):
        names = ", ".join(map(str, sorted(unknown)))
        return f"left aside, made by an earlier version (source {names} in per_image.parquet): start it again"
    return run if (frames["split"] == "test").any() else "left aside, without a value on the test frames"


def _runs(names: list[str]) -> str:
    return f"{len(names)} run{'' if len(names) == 1 else 's'}"
