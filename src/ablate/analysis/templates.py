"""The texts of the report, from the templates beside this file."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from ablate.analysis.scored import REFERENCE, RESIMULATION
from ablate.analysis.tables import head, resimulation_note
from ablate.metrics import metric_of

FEWEST_SITES = 6  # below, a signed-rank test over sites cannot reach 5 %
MOST_NAMED = 6  # of a list; the rest are counted


def listed(names: list[str]) -> str:
    """Names in a sentence, the rest counted where there are many."""
    more = len(names) - MOST_NAMED
    if more <= 0:
        return ", ".join(names)
    return f"{', '.join(names[:MOST_NAMED])} and {more} more"


_TEMPLATES = Environment(
    loader=FileSystemLoader(Path(__file__).parent),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_TEMPLATES.globals.update(resimulation=RESIMULATION, metric_of=metric_of, listed=listed, fewest_sites=FEWEST_SITES)
_TEMPLATES.filters["head_of"] = head
_TEMPLATES.tests["missing"] = pd.isna


def filled(template: str, **values: object) -> str:
    """The text of a template, by the name of its file."""
    return _TEMPLATES.get_template(template).render(values)


def caption(
    figure: str, metrics: Sequence[str] = (), reference: str = REFERENCE, resimulated: bool = True, **facts: object
) -> str:
    """Caption of a figure.

    Parameters
    ----------
    figure : str
        The name of its entry.
    metrics : sequence of str
        That it shows.
    reference : str
        The variant that the others are compared with.
    resimulated : bool
        Whether there is a re-simulation, which pairs that were made elsewhere may lack; else nothing is said of it.
    **facts
        What else the text in `captions.jinja` uses.
    """
    labels = ", ".join(metric_of(metric).label for metric in metrics)
    note = resimulation_note(list(metrics)) if resimulated else ""
    text = filled(
        "captions.jinja",
        figure=figure,
        labels=labels,
        note=note,
        reference=reference,
        resimulated=resimulated,
        **facts,
    )
    return " ".join(text.split())
