"""What the runs of a study say about components: the experiment that they make up, its effects and its verdicts."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from ablate import analysis
from ablate.analysis import REFERENCE, Component, Design
from ablate.comparison.results import scored_frames
from ablate.comparison.usable_runs import anatomy_of, factors_of, levels_of
from ablate.metrics.stored_names import BOUNDS, FRAME_TIME
from ablate.runs.run import Run
from ablate.settings.conf import components


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
    block = {run.data: anatomy_of(run) for run in runs}
    per_image, scalars = scored_frames(runs)
    design = analysis.find_design(levels, factors, reference)
    of_blocks = [rows.assign(data=rows["data"].map(block)) for rows in (per_image, scalars)]
    means = analysis.run_means(*of_blocks, design=design)
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
