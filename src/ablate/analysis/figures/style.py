"""One look for all figures: paper widths, 8 pt, colours that survive grey print, and names."""

import re
from collections.abc import Sequence
from contextlib import AbstractContextManager
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from ablate.analysis.components import Component
from ablate.analysis.scored import REFERENCE, RESIMULATION
from ablate.metrics import Direction, Resimulation, metric_of
from ablate.metrics.metric import FORMULA
from ablate.storage import written_whole

PAGE_IN = 7.16  # width of a page of an IEEE paper, inches
PNG_DPI = 200
HINTS = {Direction.higher: "better →", Direction.lower: "← better", Direction.zero: "0 is right", Direction.none: ""}

# Okabe and Ito (2008), told apart by the colour-blind, from dark to light so that the order also holds in grey.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#999999", "#F0E442")
FLOOR_COLOUR = "#444444"
FORMULA_COLOUR = "#D55E00"

_RULES: Any = mpl.rc_params_from_file(Path(__file__).with_name("house.mplstyle"), use_default_template=False)


def house_style(width_in: float = PAGE_IN) -> AbstractContextManager[None]:
    """The rules that a figure and its artists are made under; the type of a figure wider than a page is larger."""
    return mpl.rc_context({**_RULES, "font.size": _RULES["font.size"] * max(width_in / PAGE_IN, 1.0)})


def new_figure(width_in: float, height_in: float, pad_in: float = 0.04) -> Figure:
    """A figure without pyplot's global state, `pad_in` inches of white space around each panel."""
    layout = ConstrainedLayoutEngine(w_pad=pad_in, h_pad=pad_in, wspace=0.0, hspace=0.0)
    return Figure(figsize=(width_in, height_in), layout=layout)


def save_figure(figure: Figure, stem: Path) -> list[Path]:
    """Write a figure as PNG and PDF, with the same layout, to `stem`, a path without suffix; its folder is made."""
    stem.parent.mkdir(parents=True, exist_ok=True)
    paths = [stem.with_name(stem.name + suffix) for suffix in (".png", ".pdf")]
    for path in paths:
        about = {"CreationDate": None} if path.suffix == ".pdf" else None
        in_memory = BytesIO()
        figure.savefig(in_memory, format=path.suffix[1:], dpi=PNG_DPI, metadata=about)
        with written_whole(path) as partial:  # not by Matplotlib, whose PDF hides that a disk is full
            partial.write_bytes(in_memory.getvalue())
        figure.set_layout_engine("none")  # the second file takes the places found for the first
    return paths


def colour_of(name: str, names: Sequence[str]) -> str:
    """The colour of a network, one of `names`: black for the reference."""
    others = [other for other in names if other != REFERENCE]
    return "#000000" if name == REFERENCE else COLOURS[others.index(name) % len(COLOURS)]


def shown_name(label: str, components: Sequence[Component] = ()) -> str:
    """A label as it is written on a figure: `sa2h.concat-input.depth-6` becomes `sa2h −concat depth 6`.

    What was changed beside a variant is written in short where it is one of the components.
    """
    variant, *changes = re.split(r"\.(?=[a-z])", label)
    short = {component.key.rpartition(".")[2]: component for component in reversed(components)}
    shown = [variant]
    for change in changes:
        key, _, level = change.partition("-")
        component = short.get(key)
        if component is not None and isinstance(component.off, int | float):  # which number is "off" follows the frame
            shown.append(f"{key} {level}")
        elif component is None or level != str(component.off):
            shown.append(f"+ {change}")
        else:  # of a whole group nothing is left out
            shown.append(f"−{component.name}" if "." in component.key else f"+ {level}")
    return " ".join(shown)


def axis_title(metric: str, shown: str = "{}") -> str:
    """Name of a metric within `shown` (`Δ {} to sa2h`), and on a line below its unit and which way is better."""
    entry = metric_of(metric)
    hint = HINTS[entry.better]
    if entry.better is Direction.zero and shown != "{}":
        hint = ""
    below = [text for text in (entry.unit, hint) if text]
    return f"{shown.format(entry.label)}\n{', '.join(below)}"


def baseline_line(metric: str, baseline: str = RESIMULATION, after: str = "") -> dict[str, Any]:
    """How a figure draws a baseline, as one entry of the legend; re-simulation is dashed for a floor, else dotted."""
    if baseline == FORMULA:
        return {"color": FORMULA_COLOUR, "ls": "-.", "label": f"{baseline}{after}"}
    style = "--" if metric_of(metric).resimulation is Resimulation.floor else ":"
    return {"color": FLOOR_COLOUR, "ls": style, "label": f"{baseline}{after} (dashed: floor, dotted: level)"}


def one_legend(figure: Figure, panels: Sequence[Axes]) -> None:
    """One legend above all panels, three columns wide, each entry once; none without an entry."""
    entries: dict[str, Artist] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    if entries:
        style: dict[str, Any] = {"ncols": 3, "frameon": False, "handlelength": 1.6}
        figure.legend(entries.values(), entries.keys(), loc="outside upper center", **style)
