"""What stands under every figure: what is drawn, and what the re-simulation in it means."""

from collections.abc import Sequence

import pandas as pd

from ablate.analysis.components import short_keys
from ablate.analysis.order import REFERENCE
from ablate.analysis.statistics.designs import Design, interval_note
from ablate.analysis.tables.formats import resimulation_note
from ablate.metrics import metric_of

INTERACTION = "An interaction a:b is half the difference that b makes to the effect of a."


def boxplot_caption(metrics: Sequence[str], reference: str = REFERENCE) -> str:
    """Caption of `paired_boxplots` and `boxplot_panels`."""
    names = ", ".join(metric_of(metric).label for metric in metrics)
    return (
        f"Paired differences from {reference} in {names} on the same test frames (means over seeds). A box shows "
        "quartiles, and its whiskers show the 5th and 95th percentiles. The bar below a box is the 95 % interval of "
        f"the median shift over probe sites. {resimulation_note(list(metrics))}"
    )


def qualitative_caption(reference: str = REFERENCE) -> str:
    """Caption of `qualitative_figure`."""
    return (
        "Test frames of unseen probe sites. The target has its segmentation S in the left corner and the logarithm of "
        "its attenuation A in the right corner. The re-simulation is the same frame with other scatterers and ray "
        "paths. Where it differs from the target, no network can know the target. The other images are by "
        f"{reference} and all other variants, with the lowest seed of each."
    )


def chi2_caption(frame: str) -> str:
    """Caption of `chi2_maps_figure` of the frame of that name."""
    return (
        f"Maps of patch chi-square against the target on [0, 1], each above its image ({frame}). The number is the RMS "
        "over all patches that lie wholly in the fan. The map of the re-simulation is the floor, because it differs "
        "from the target by its scatterers alone."
    )


def seeds_caption(metrics: Sequence[str], reference: str = REFERENCE) -> str:
    """Caption of `seed_plot`."""
    return (
        "Scores of all trainings. A ring is the mean over the test frames for one seed. A component matters where its "
        f"rings are separate from those of {reference} (grey). {resimulation_note(list(metrics))}"
    )


def verdicts_caption(design: Design | None, reference: str = REFERENCE) -> str:
    """Caption of `forest_figure`."""
    said = [
        "Which components earn their keep. Each is judged on its own primary metric. The unit is the distance from "
        f"{reference} to re-simulation in that metric, that is, the error that {reference} still has. Zero is the mean "
        "of the runs without the component. Dots are runs, adjusted for the other components and the anatomy. "
        "earns: the metric improves. does not: the improvement is smaller than the grey band, which was fixed before "
        "the study. Both verdicts are at 5 % after Holm's correction over the components. The columns at the right "
        "show what the component adds to the time of a frame and to the parameters of the network.",
        "" if design is None else f"The design is: {design.name}. {design.reading}",
    ]
    return " ".join(filter(None, said))


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


def runtime_caption(metrics: Sequence[str]) -> str:
    """Caption of `error_vs_runtime`."""
    return (
        "Error on the test frames against the median time per frame, with the maps that the network reads, on the "
        "machine that the figure names. Bars are quartiles over rounds in which all networks took turns. The grey line "
        f"is the Pareto front; no point is on it for a time that differs by less than the bars. The paper does "
        f"not name the GPU of its times. {resimulation_note(list(metrics))}"
    )
