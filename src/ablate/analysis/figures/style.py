"""One look for all figures: paper widths, 8 pt, colours that survive colour blindness and grey print."""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from ablate.analysis.scored import REFERENCE, RESIMULATION
from ablate.storage import written_whole

COLUMN_IN, PAGE_IN = 3.5, 7.16  # widths of a column and a page of an IEEE paper, inches
PNG_DPI = 200

# Okabe and Ito (2008), from dark to light so that the order also holds in grey.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#999999", "#F0E442")
FLOOR_COLOUR = "#444444"

FONT_PT = 8.0
RULES: dict[str, Any] = {
    **dict.fromkeys(("axes.titlesize", "axes.labelsize", "xtick.labelsize", "ytick.labelsize"), "medium"),
    "legend.fontsize": "medium",
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "pdf.fonttype": 42,  # editable text
    "svg.fonttype": "none",
}


def house_style(width_in: float = PAGE_IN) -> AbstractContextManager[None]:
    """The rules that a figure and its artists are made under; the type of a figure wider than a page is larger."""
    settings: Any = RULES | {"font.size": FONT_PT * max(width_in / PAGE_IN, 1.0)}
    return mpl.rc_context(settings)


def new_figure(width_in: float, height_in: float, pad_in: float = 0.04) -> Figure:
    """A figure without pyplot's global state, `pad_in` inches of white space around each panel."""
    layout = ConstrainedLayoutEngine(w_pad=pad_in, h_pad=pad_in, wspace=0.0, hspace=0.0)
    return Figure(figsize=(width_in, height_in), layout=layout)


def save_figure(figure: Figure, stem: Path) -> list[Path]:
    """Write a figure as PNG and PDF, with the same layout, to `stem`, a path without suffix; its folder is made."""
    stem.parent.mkdir(parents=True, exist_ok=True)
    paths = [stem.with_name(stem.name + suffix) for suffix in (".png", ".pdf")]
    for path in paths:
        with written_whole(path) as partial:
            figure.savefig(partial, dpi=PNG_DPI, metadata={"CreationDate": None} if path.suffix == ".pdf" else None)
        figure.set_layout_engine("none")  # the second file takes the places found for the first
    return paths


def colour_of(name: str, names: Sequence[str]) -> str:
    """The same colour for a name of a study in every figure: dark grey for re-simulation, black for the reference."""
    if name in (RESIMULATION, REFERENCE):
        return {RESIMULATION: FLOOR_COLOUR, REFERENCE: "#000000"}[name]
    others = [other for other in names if other not in (RESIMULATION, REFERENCE)]
    return COLOURS[others.index(name) % len(COLOURS)]
