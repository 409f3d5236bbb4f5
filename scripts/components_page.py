"""What docs/components.md says of its kept study: its verdicts, its positive control, and `full` beside it."""

from collections.abc import Iterator
from pathlib import Path

import pandas as pd

import ablate
from ablate.analysis.scale import scale_length
from ablate.metrics import metric_of
from ablate.metrics.metric import FORMULA, MODEL, RESIMULATED, SCALAR_PREFIXES
from ablate.study.opened import Study
from results_page import network_of, pipe_table, study_lines

STUDY = "components"
#: Metrics of the positive control and of the scale: named in the analysis that was registered.
CONTROL = ("fd_speckle", "octave_sd", "psnr", "mae_smooth", "pchi2_tissue")
SCALE = ("psnr", "mae_smooth", "pchi2_tissue")
FULL, REFERENCE = "full", "sa2h"
NAMES = {FORMULA: "formula", RESIMULATED: "re-simulation"}


def lines(folder: Path) -> Iterator[str]:
    """Paragraphs of the page, of a kept study's folder, into which figures are written."""
    yield from study_lines(folder, first=False)
    means = run_means(ablate.open_study(folder))
    yield "### Positive control, and the maps of a ray walk"
    yield pipe_table(("renderer", "trainings", *(metric_of(name).title for name in CONTROL)), rows(means))
    yield (
        "Means over trainings, in both anatomies alike; each formula reads the maps of the network above it. On the "
        "scale 0 is the formula and 1 re-simulation; a dash is where the formula itself is past re-simulation:"
    )
    yield pipe_table(("network", *(metric_of(name).label for name in SCALE)), scale_rows(means))


def run_means(study: Study) -> pd.DataFrame:
    """A row a network, source and metric: the mean over runs, the anatomies alike, and how many runs there are."""
    found = []
    for run in study.usable.all:
        network = network_of(run.label)
        if network in (REFERENCE, FULL):
            for source in (MODEL, FORMULA, RESIMULATED):
                values = {name: run.scalars.get(f"test/{SCALAR_PREFIXES[source]}{name}") for name in CONTROL}
                found.append({"network": network, "source": source, "data": run.data, **values})
    by_anatomy = pd.DataFrame(found).groupby(["network", "source", "data"], sort=False)
    means = by_anatomy[list(CONTROL)].mean().groupby(["network", "source"], sort=False).mean()
    return means.assign(runs=by_anatomy.size().groupby(["network", "source"], sort=False).sum())


def rows(means: pd.DataFrame) -> list[list[str]]:
    """Each network, its formula and its re-simulation."""
    found = []
    for (network, source), row in means.iterrows():
        name = network if source == MODEL else f"{NAMES[source]} of {network}"
        scores = [f"{row[metric]:.{metric_of(metric).decimals}f}" for metric in CONTROL]
        found.append([str(name), f"{row['runs']:.0f}" if source == MODEL else "–", *scores])
    return found


def scale_rows(means: pd.DataFrame) -> list[list[str]]:
    """Where each network stands between the formula and re-simulation of its own maps."""
    found = []
    for network in means.index.unique("network"):
        model, formula, best = (means.loc[(network, source)] for source in (MODEL, FORMULA, RESIMULATED))
        found.append([network, *(_share(metric, model[metric], formula[metric], best[metric]) for metric in SCALE)])
    return found


def _share(metric: str, model: float, formula: float, best: float) -> str:
    """How much of the way from the formula to re-simulation; a dash where the formula is as good as re-simulation."""
    whole = scale_length(metric, formula, best)
    return f"{scale_length(metric, formula, model) / whole:.2f}" if whole > 0 else "–"
