"""What may not be concluded from a study."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from ablate.analysis.scored import (
    BASELINE_NAMES,
    REFERENCE,
    RESIMULATION,
    every_frame,
    is_network,
    ordered_metrics,
    ordered_variants,
)
from ablate.analysis.statistics.component_claims import FEWEST_SEEDS
from ablate.analysis.templates import filled
from ablate.metrics import METRICS, Shown, metric_of, shown_in
from ablate.metrics.metric import FORMULA

FEW_SITES = 10  # below, intervals over sites are rough
#: The positive control: if the best network has more than so many times re-simulation's error, none renders.
CONTROL, MOST_TIMES = "mae_smooth", 1.7
#: And if the texture of the best one is off by more, none draws speckle.
TEXTURE_CONTROL, MOST_DB = "octave_sd", 1.0
_FRAMES_NAMED = 3  # of a run with a gap


@dataclass(frozen=True)
class _Gap:
    """Values of a metric that are not finite: their kind, how many there are, and their runs and frames."""

    metric: str
    kind: str
    count: int
    where: list[str]


def cautions(per_image: pd.DataFrame, reference: str = REFERENCE, blocks: pd.DataFrame | None = None) -> list[str]:
    """Return what a reader must not conclude from a study, one sentence each; `per_image` as for `comparison_table`.

    `blocks` has the same of runs on other anatomies or data sets, which verdicts use too, with a column data in both.
    """
    networks = per_image[is_network(per_image["variant"])]
    variants = ordered_variants(list(networks["variant"]), reference)
    seeds = networks.groupby("variant")["seed"].nunique()
    all_rows = pd.concat([per_image if "data" in per_image else per_image.assign(data=""), blocks])
    text = filled(
        "cautions.jinja",
        reference=reference,
        variants=variants,
        few=[f"{variant} ({seeds[variant]})" for variant in variants if seeds[variant] < FEWEST_SEEDS],
        fewest_seeds=FEWEST_SEEDS,
        resimulated=RESIMULATION in set(per_image["variant"]),
        control=_times_of_resimulation(per_image),
        most_times=MOST_TIMES,
        texture=_least(per_image, TEXTURE_CONTROL),
        most_db=MOST_DB,
        texture_label=metric_of(TEXTURE_CONTROL).label,
        below=_below_the_formula(per_image, reference),
        label=metric_of(CONTROL).label,
        sites=networks["site"].nunique(),
        few_sites=FEW_SITES,
        short=_short_runs(all_rows),
        gaps=_gaps(all_rows),
        metrics_of_the_package=METRICS,
    )
    return [" ".join(paragraph.split()) for paragraph in text.split("\n\n") if paragraph.strip()]


def _times_of_resimulation(per_image: pd.DataFrame) -> float:
    """How many times the error of re-simulation the best network has; NaN where it is not known."""
    errors = per_image[per_image["metric"] == CONTROL].groupby("variant")["value"].mean().replace(0.0, np.nan)
    return errors.drop([*BASELINE_NAMES], errors="ignore").min() / errors.get(RESIMULATION, np.nan)


def _least(per_image: pd.DataFrame, metric: str) -> float:
    """The smallest mean of a metric that a network has; NaN where none has one."""
    values = per_image[(per_image["metric"] == metric) & is_network(per_image["variant"])]
    return float(values.groupby("variant")["value"].mean().min())


def _below_the_formula(per_image: pd.DataFrame, reference: str) -> list[str]:
    """Labels of the metrics of the headline in which the reference is worse than the formula."""
    finite = per_image[np.isfinite(per_image["value"].astype("float64"))]
    means = finite.groupby(["variant", "metric"])["value"].mean()
    if not {reference, FORMULA} <= set(means.index.get_level_values("variant")):
        return []
    labels = []
    for name in shown_in(Shown.headline):
        judge = metric_of(name)
        of_reference, of_formula = (judge.badness(means[v].get(name, np.nan)) for v in (reference, FORMULA))
        if of_reference > of_formula:
            labels.append(judge.label)
    return labels


def _short_runs(per_image: pd.DataFrame) -> list[str]:
    """The runs that have fewer test frames than another one of their data set, and how many."""
    networks = per_image[is_network(per_image["variant"])]
    frames = networks.groupby(["data", "variant", "seed"])["frame"].nunique().reset_index()
    frames["most"] = frames.groupby("data")["frame"].transform("max")
    short = frames[frames["frame"] < frames["most"]].to_dict("records")
    return [f"{run['variant']}/seed{run['seed']} ({run['frame']} of {run['most']})" for run in short]


def _gaps(per_image: pd.DataFrame) -> list[_Gap]:
    """The gaps of all metrics.

    A value is missing where another run has one of the frame: where none has, the frame offers nothing to measure.
    """
    gaps = []
    all_frames = every_frame(per_image)
    for metric in ordered_metrics(list(per_image["metric"])):
        rows = all_frames[all_frames["metric"] == metric]
        value = rows["value"]
        stored = rows["stored"] == "both"
        elsewhere = stored.groupby([rows["data"], rows["frame"]]).transform("any")
        kinds = {"infinite value": np.isinf(value), "NaN": value.isna() & stored, "missing value": elsewhere & ~stored}
        for kind, is_of_kind in kinds.items():
            left_out = rows[is_of_kind]
            if len(left_out):
                gaps.append(_Gap(metric, kind, len(left_out), _frames_by_run(left_out)))
    return gaps


def _frames_by_run(rows: pd.DataFrame) -> list[str]:
    """Each run of these rows, with the first of its frames."""
    texts = []
    for (variant, seed), frames in rows["frame"].astype(str).groupby([rows["variant"], rows["seed"]], sort=False):
        more = " ..." if len(frames) > _FRAMES_NAMED else ""
        texts.append(f"{variant}/seed{seed} frame {', '.join(frames.iloc[:_FRAMES_NAMED])}{more}")
    return texts
