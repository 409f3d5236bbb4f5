"""Whether a network is worth training: what the simulator reaches in its time, and when it is as near."""

import pandas as pd

from ablate.analysis import RESIMULATION
from ablate.analysis.figures.convergence_figure import SERIES, named_setting
from ablate.metrics import metric_of
from ablate.metrics.metric import FORMULA
from ablate.numerics.precision.bench import OTHER_SERIES
from ablate.numerics.precision.figures import WAY

#: Metrics that do not reward a renderer for smoothing the speckle away.
JUDGES = ("mae_smooth", "pchi2")
_NONE = "none"


def worth(errors: pd.DataFrame, usual: str) -> pd.DataFrame:
    """Each renderer that is not the simulator, beside the simulator's settings; all make speckle of their own.

    A network's error is the mean of its trainings, in the precision of its fastest engine, whose time counts.

    Parameters
    ----------
    errors : DataFrame
        Columns series, setting, ms, metric, error.
    usual : str
        The setting of the simulator that is the re-simulation, as `rays 16`.

    Returns
    -------
    DataFrame
        A row a renderer and metric, with cells as text. Errors are those above re-simulation. `in its time` is the
        nearest setting of the simulator that takes no more time, `as near` the fastest that is as near, and `times as
        long` its time over the renderer's.
    """
    judged = errors[errors["metric"].isin(JUDGES)]
    metrics = [metric_of(metric) for metric in judged["metric"]]
    badness = [metric.badness(error) for metric, error in zip(metrics, judged["error"], strict=True)]
    judged = judged.assign(badness=badness, title=[metric.title for metric in metrics])
    simulated = judged[judged["series"] == OTHER_SERIES]
    rows = []
    for (renderer, metric), points in _renderers(judged).groupby(["renderer", "metric"], sort=False):
        ms, renderer_error = points["ms"].iloc[0], points["badness"].mean()
        settings = simulated[simulated["metric"] == metric]
        level = settings.loc[settings["setting"] == usual, "badness"].iloc[0]
        within = settings[settings["ms"] <= ms].sort_values("badness").head(1)
        near = settings[settings["badness"] <= renderer_error].sort_values("ms").head(1)
        decimals = metric_of(str(metric)).decimals
        rows.append(
            {
                "renderer": renderer,
                "metric": points["title"].iloc[0],
                "ms": f"{ms:.1f}",
                "above": f"{renderer_error - level:.{decimals}f}",
                "in its time": _named(within, usual),
                "its error above": f"{within['badness'].iloc[0] - level:.{decimals}f}" if len(within) else _NONE,
                "as near": _named(near, usual),
                "times as long": f"{near['ms'].iloc[0] / ms:.1f}" if len(near) else _NONE,
            }
        )
    return pd.DataFrame(rows).set_index(["renderer", "metric"]) if rows else pd.DataFrame()


def _renderers(judged: pd.DataFrame) -> pd.DataFrame:
    """Points of the formula, and of the networks a training each in the way that is the fastest of its variant."""
    formula = judged[judged["series"] == FORMULA].assign(renderer=FORMULA)
    networks = judged[~judged["series"].isin([*SERIES, OTHER_SERIES, FORMULA])]
    ways = networks["setting"].str.extract(WAY)
    study = (", " + ways["study"]).where(ways["study"].notna(), "")
    networks = networks.assign(**ways, renderer=networks["series"] + study)
    chosen = [formula]
    for _, points in networks.groupby("renderer", sort=False):
        fastest = points.sort_values("ms").iloc[0]
        same = points[points["precision"] == fastest["precision"]]
        first_engine = same["engine"].iloc[0]  # in which every training is measured
        chosen.append(same[same["engine"] == first_engine].assign(ms=fastest["ms"]))
    return pd.concat(chosen)


def _named(settings: pd.DataFrame, usual: str) -> str:
    """What the simulator's setting is called, with its time."""
    if settings.empty:
        return _NONE
    setting, ms = settings["setting"].iloc[0], settings["ms"].iloc[0]
    name = RESIMULATION if setting == usual else named_setting(OTHER_SERIES, setting)
    return f"{name}, {ms:.1f} ms"
