"""What stands under every figure: what is drawn, and what the re-simulation in it means."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from ablate.analysis.designs import Design, interval_note
from ablate.analysis.metric_facts import REFERENCE, facts_of
from ablate.analysis.table_formats import resimulation_note

INTERACTION = "An interaction a:b is half the difference that b makes to the effect of a."


def boxplot_caption(metrics: Sequence[str], reference: str = REFERENCE) -> str:
    """Caption of `paired_boxplots` and `boxplot_panels`.

    Parameters
    ----------
    metrics : sequence of str
    reference : str

    Returns
    -------
    str
    """
    names = ", ".join(facts_of(metric).label for metric in metrics)
    return (
        f"Paired differences to {reference} in {names} on the same test frames (means over seeds): quartiles, whiskers "
        "from the 5th to the 95th percentile; the bar below a box is the 95 % interval of the median shift over probe "
        f"sites. {resimulation_note(list(metrics))}"
    )


def qualitative_caption(reference: str = REFERENCE) -> str:
    """Caption of `qualitative_figure`.

    Parameters
    ----------
    reference : str

    Returns
    -------
    str
    """
    return (
        "Test frames of unseen probe sites: the target with its segmentation S (left corner) and the logarithm of its "
        "attenuation A (right corner), the re-simulation (the same frame with other scatterers: where it differs from "
        f"the target no network can know better), {reference} and every other variant, the lowest seed of each."
    )


def chi2_caption(frame: str) -> str:
    """Caption of `chi2_maps_figure`.

    Parameters
    ----------
    frame : str
        Name of the frame.

    Returns
    -------
    str
    """
    return (
        f"Patch chi-square to the target on [0, 1], above its image; {frame}. The number is the RMS over patches "
        "wholly inside the fan. The re-simulation's map is the floor: what other scatterers alone make of it."
    )


def seeds_caption(metrics: Sequence[str], reference: str = REFERENCE) -> str:
    """Caption of `seed_plot`.

    Parameters
    ----------
    metrics : sequence of str
    reference : str

    Returns
    -------
    str
    """
    return (
        "What every training scored: a ring is the mean over the test frames of one seed. A component is said to "
        f"matter where its rings stand apart from those of {reference} (grey). {resimulation_note(list(metrics))}"
    )


def effects_caption(design: Design, effects: pd.DataFrame) -> str:
    """Caption of `effects_plot`.

    Parameters
    ----------
    design : Design
    effects : DataFrame
        What `effects_table` gives.

    Returns
    -------
    str
    """
    changes = ", ".join(f"{name} {' → '.join(map(str, design.cells[name].cat.categories))}" for name in design.factors)
    said = [
        f"Effects of changing a component ({changes}), from one mean a training, with 95 % intervals of one effect "
        f"alone: {design.name}. {design.reading}",
        INTERACTION if effects["effect"].str.contains(":").any() else "",
        interval_note(effects),
        resimulation_note(list(dict.fromkeys(effects["metric"]))),
    ]
    return " ".join(filter(None, said))


def runtime_caption(metrics: Sequence[str]) -> str:
    """Caption of `error_vs_runtime`.

    Parameters
    ----------
    metrics : sequence of str

    Returns
    -------
    str
    """
    return (
        "Error on the test frames against the median time of a frame on this machine, with the Pareto front. The "
        f"paper's times are of an unknown GPU. {resimulation_note(list(metrics))}"
    )
