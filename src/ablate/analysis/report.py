"""One self-contained HTML page: table, statistics, figures, and what may not be concluded from them."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np
import pandas as pd

from ablate.analysis.cautions import cautions
from ablate.analysis.component_claims import FEWEST_SEEDS, Verdict
from ablate.analysis.metric_facts import REFERENCE, RESIMULATION, facts_of
from ablate.analysis.table_formats import resimulation_note, to_html

# What a reader sees at once; every other metric is folded away.
MAIN = ("psnr", "mae", "pchi2", "fd_speckle", "fid", "shadow_contrast", "ms_per_frame", "parameters")

CSS = """
body{font:14px/1.5 system-ui,sans-serif;max-width:76rem;margin:2rem auto;padding:0 1rem;color:#111;background:#fff}
table{border-collapse:collapse;margin:1rem 0;font-variant-numeric:tabular-nums;display:block;overflow-x:auto}
th,td{padding:.2rem .6rem;text-align:right;border-bottom:1px solid #ddd;white-space:nowrap;vertical-align:bottom}
th:first-child{text-align:left}thead th{border-bottom:2px solid #111;white-space:normal}
tr.resimulation{background:#eee;font-style:italic}
table.facts td{text-align:left;white-space:normal;overflow-wrap:anywhere}
figure{margin:1.5rem 0}img{max-width:100%}figcaption,small{color:#555}
details{margin:.5rem 0}summary{cursor:pointer;color:#0072b2}
pre{background:#f4f4f4;padding:.5rem;overflow:auto;max-height:40rem;font-size:12px}
.warning{border-left:4px solid #d55e00;background:#fff4ee;padding:.5rem 1rem;margin:.5rem 0}
"""


def _rounded(value: object, decimals: int) -> str:
    if isinstance(value, float):
        return "–" if np.isnan(value) else f"{value:.{decimals}f}"
    return escape(str(value)) if value is not None else "–"


def _paired_html(paired: pd.DataFrame) -> str:
    rows = []
    for row in paired.to_dict("records"):
        decimals = facts_of(row["metric"]).decimals + 1
        excludes = row["low"] > 0 or row["high"] < 0
        interval = f"[{_rounded(row['low'], decimals)}, {_rounded(row['high'], decimals)}]"
        cells = (
            escape(facts_of(row["metric"]).title),
            f"{row['shift']:+.{decimals}f}",
            f"<b>{interval}</b>" if excludes else interval,
            f"{row['p_sites_holm']:.2g}",
            f"{row['p_holm']:.2g}",
            f"{row['effect']:+.2f}",
            f"{row['sites']} / {row['n']}",
        )
        style = ' class="resimulation"' if row["variant"] == RESIMULATION else ""
        tail = "".join(f"<td>{c}</td>" for c in cells)
        rows.append(f"<tr{style}><th>{escape(row['variant'])}</th>{tail}</tr>")
    heads = ("metric", "shift", "95 % interval", "p, sites", "p, frames", "effect", "sites / frames")
    head = "".join(f"<th>{c}</th>" for c in heads)
    return f"<table><thead><tr><th>variant</th>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"


def _claims_html(claims: pd.DataFrame) -> str:
    rows = []
    for row in claims.to_dict("records"):
        decimals = facts_of(row["metric"]).decimals + 1
        p = "–" if pd.isna(row["p"]) else f"{row['p']:.2g}"
        shift, low, high = (_rounded(row[k], decimals) for k in ("shift", "low", "high"))
        cells = (escape(facts_of(row["metric"]).title), str(row["verdict"]), shift, f"[{low}, {high}]", p)
        tail = "".join(f"<td>{c}</td>" for c in (*cells, row["seeds"]))
        rows.append(f"<tr><th>{escape(row['variant'])}</th>{tail}</tr>")
    head = "".join(f"<th>{c}</th>" for c in ("metric", "verdict", "shift", "95 % interval", "p", "seeds"))
    return f"<table><thead><tr><th>variant</th>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"


def _folded(title: str, content: str) -> str:
    return f"<details><summary>{escape(title)}</summary>{content}</details>" if content else ""


def _is_lesser(stem: str) -> bool:
    """Whether a figure is folded: box plots of one metric, chi-square maps of all frames but the first."""
    return stem.startswith("boxplot_") or (stem.startswith("pchi2_maps_") and stem != "pchi2_maps_0")


def _figure_html(path: Path, caption: str) -> str:
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    image = f'<img alt="{escape(caption, quote=True)}" src="data:image/png;base64,{data}">'
    return f"<figure>{image}<figcaption>{escape(caption)}</figcaption></figure>"


def _figures_html(figures: Sequence[tuple[Path, str]]) -> str:
    lesser = [figure for figure in figures if _is_lesser(figure[0].stem)]
    shown = "".join(_figure_html(*figure) for figure in figures if figure not in lesser)
    return shown + _folded("More figures", "".join(_figure_html(*figure) for figure in lesser))


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
) -> Path:
    """Write the report; it needs no other file and no network.

    Parameters
    ----------
    path : Path
        HTML file to write.
    title : str
        Heading, usually the study's name.
    per_image : DataFrame
        Columns variant, seed, frame, site, metric, value.
    table, paired, claims : DataFrame
        What `comparison_table`, `paired_table` and `seed_claims` give.
    figures : sequence of (Path, str)
        PNG files and their captions, in order; they are inlined.
    left_out : sequence of str
        What the simulator or the networks did not compute, and why.
    provenance : mapping, optional
        Commit, data hash, hardware and the like, shown as a list.
    reference : str
    appendix : mapping of str to str, optional
        Longer texts by title, folded at the end: packages, uncommitted changes.
    notes : sequence of str
        What else a reader must know before the numbers: runs left aside, pictures that are missing.

    Returns
    -------
    Path
        The file written.
    """
    warnings = "".join(f'<p class="warning">{escape(text)}</p>' for text in (*notes, *cautions(per_image, reference)))
    main, rest = table["metric"].isin(MAIN), ~table["metric"].isin(MAIN)
    metrics = list(dict.fromkeys(table[main]["metric"]))
    parts = [
        f"<h1>{escape(title)}</h1><p>{_compared(per_image)}</p>{warnings}",
        f"<h2>Comparison</h2>{to_html(table[main])}",
        _folded("All other metrics", to_html(table[rest]) if rest.any() else ""),
        "<p><small>Mean ± standard deviation over frames (over seeds for figures that a run has one of). "
        f"Bold is the best network. {escape(resimulation_note(metrics))}</small></p>",
    ]
    if len(paired):
        parts.append(
            f"<h2>Paired differences to {escape(reference)}</h2>"
            "<p>Do these trained networks differ? Median shift (Hodges-Lehmann), interval from resampled probe sites "
            "(bold where it excludes 0), Wilcoxon over the sites' means (of probe sites like these) and over frames "
            "(of these frames only), both with Holm's correction, rank-biserial effect over frames.</p>"
            f"{_paired_html(paired[paired['metric'].isin(MAIN)])}"
        )
        rest = ~paired["metric"].isin(MAIN)
        parts.append(_folded("All other metrics", _paired_html(paired[rest]) if rest.any() else ""))
    if claims is not None and len(claims):
        claimable = claims[claims["verdict"] != Verdict.not_claimable]
        said = (
            "; <i>differs</i> survives Holm's correction over all rows, <i>suggested</i> holds for its row alone.</p>"
            f"{_claims_html(claimable)}"
        )
        if not len(claimable):
            said = f": not claimable here, it takes at least {FEWEST_SEEDS} seeds (<code>seed=0,1,2</code>).</p>"
        parts.append(f"<h2>Does the component matter?</h2><p>Judged on one mean a seed (Welch), not on frames{said}")
    if figures:
        parts.append(f"<h2>Figures</h2>{_figures_html(figures)}")
    if left_out:
        parts.append("<h2>Left out</h2><ul>" + "".join(f"<li>{escape(x)}</li>" for x in left_out) + "</ul>")
    if provenance:
        rows = "".join(f"<tr><th>{escape(str(k))}</th><td>{escape(str(v))}</td></tr>" for k, v in provenance.items())
        parts.append(f'<h2>Provenance</h2><table class="facts">{rows}</table>')
    parts += [_folded(name, f"<pre>{escape(text)}</pre>") for name, text in (appendix or {}).items()]
    head = f'<meta charset="utf-8"><title>{escape(title)}</title><style>{CSS}</style>'
    path.parent.mkdir(parents=True, exist_ok=True)
    body = "\n".join(parts)
    path.write_text(f'<!doctype html>\n<html lang="en"><head>{head}</head><body>{body}</body></html>\n', "utf-8")
    return path
