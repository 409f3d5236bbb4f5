"""Paired statistics, effects, tables, figures and the report; from data frames to files."""

from ablate.analysis.boxplots import paired_boxplots
from ablate.analysis.effects import factorial_effects
from ablate.analysis.image_figures import FramePictures, chi2_maps_figure, qualitative_figure
from ablate.analysis.metric_facts import METRICS, REFERENCE, RESIMULATION, facts_of
from ablate.analysis.preview_figure import Preview, preview_figure
from ablate.analysis.report import cautions, write_report
from ablate.analysis.runtime_figure import error_vs_runtime, pareto_front
from ablate.analysis.statistics import (
    ComponentClaim,
    PairedDifference,
    Verdict,
    component_claim,
    holm,
    paired_difference,
)
from ablate.analysis.table_formats import to_html, to_latex, to_text, wide_table
from ablate.analysis.tables import comparison_table, paired_table, seed_claims

__all__ = [
    "METRICS",
    "REFERENCE",
    "RESIMULATION",
    "ComponentClaim",
    "FramePictures",
    "PairedDifference",
    "Preview",
    "Verdict",
    "cautions",
    "chi2_maps_figure",
    "comparison_table",
    "component_claim",
    "error_vs_runtime",
    "factorial_effects",
    "facts_of",
    "holm",
    "paired_boxplots",
    "paired_difference",
    "paired_table",
    "pareto_front",
    "preview_figure",
    "qualitative_figure",
    "seed_claims",
    "to_html",
    "to_latex",
    "to_text",
    "wide_table",
    "write_report",
]
