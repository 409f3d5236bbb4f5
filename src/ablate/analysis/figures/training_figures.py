"""What every training scored, and the factorial effects that follow from it: a panel a metric."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from ablate.analysis.components import Component, short_keys
from ablate.analysis.figures.metric_panels import (
    axis_title,
    draw_resimulation,
    metric_panels,
    one_legend,
    resimulation_word,
    shown_name,
)
from ablate.analysis.figures.style import house_style, save_figure
from ablate.analysis.scored import REFERENCE, RESIMULATION, finite_values, ordered_variants
from ablate.analysis.statistics.designs import Design, interval_note
from ablate.analysis.tables import resimulation_note
from ablate.metrics import metric_of

INTERACTION = "An interaction a:b is half the difference that b makes to the effect of a."


def seed_plot(
    per_image: pd.DataFrame,
    scalars: pd.DataFrame | None,
    metrics: Sequence[str],
    stem: Path,
    reference: str = REFERENCE,
    components: Sequence[Component] = (),
) -> list[Path]:
    """Draw one ring a training at its mean over the test frames, a panel a metric, with the re-simulation.

    The grey band is the range of the reference's trainings. Metrics without a finite value are left out. The files are
    a PNG and a PDF at `stem`, a path without suffix; none without a network.

    Parameters
    ----------
    per_image : DataFrame
        Columns variant, seed, frame, site, metric, value.
    scalars : DataFrame, optional
        Columns variant, seed, metric, value.
    components : sequence of Component
        Changes of these are written in short.
    """
    values = finite_values(per_image, scalars)
    networks = values[values["variant"] != RESIMULATION]
    shown = [metric for metric in metrics if metric in set(networks["metric"])]
    if not shown:
        return []
    rows = ordered_variants(list(networks["variant"]), reference)
    means = networks.groupby(["metric", "variant", "seed"])["value"].mean()
    floors = values[values["variant"] == RESIMULATION].groupby("metric")["value"].mean()
    with house_style():
        figure, panels = metric_panels(shown, [shown_name(row, components) for row in rows], 4)
        for axes, metric in zip(panels, shown, strict=True):
            for k, variant in enumerate(rows):
                if (metric, variant) not in means.index:
                    continue
                scores = means[metric, variant].to_numpy()
                heights = np.full(len(scores), len(rows) - k)
                axes.plot(scores, heights, "o", ms=4, mfc="none", mec="black", mew=0.8, label="one training")
                axes.plot(
                    scores.mean(keepdims=True), heights[:1], "|", ms=9, color="#0072B2", mew=1.8, label="mean", zorder=1
                )
                if variant == reference:
                    axes.axvspan(scores.min(), scores.max(), color="#E3E3E3", zorder=0, label=f"range of {reference}")
            draw_resimulation(axes, metric, floors.get(metric, np.nan))
            axes.set_xlabel(axis_title(metric))
        one_legend(figure, panels, 5)
        return save_figure(figure, stem)


def seeds_caption(metrics: Sequence[str], reference: str = REFERENCE) -> str:
    """Caption of `seed_plot`."""
    return (
        "Scores of all trainings. A ring is the mean over the test frames for one seed. A component matters where its "
        f"rings are separate from those of {reference} (grey). {resimulation_note(list(metrics))}"
    )


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


def effects_caption(design: Design, effects: pd.DataFrame, gap_to: str | None = None) -> str:
    """Caption of `effects_plot`; `gap_to` names the reference where gaps are written below the panels."""
    changes = ", ".join(
        f"{name} {' → '.join(map(str, design.cells[key].cat.categories))}"
        for key, name in short_keys(design.factors).items()
    )
    said = [
        f"Effects of changing a component ({changes}), computed from one mean per training. The 95 % intervals are not "
        f"corrected for the number of effects. The design is: {design.name}. {design.reading}",
        INTERACTION if effects["effect"].str.contains(":").any() else "",
        interval_note(effects),
        f"The number below a panel is the re-simulation minus {gap_to}." if gap_to else "",
        resimulation_note(list(dict.fromkeys(effects["metric"]))),
    ]
    return " ".join(filter(None, said))
