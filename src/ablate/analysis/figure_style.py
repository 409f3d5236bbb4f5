"""One look for all figures: paper widths, 8 pt, colours that survive colour blindness and grey print."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from ablate.analysis.metric_facts import REFERENCE, RESIMULATION

COLUMN_IN, PAGE_IN = 3.5, 7.16  # widths of a column and a page of an IEEE paper, inches
PNG_DPI = 200

# Okabe and Ito (2008), from dark to light so that the order also holds in grey.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#999999", "#F0E442")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
FLOOR_COLOUR = "#444444"

STYLE = {
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.fontsize": 8,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "pdf.fonttype": 42,  # editable text
    "svg.fonttype": "none",
}


def new_figure(width_in: float, height_in: float) -> Figure:
    """A figure without pyplot's global state; make it and its artists inside `rc_context(STYLE)`.

    Parameters
    ----------
    width_in, height_in : float
        Inches.

    Returns
    -------
    Figure
    """
    return Figure(figsize=(width_in, height_in), layout="constrained")


def save_figure(figure: Figure, stem: Path) -> list[Path]:
    """Write a figure as PNG and PDF.

    Parameters
    ----------
    figure : Figure
    stem : Path
        Path without suffix; its folder is made.

    Returns
    -------
    list of Path
        The PNG, then the PDF.
    """
    stem.parent.mkdir(parents=True, exist_ok=True)
    paths = [stem.with_name(stem.name + suffix) for suffix in (".png", ".pdf")]
    with mpl.rc_context(STYLE):
        figure.savefig(paths[0], dpi=PNG_DPI)
        figure.savefig(paths[1], dpi=PNG_DPI, metadata={"CreationDate": None})
    return paths


def colour_of(name: str, names: Sequence[str]) -> str:
    """The same colour for a variant in every figure: dark grey for re-simulation, black for the reference.

    Parameters
    ----------
    name : str
    names : sequence of str
        All names of the study, in the order they are shown.

    Returns
    -------
    str
    """
    if name in (RESIMULATION, REFERENCE):
        return {RESIMULATION: FLOOR_COLOUR, REFERENCE: "#000000"}[name]
    others = [other for other in names if other not in (RESIMULATION, REFERENCE)]
    return COLOURS[others.index(name) % len(COLOURS)]
