"""Paired statistics, effects, tables, figures and the report; from data frames to files."""

from ablate.analysis.boxplots import boxplot_panels, paired_boxplots
from ablate.analysis.captions import (
    boxplot_caption,
    chi2_caption,
    effects_caption,
    qualitative_caption,
    runtime_caption,
    seeds_caption,
)
from ablate.analysis.cautions import cautions, listed
from ablate.analysis.component_claims import ComponentClaim, Verdict, component_claim, seed_claims
from ablate.analysis.designs import Design, effects_table, find_design
from ablate.analysis.effects import factorial_effects
from ablate.analysis.effects_figure import effects_plot
from ablate.analysis.image_figures import FramePictures, chi2_maps_figure, frames_a_page, qualitative_figure
from ablate.analysis.latex_table import to_latex
from ablate.analysis.metric_facts import METRICS, REFERENCE, RESIMULATION, badness, facts_of
from ablate.analysis.order import ordered_metrics, ordered_variants
from ablate.analysis.paired_differences import paired_table
from ablate.analysis.precision_figures import order_figure, work_precision_figure
from ablate.analysis.preview_figure import Preview, preview_figure
from ablate.analysis.report import write_report
from ablate.analysis.runtime_figure import error_vs_runtime, pareto_front
from ablate.analysis.seeds_figure import seed_plot
from ablate.analysis.statistics import PairedDifference, holm, paired_difference
from ablate.analysis.table_formats import Spread, resimulation_note, to_html, to_markdown, to_text, wide_table
from ablate.analysis.tables import comparison_table
from ablate.analysis.work_precision import budget_table, observed_order

__all__ = [
    "METRICS",
    "REFERENCE",
    "RESIMULATION",
    "ComponentClaim",
    "Design",
    "FramePictures",
    "PairedDifference",
    "Preview",
    "Spread",
    "Verdict",
    "badness",
    "boxplot_caption",
    "boxplot_panels",
    "budget_table",
    "cautions",
    "chi2_caption",
    "chi2_maps_figure",
    "comparison_table",
    "component_claim",
    "effects_caption",
    "effects_plot",
    "effects_table",
    "error_vs_runtime",
    "factorial_effects",
    "facts_of",
    "find_design",
    "frames_a_page",
    "holm",
    "listed",
    "observed_order",
    "order_figure",
    "ordered_metrics",
    "ordered_variants",
    "paired_boxplots",
    "paired_difference",
    "paired_table",
    "pareto_front",
    "preview_figure",
    "qualitative_caption",
    "qualitative_figure",
    "resimulation_note",
    "runtime_caption",
    "seed_claims",
    "seed_plot",
    "seeds_caption",
    "to_html",
    "to_latex",
    "to_markdown",
    "to_text",
    "wide_table",
    "work_precision_figure",
    "write_report",
]
