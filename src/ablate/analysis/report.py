"""One self-contained HTML page: table, statistics, figures, and what may not be concluded from them."""

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from ablate.analysis.cautions import cautions
from ablate.analysis.components import Component, labels_of
from ablate.analysis.scored import REFERENCE, RESIMULATION
from ablate.analysis.statistics.component_claims import FEWEST_SEEDS, Verdict
from ablate.analysis.statistics.verdicts import Answer
from ablate.analysis.tables import cell_texts, head, resimulation_note
from ablate.metrics import Shown, metric_of, shown_in
from ablate.storage import write_text

_TEMPLATES = Environment(
    loader=FileSystemLoader(Path(__file__).parent),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_TEMPLATES.globals["resimulation"] = RESIMULATION


class Cell(NamedTuple):
    """A cell of a table."""

    text: str
    bold: bool = False
    spread: str = ""


class Grid(NamedTuple):
    """A table as the templates take it: titles of the columns, and the cells of each row behind its variant."""

    heads: list[str]
    rows: list[tuple[str, list[Cell]]]


def to_html(table: pd.DataFrame) -> str:
    """The table of `comparison_table` as an HTML element."""
    template = _TEMPLATES.from_string('{% from "grid.html.jinja" import grid %}{{ grid(table) }}')
    return template.render(table=_comparison(table))


def _comparison(table: pd.DataFrame) -> Grid:
    variants, metrics, cells = cell_texts(table)
    rows = []
    for variant in variants:
        texts = [cells[variant, metric] for metric in metrics]
        rows.append((variant, [Cell(mean, best, sd) for mean, sd, best in texts]))
    return Grid([head(metric) for metric in metrics], rows)


def _paired(paired: pd.DataFrame) -> Grid:
    rows = []
    for row in paired.to_dict("records"):
        decimals = metric_of(row["metric"]).decimals + 1
        cells = [
            Cell(metric_of(row["metric"]).title),
            Cell(f"{row['shift']:+.{decimals}f}"),
            Cell(f"[{row['lower']:.{decimals}f}, {row['upper']:.{decimals}f}]", row["lower"] > 0 or row["upper"] < 0),
            Cell(f"{row['p_sites_holm']:.2g}"),
            Cell(f"{row['p_holm']:.2g}"),
            Cell(f"{row['effect']:+.2f}"),
            Cell(f"{row['sites']} / {row['n']}"),
        ]
        rows.append((row["variant"], cells))
    return Grid(["metric", "shift", "95 % interval", "p, sites", "p, frames", "effect", "sites / frames"], rows)


def _claims(claims: pd.DataFrame) -> Grid:
    rows = []
    for row in claims[claims["verdict"] != Verdict.not_claimable].to_dict("records"):
        decimals = metric_of(row["metric"]).decimals + 1
        shift, lower, upper = (f"{row[name]:.{decimals}f}" for name in ("shift", "lower", "upper"))
        texts = (shift, f"[{lower}, {upper}]", f"{row['p']:.2g}", str(row["seeds"]))
        rows.append((row["variant"], [Cell(t) for t in (metric_of(row["metric"]).title, str(row["verdict"]), *texts)]))
    return Grid(["metric", "verdict", "shift", "95 % interval", "p", "seeds"], rows)


def _verdicts(verdicts: pd.DataFrame, labels: Mapping[str, str]) -> Grid:
    rows = []
    for row in verdicts[verdicts["effect"].notna()].to_dict("records"):
        metric, known = metric_of(row["metric"]), pd.notna(row["lower"])
        decimals = metric.decimals + 1
        lower, upper, p = row["lower"], row["upper"], row["p_holm"]
        cells = [
            Cell(metric.title),
            Cell(f"{row['effect']:+.{decimals}f}"),
            Cell(f"[{lower:.{decimals}f}, {upper:.{decimals}f}]" if known else "–"),
            Cell(f"{row['band']:g}"),
            Cell(f"{row['runs_a']} / {row['runs_b']}"),
            Cell(f"{p:.2g}" if known else "–"),
            Cell(f"{row['verdict']}".replace("_", " "), True),
            Cell(row["why"] if row["verdict"] == Answer.undecided else ""),
        ]
        rows.append((labels.get(row["component"], row["component"]), cells))
    return Grid(["metric", "effect", "95 % interval", "band", "runs with / without", "p, Holm", "verdict", "why"], rows)


def _is_lesser(stem: str) -> bool:
    """Whether a figure is folded: box plots of one metric, chi-square maps of all frames but the first."""
    return stem.startswith("boxplot_") or (stem.startswith("pchi2_maps_") and stem != "pchi2_maps_0")


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
    appendix: Mapping[str, str] | None = None,
    notes: Sequence[str] = (),
    verdicts: pd.DataFrame | None = None,
    components: Sequence[Component] = (),
) -> Path:
    """Write the report to `path`; it needs no other file and no network.

    Parameters
    ----------
    title : str
        Heading, usually the study's name.
    per_image : DataFrame
        Columns variant, seed, frame, site, metric, value.
    table, paired, claims, verdicts : DataFrame
        What `comparison_table`, `paired_table`, `seed_claims` and `verdict_table` give.
    figures : sequence of (Path, str)
        PNG files and their captions, in order; they are inlined. That of the verdicts, `verdicts.png`, comes first.
    left_out : sequence of str
        What the simulator or the networks did not compute, and why.
    provenance : mapping, optional
        Commit, data hash, hardware and the like, shown as a list.
    appendix : mapping of str to str, optional
        Longer texts by title, folded at the end: packages, uncommitted changes.
    notes : sequence of str
        What else a reader must know before the numbers: runs left aside, images that are missing.
    components : sequence of Component
        Those of `verdicts`, for their labels.
    """
    unfolded = shown_in(Shown.report)

    def parts(rows: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
        return rows[rows["metric"].isin(unfolded)], rows[~rows["metric"].isin(unfolded)]

    answered = [place for place, (file, _) in enumerate(figures) if file.stem == "verdicts"]
    inlined = [(base64.b64encode(file.read_bytes()).decode("ascii"), caption) for file, caption in figures]
    lesser = [_is_lesser(file.stem) for file, _ in figures]
    text = _TEMPLATES.get_template("report.html.jinja").render(
        title=title,
        compared=_compared(per_image),
        warnings=[*notes, *cautions(per_image, reference)],
        tables=[_comparison(part) for part in parts(table)],
        resimulation_note=resimulation_note(list(parts(table)[0]["metric"].unique())),
        reference=reference,
        paired=[_paired(part) for part in parts(paired)] if len(paired) else None,
        claims=None if claims is None or claims.empty else _claims(claims),
        fewest_seeds=FEWEST_SEEDS,
        answers=[inlined[place] for place in answered],
        verdicts=None if verdicts is None else _verdicts(verdicts, labels_of(components)),
        figures=[
            figure
            for k, (figure, folded) in enumerate(zip(inlined, lesser, strict=True))
            if not folded and k not in answered
        ],
        more_figures=[figure for figure, folded in zip(inlined, lesser, strict=True) if folded],
        left_out=left_out,
        provenance=provenance,
        appendix=appendix or {},
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, text.lstrip() + "\n")
    return path
