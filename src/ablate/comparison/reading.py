"""A study on disk as comparisons and notebooks read it: its runs, its tables, and what they say about components."""

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pandas as pd

from ablate import analysis
from ablate.analysis import REFERENCE, Component, Design, FramePictures
from ablate.comparison.results import pictures, scored_frames
from ablate.comparison.usable_runs import UsableRuns, factors_of, levels_of, usable_runs
from ablate.metrics.stored_names import BOUNDS, FRAME_TIME
from ablate.runs.job import COMPARISON
from ablate.runs.run import Run
from ablate.settings.conf import components
from ablate.settings.study import StudySettings
from ablate.storage import read_json

SWEEP = ("runs/quick-fetal",)  # where `make sweep` leaves its study
ANSWER = ("runs/answer", "docs/results/answer")  # where `make answer` leaves its study, and where it is kept


@dataclass(frozen=True, eq=False)
class Answers:
    """The design of a study, and what follows from it; the tables are those of `ablate.analysis`.

    Attributes
    ----------
    design : Design or None
        None where no component varies; `effects` is then empty.
    means : DataFrame
        One row a metric of a run of the design.
    runs : DataFrame
        One row a run of the study: variant, seed, data, its components, its mean of every metric, and the quartiles of
        its time a frame.
    paper : DataFrame
        The paper's effects beside those of the study.
    components : tuple of Component
        What was judged: the declared components, and keys that somebody swept.
    """

    design: Design | None
    means: pd.DataFrame
    effects: pd.DataFrame
    verdicts: pd.DataFrame
    runs: pd.DataFrame
    paper: pd.DataFrame
    components: tuple[Component, ...]


def answers(runs: Sequence[Run], table: pd.DataFrame, reference: str = REFERENCE) -> Answers:
    """Find the design of runs, which may show several anatomies, and judge its components.

    `table` is the `comparison_table` that tells the distance from the reference to re-simulation.
    """
    levels = {run.label: levels_of(run.spec["semantic"]) for run in runs}
    factors = factors_of(runs)
    judged = analysis.with_undeclared(components(), factors)
    block = {run.data: str(run.spec["semantic"]["data"]["scene"].get("anatomy_seed", "")) for run in runs}
    per_image, scalars = scored_frames(runs)
    design = analysis.find_design(levels, factors, reference)
    frames, values = (rows.assign(data=rows["data"].map(block)) for rows in (per_image, scalars))
    means = analysis.run_means(frames, values, design)
    times = scalars[scalars["metric"] == FRAME_TIME]  # their spread is half the distance of the quartiles
    spreads = {FRAME_TIME: float((times["upper"] - times["lower"]).mean() / 2)} if len(times) else {}
    return Answers(
        design,
        means,
        pd.DataFrame() if design is None else analysis.effects_table(means, design),
        analysis.verdict_table(
            means, design, judged, analysis.distances_to_resimulation(table, reference), spreads=spreads
        ),
        _wide(per_image, scalars, levels, factors),
        analysis.paper_effects(means, design, judged),
        judged,
    )


def _wide(
    per_image: pd.DataFrame, scalars: pd.DataFrame, levels: Mapping[str, Mapping[str, object]], factors: Sequence[str]
) -> pd.DataFrame:
    """One row a run: variant, seed, data, the level of every factor that varies or is declared, and every mean."""
    run = ["variant", "seed", "data"]
    everything = analysis.run_means(per_image, scalars)
    wide = everything.pivot(index=run, columns="metric", values="value").reset_index()
    if len(times := scalars[scalars["metric"] == FRAME_TIME]):
        bounds = times.set_index(run)[list(BOUNDS)].add_prefix(f"{FRAME_TIME}_")
        wide = wide.join(bounds.astype("float64"), on=run)
    for place, factor in enumerate(factors, start=len(run)):
        wide.insert(place, factor, [levels[label].get(factor) for label in wide["variant"]])
    return wide


@dataclass(frozen=True, eq=False)
class Study:
    """A study on disk with at least one run that can be used; tables are made when they are first asked for."""

    folder: Path
    usable: UsableRuns
    reference: str  # what its variants are compared with
    per_image: pd.DataFrame  # as `comparison_table` takes it, like `scalars`
    scalars: pd.DataFrame

    @property
    def runs(self) -> tuple[Run, ...]:
        return self.usable.runs

    @cached_property
    def table(self) -> pd.DataFrame:
        return analysis.comparison_table(self.per_image, self.scalars, self.reference)

    @cached_property
    def paired(self) -> pd.DataFrame:
        return analysis.paired_table(self.per_image, self.reference)

    @cached_property
    def pictures(self) -> list[FramePictures]:
        return pictures(self.runs, self.reference)

    @cached_property
    def answers(self) -> Answers:
        return answers(self.usable.all, self.table, self.reference)


def open_study(places: Sequence[str] = SWEEP, made_by: str = "make sweep") -> Study:
    """Open the study named by the environment variable ABLATE_STUDY, or the first of `places`, here or one folder up.

    Without one a SystemExit names the command that makes it, so that a notebook stops without a traceback.
    """
    named = os.environ.get("ABLATE_STUDY")
    folders = [Path(named)] if named else [Path(up) / place for up in (".", "..") for place in places]
    for folder in folders:
        reference = StudySettings.reference
        with suppress(OSError, ValueError, KeyError):  # not compared yet, or a damaged file
            reference = str(read_json(folder / COMPARISON / "made_from.json")["reference"])
        usable = usable_runs(folder.resolve(), reference)
        if usable.runs:
            return Study(folder.resolve(), usable, reference, *scored_frames(usable.runs))
    advice = f"Run `{made_by}` first, or name another by the environment variable ABLATE_STUDY."
    raise SystemExit(f"There is no finished study at {folders[0]}. {advice}")
