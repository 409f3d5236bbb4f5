"""Factorial effects with their intervals, a panel a metric."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from ablate.analysis.components import short_keys
from ablate.analysis.figures.metric_panels import (
    axis_title,
    draw_resimulation,
    metric_panels,
    one_legend,
    resimulation_word,
)
from ablate.analysis.figures.style import house_style, save_figure
from ablate.metrics import metric_of


def effects_plot(
    effects: pd.DataFrame, metrics: Sequence[str], stem: Path, gaps: Mapping[str, float] | None = None
) -> list[Path]:
    """Draw every effect as a dot with its interval; filled where the interval excludes 0, a ring where it does not.

    Metrics without effects are left out. The files are a PNG and a PDF at `stem`, a path without suffix; none without
    effects.

    Parameters
    ----------
    effects : DataFrame
        What `effects_table` gives.
    gaps : mapping of str to float, optional
        By metric, the re-simulation minus the reference: what there is to gain where it is a floor. It is written under
        the panel, and drawn where it lies within.
    """
    shown = [metric for metric in metrics if metric in set(effects["metric"])]
    if not shown:
        return []
    names = list(dict.fromkeys(effects["effect"]))
    short = short_keys(dict.fromkeys(key for name in names for key in name.split(":")))
    with house_style():
        figure, panels = metric_panels(
            shown, [":".join(short[key] for key in name.split(":")) for name in names], 4, head_in=0.7
        )
        for axes, metric in zip(panels, shown, strict=True):
            axes.axvline(0, color="black", lw=0.8, zorder=1)
            for row in effects[effects["metric"] == metric].to_dict("records"):
                place = len(names) - names.index(row["effect"])
                known = not pd.isna(row["lower"])
                if known:
                    axes.plot([row["lower"], row["upper"]], [place] * 2, color="black", lw=1.0, solid_capstyle="butt")
                excludes = known and (row["lower"] > 0 or row["upper"] < 0)
                label = "interval excludes 0" if excludes else "interval holds 0" if known else "no interval"
                fill = "black" if excludes else "white"
                marker = "o" if known else "D"
                axes.plot([row["estimate"]], [place], marker, ms=4, mfc=fill, mec="black", mew=0.8, label=label)
            title, gap = axis_title(metric, "effect on {}"), (gaps or {}).get(metric, np.nan)
            lower, upper = axes.get_xlim()
            if lower < gap < upper:
                draw_resimulation(axes, metric, gap)
            if np.isfinite(gap):
                distance = f"{gap:+.{metric_of(metric).decimals}f}".replace("-", "−")
                title += f"\nre-simulation {distance} ({resimulation_word(metric)})"
            axes.set_xlabel(title)
        one_legend(figure, panels)
        return save_figure(figure, stem)
