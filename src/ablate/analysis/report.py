"""What may not be concluded from a study, and its report: one self-contained page of tables, statistics and figures."""

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from ablate.analysis.components import Component
from ablate.analysis.scored import REFERENCE, RESIMULATION, every_frame, ordered_metrics, ordered_variants
from ablate.analysis.statistics.component_claims import FEWEST_SEEDS
from ablate.analysis.tables import cell_texts, head, resimulation_note
from ablate.metrics import METRICS, Shown, metric_of, shown_in
from ablate.storage import write_text

FEW_SITES = 10  # below, intervals over sites are rough
FEWEST_SITES = 6  # below, a signed-rank test over sites cannot reach 5 %
#: The positive control: if the best network has more than so many times re-simulation's error, none renders.
CONTROL, MOST_TIMES = "mae_smooth", 1.7
MOST_NAMED = 6  # of a list; the rest are counted


def listed(names: list[str]) -> str:
    """Names in a sentence, the rest counted where there are many."""
    more = len(names) - MOST_NAMED
    return ", ".join(names) if more <= 0 else f"{', '.join(names[:MOST_NAMED])} and {more} more"


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


def cautions(per_image: pd.DataFrame, reference: str = REFERENCE, blocks: pd.DataFrame | None = None) -> list[str]:
    """Return what a reader must not conclude from a study, one sentence each; `per_image` as for `comparison_table`.

    `blocks` has the same of runs on other anatomies or data sets, which verdicts use too, with a column data in both.
    """
    networks = per_image[per_image["variant"] != RESIMULATION]
    variants = ordered_variants(list(networks["variant"]), reference)
    seeds = networks.groupby("variant")["seed"].nunique()
    everything = pd.concat([per_image if "data" in per_image else per_image.assign(data=""), blocks])
    judged = everything[everything["variant"] != RESIMULATION]
    frames = judged.groupby(["data", "variant", "seed"])["frame"].nunique()
    runs = zip(frames.index, frames, frames.groupby("data").transform("max"), strict=True)
    errors = per_image[per_image["metric"] == CONTROL].groupby("variant")["value"].mean().replace(0.0, np.nan)
    text = _TEMPLATES.get_template("cautions.jinja").render(
        reference=reference,
        variants=variants,
        few=[f"{v} ({seeds[v]})" for v in variants if seeds[v] < FEWEST_SEEDS],
        fewest_seeds=FEWEST_SEEDS,
        resimulated=RESIMULATION in set(per_image["variant"]),
        control=errors.drop(RESIMULATION, errors="ignore").min() / errors.get(RESIMULATION, np.nan),
        most_times=MOST_TIMES,
        label=metric_of(CONTROL).label,
        sites=networks["site"].nunique(),
        few_sites=FEW_SITES,
        short=[f"{variant}/seed{seed} ({n} of {most})" for (_, variant, seed), n, most in runs if n < most],
        gaps=_gaps(everything),
        metrics_of_the_package=METRICS,
    )
    return [" ".join(paragraph.split()) for paragraph in text.split("\n\n") if paragraph.strip()]


def caption(
    figure: str, metrics: Sequence[str] = (), reference: str = REFERENCE, resimulated: bool = True, **shown: object
) -> str:
    """Caption of a figure, by the name of its file without a number; `shown` is what else stands in `captions.jinja`.

    Without `resimulated` it says nothing of the re-simulation, which pairs that were made elsewhere may lack.
    """
    labels = ", ".join(metric_of(metric).label for metric in metrics)
    shown |= {"note": resimulation_note(list(metrics)) if resimulated else "", "resimulated": resimulated}
    template = _TEMPLATES.get_template("captions.jinja")
    return " ".join(template.render(shown, figure=figure, labels=labels, reference=reference).split())


