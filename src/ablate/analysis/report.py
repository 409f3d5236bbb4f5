"""The report of a study: one self-contained page of tables, statistics and figures."""

import base64
from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path

import pandas as pd

from ablate.analysis.caution_texts import cautions
from ablate.analysis.figures.study_figure import DrawnFigure, Section
from ablate.analysis.leaderboard import best_in_words
from ablate.analysis.results import StudyResults
from ablate.analysis.scale import scale_table
from ablate.analysis.scored import RESIMULATION, is_network
from ablate.analysis.statistics.component_claims import FEWEST_SEEDS
from ablate.analysis.tables import cell_texts, least_to_most, resimulation_note
from ablate.analysis.templates import filled
from ablate.metrics import Shown, metric_of, shown_in
from ablate.storage import write_text


def write_report(
    path: Path,
    results: StudyResults,
    title: str,
    figures: Sequence[DrawnFigure] = (),
    notes: Sequence[str] = (),
    left_out: Sequence[str] = (),
    provenance: Mapping[str, object] | None = None,
) -> Path:
    """Write the report of a study; it needs no other file and no network.

    Parameters
    ----------
    path : Path
        Of the HTML; its folder is made.
    results : StudyResults
        What the study came to.
    title : str
        Its heading, usually the study's name.
    figures : sequence of DrawnFigure
        From `draw_figures`; their PNG files are inlined.
    notes : sequence of str
        What a reader must know before the numbers, beside the cautions: runs left aside, images that are missing.
    left_out : sequence of str
        What the simulator or the networks did not compute, and why.
    provenance : mapping, optional
        Commit, data, hardware and the like, shown as a list.
    """
    variants, metrics, cells = cell_texts(results.table)
    unfolded = [metric for metric in metrics if metric in shown_in(Shown.report)]
    claims = results.claims
    verdicts = results.verdicts
    text = filled(
        "report.html.jinja",
        title=title,
        best=best_in_words(results.table, claims, results.reference),
        compared=_compared(results.per_image),
        warnings=[*notes, *cautions(results.per_image, results.reference, results.blocks)],
        variants=[{"variant": variant} for variant in variants],
        metrics=metrics,
        unfolded=unfolded,
        cells=cells,
        scale=_scale_rows(results, unfolded),
        resimulation_note=resimulation_note(unfolded) if RESIMULATION in variants else "",
        reference=results.reference,
        paired=results.paired.to_dict("records"),
        claims=None if claims.empty else claims[claims["p"].notna()].to_dict("records"),
        fewest_seeds=FEWEST_SEEDS,
        verdicts=verdicts[verdicts["effect"].notna()].to_dict("records"),
        labels={component.name: component.label for component in results.components},
        verdict_figures=_inlined(figures, Section.verdicts),
        figures=_inlined(figures, Section.figures),
        more_figures=_inlined(figures, Section.folded),
        left_out=left_out,
        provenance=provenance,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, text.lstrip() + "\n")
    return path


def _scale_rows(results: StudyResults, metrics: Sequence[str]) -> list[dict[Hashable, object]]:
    """Where each network stands between the formula and re-simulation, a row a metric."""
    scale = scale_table(results.table).round(2)
    shown = scale[[name for name in scale if name in metrics]]
    return (
        shown.rename(columns=lambda name: metric_of(name).label)
        .T.rename_axis("metric")
        .reset_index()
        .to_dict("records")
    )


def _inlined(figures: Sequence[DrawnFigure], section: Section) -> list[tuple[str, str]]:
    """The figures of a section, each as base64 and its caption."""
    return [
        (base64.b64encode(figure.path.read_bytes()).decode("ascii"), figure.caption)
        for figure in figures
        if figure.section is section
    ]


def _compared(per_image: pd.DataFrame) -> str:
    """One sentence on what the numbers are over."""
    networks = per_image[is_network(per_image["variant"])]
    seeds = networks.groupby("variant")["seed"].nunique()
    counts = f", {least_to_most(seeds)}" if len(seeds) else ""
    frames = per_image["frame"].nunique()
    sites = per_image["site"].nunique()
    return f"{len(seeds)} variants{counts} trained of each, {frames} test frames of {sites} probe sites."
