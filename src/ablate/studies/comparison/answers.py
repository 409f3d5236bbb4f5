"""What the runs of a study say about components: the experiment that they make up, its effects and its verdicts."""

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from ablate import analysis
from ablate.analysis import REFERENCE, Design
from ablate.metrics.stored_names import BOUNDS, FRAME_TIME
from ablate.networks import COMPONENTS
from ablate.studies.comparison.results import Finished, scored_frames

FACTORS = tuple(component.field for component in COMPONENTS)


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
    """

    design: Design | None
    means: pd.DataFrame
    effects: pd.DataFrame
    verdicts: pd.DataFrame
    runs: pd.DataFrame
    paper: pd.DataFrame


def answers(runs: Sequence[Finished], table: pd.DataFrame, reference: str = REFERENCE) -> Answers:
    """Find the design of runs, which may show several anatomies, and judge its components.

    `table` is the `comparison_table` that tells the distance from the reference to re-simulation.
    """
    made = {run.label: components_of(run) for run in runs}
    per_image, scalars = scored_frames(runs)
    design = analysis.find_design(made, FACTORS, reference)
    means = analysis.run_means(per_image, scalars, design)
    everything = analysis.run_means(per_image, scalars)
    run = ["variant", "seed", "data"]
    wide = everything.pivot(index=run, columns="metric", values="value").reset_index()
    if len(times := scalars[scalars["metric"] == FRAME_TIME]):
        bounds = times.set_index(run)[list(BOUNDS)].add_prefix(f"{FRAME_TIME}_")
        wide = wide.join(bounds.astype("float64"), on=run)
    for place, factor in enumerate(FACTORS, start=3):
        wide.insert(place, factor, [made[label].get(factor) for label in wide["variant"]])
    spreads = {FRAME_TIME: float((times["upper"] - times["lower"]).mean() / 2)} if len(times) else {}
    return Answers(
        design,
        means,
        pd.DataFrame() if design is None else analysis.effects_table(per_image, design, scalars),
        analysis.verdict_table(means, design, analysis.distances_to_resimulation(table, reference), spreads=spreads),
        wide,
        analysis.paper_effects(means, design),
    )


def components_of(run: Finished) -> dict[str, object]:
    """What can make a run differ from another one of its study: components, other settings of the network, training.

    Where no noise is injected, the weight that it would start with says nothing and is left out.
    """
    content = run.spec["semantic"]
    model = {k: v for k, v in content["model"].items() if k != "noise_start" or content["model"]["noise"] == "inject"}
    training = {f"training.{k}": v for k, v in content.get("training", {}).items() if k != "seed"}
    return {**model, **training, "encoding": content["encoding"]["order"]}