def _gaps(per_image: pd.DataFrame) -> list[tuple[str, str, int, list[str]]]:
    """Values that are not finite: the metric, their kind, how many there are, and their runs and frames.

    A value is missing where another run has one of the frame: where none has, the frame offers nothing to measure.
    """
    gaps, whole = [], every_frame(per_image)
    for metric in ordered_metrics(list(per_image["metric"])):
        rows = whole[whole["metric"] == metric]
        value, stored = rows["value"], rows["stored"] == "both"
        elsewhere = stored.groupby([rows["data"], rows["frame"]]).transform("any")
        kinds = {"infinite value": np.isinf(value), "NaN": value.isna() & stored, "missing value": elsewhere & ~stored}
        for kind, left_out in ((kind, rows[chosen]) for kind, chosen in kinds.items()):
            if len(left_out):
                of_runs = left_out["frame"].astype(str).groupby([left_out["variant"], left_out["seed"]], sort=False)
                where = [f"{v}/seed{s} frame {', '.join(f.iloc[:3])}{' ...' * (len(f) > 3)}" for (v, s), f in of_runs]
                gaps.append((metric, kind, len(left_out), where))
    return gaps


def _compared(per_image: pd.DataFrame) -> str:
    """One sentence on what the numbers are over."""
    networks = per_image[per_image["variant"] != RESIMULATION]
    variants, seeds = networks["variant"].nunique(), networks.groupby("variant")["seed"].nunique()
    each = "" if seeds.empty else f", {seeds.min()}" + (f" to {seeds.max()}" if seeds.max() > seeds.min() else "")
    frames, sites = per_image["frame"].nunique(), per_image["site"].nunique()
    return f"{variants} variants{each} trained of each, {frames} test frames of {sites} probe sites."


def write_report(
    path: Path,
    title: str,
    per_image: pd.DataFrame,
    table: pd.DataFrame,
    paired: pd.DataFrame,
    claims: pd.DataFrame | None = None,
    figures: Sequence[tuple[Path, str]] = (),
    left_out: Sequence[str] = (),
    provenance: Mapping[str, object] | None = None,
    reference: str = REFERENCE,
    notes: Sequence[str] = (),
    verdicts: pd.DataFrame | None = None,
    components: Sequence[Component] = (),
    blocks: pd.DataFrame | None = None,
) -> Path:
    """Write the report to `path`; it needs no other file and no network.

    `title` is its heading, usually the study's name. `per_image` and `blocks` are as for `cautions`; the other tables
    are what `comparison_table`, `paired_table`, `seed_claims` and `verdict_table` give. `components` are those of the
    verdicts, for their labels.

    `figures` are PNG files and their captions, in order, and are inlined. That of the verdicts, `verdicts.png`, comes
    first. `left_out` says what the simulator or the networks did not compute, and why; `notes` say what else a reader
    must know before the numbers: runs left aside, images that are missing. `provenance` (commit, data hash, hardware
    and the like) is shown as a list.
    """
    variants, metrics, cells = cell_texts(table)
    unfolded = [metric for metric in metrics if metric in shown_in(Shown.report)]
    shown: dict[str, list[tuple[str, str]]] = {"answer": [], "figure": [], "folded": []}
    for file, caption in figures:  # folded are box plots of one metric, and chi-square maps of all frames but the first
        folded = file.stem.startswith(("boxplot_", "pchi2_maps_")) and file.stem != "pchi2_maps_0"
        place = "answer" if file.stem == "verdicts" else "folded" if folded else "figure"
        shown[place].append((base64.b64encode(file.read_bytes()).decode("ascii"), caption))
    text = _TEMPLATES.get_template("report.html.jinja").render(
        title=title,
        compared=_compared(per_image),
        warnings=[*notes, *cautions(per_image, reference, blocks)],
        variants=[{"variant": variant} for variant in variants],
        metrics=metrics,
        unfolded=unfolded,
        cells=cells,
        resimulation_note=resimulation_note(unfolded) if RESIMULATION in variants else "",
        reference=reference,
        paired=paired.to_dict("records"),
        claims=None if claims is None or claims.empty else claims[claims["p"].notna()].to_dict("records"),
        fewest_seeds=FEWEST_SEEDS,
        answers=shown["answer"],
        verdicts=[] if verdicts is None else verdicts[verdicts["effect"].notna()].to_dict("records"),
        labels={component.name: component.label for component in components},
        figures=shown["figure"],
        more_figures=shown["folded"],
        left_out=left_out,
        provenance=provenance,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, text.lstrip() + "\n")
    return path
