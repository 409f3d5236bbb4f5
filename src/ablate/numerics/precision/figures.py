"""The two figures of `task=precision`: how the simulator converges, and renderers that do not know the scatterers."""

from pathlib import Path

import pandas as pd

from ablate.analysis import RESIMULATION, convergence_figure, error_vs_runtime
from ablate.analysis.figures.convergence_figure import SERIES, named_setting
from ablate.metrics.metric import FORMULA
from ablate.numerics.precision.bench import OTHER_SERIES
from ablate.numerics.precision.errors import ENVELOPE

#: A network's setting: width, precision, engine, seed, and another study than the one that asked.
WAY = r", (?P<precision>\w+), (?P<engine>\w+)(?:, seed (?P<seed>\d+))?(?:, (?P<study>.+))?$"


def draw(errors: pd.DataFrame, usual: str, folder: Path, machine: str) -> tuple[list[Path], dict[str, float]]:
    """Draw the convergence of the simulator, and the renderers that do not know the scatterers.

    Parameters
    ----------
    errors : DataFrame
        Columns `POINTS`, and `WORSE_BOUNDS` where they are known.
    usual : str
        The setting of the simulator that is the re-simulation, as `rays 16`.
    folder : Path
        Of the figures.
    machine : str
        On which times were measured.

    Returns
    -------
    list of Path, dict of str to float
        The figures, and the re-simulation's value by metric.
    """
    level = resimulation_level(errors, usual)
    drawn = error_vs_runtime(renderers(errors, usual), folder / "renderers", level, machine)
    if errors["series"].isin(list(SERIES)).any():  # not where the simulator is the user's own
        drawn = [*convergence_figure(errors, folder / "precision", machine), *drawn]
    return drawn, level


def resimulation_level(errors: pd.DataFrame, usual: str) -> dict[str, float]:
    """The error of re-simulation by metric: the simulator at the settings of the data set, `usual`."""
    resimulated = errors[(errors["series"] == OTHER_SERIES) & (errors["setting"] == usual)]
    return dict(zip(resimulated["metric"], resimulated["error"], strict=True))


def renderers(errors: pd.DataFrame, usual: str) -> pd.DataFrame:
    """The renderers that do not know the scatterers, as `error_vs_runtime` draws them.

    Of a network they are the fastest engine and the first seed, in each precision; of the simulator the settings that
    are no slower than those of the data set, `usual`.
    """
    points = errors[~errors["series"].isin([*SERIES])]
    points = points[points["metric"] != ENVELOPE]
    simulated = points[points["series"] == OTHER_SERIES]
    resimulated = simulated[simulated["setting"] == usual]
    faster = simulated[(simulated["ms"] < resimulated["ms"].min()) & (simulated["setting"] != usual)]
    again = faster.merge(resimulated[["metric", "error"]], on=["metric", "error"])  # from another ladder
    faster = faster[~faster["setting"].isin(again["setting"])]
    names = {setting: named_setting(OTHER_SERIES, setting) for setting in faster["setting"]} | {usual: RESIMULATION}
    settings = pd.concat([resimulated, faster]).assign(setting=lambda table: table["setting"].map(names))
    formula = points[points["series"] == FORMULA].assign(setting="")
    networks = points[~points["series"].isin([OTHER_SERIES, FORMULA])]
    ways = networks["setting"].str.extract(WAY)
    ranked = networks.assign(**ways, number=ways["seed"].astype(float).fillna(0.0)).sort_values(["number", "ms"])
    first = ranked.drop_duplicates(["series", "study", "precision", "metric"]).sort_index()
    twice = first.duplicated(["series", "precision", "metric"], keep=False)  # from several studies
    first = first.assign(setting=first["precision"] + (", " + first["study"]).where(twice).fillna(""))
    return pd.concat([settings, formula, first])[errors.columns].reset_index(drop=True)
