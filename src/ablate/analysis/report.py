"""What may not be concluded from a study, and its report: one self-contained page of tables, statistics and figures."""

import base64
from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from ablate.analysis.components import Component
from ablate.analysis.scored import REFERENCE, RESIMULATION, ordered_metrics, ordered_variants
from ablate.analysis.statistics.component_claims import FEWEST_SEEDS, Verdict
from ablate.analysis.statistics.verdicts import Answer
from ablate.analysis.tables import cell_texts, head, resimulation_note
from ablate.metrics import METRICS, Shown, metric_of, shown_in
from ablate.storage import write_text

FEW_SITES = 10  # below, intervals over sites are rough
FEWEST_SITES = 6  # below, a signed-rank test over sites cannot reach 5 %
MOST_NAMED = 6  # of a list; the rest are counted
_TEMPLATES = Environment(
    loader=FileSystemLoader(Path(__file__).parent),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_TEMPLATES.globals["resimulation"] = RESIMULATION


def cautions(per_image: pd.DataFrame, reference: str = REFERENCE) -> list[str]:
    """Return what a reader must not conclude from a study, one sentence each; `per_image` as for `comparison_table`."""
    networks = per_image[per_image["variant"] != RESIMULATION]
    variants = ordered_variants(list(networks["variant"]), reference)
    seeds = networks.groupby("variant")["seed"].nunique()
    texts = []
    if not variants:
        texts.append("There is no network in this study.")
    elif reference not in variants:
        texts.append(
            f"The reference {reference} is missing, so there are no paired differences (reference=... names another)."
        )
    elif len(variants) == 1:
        texts.append(f"There is one variant, {variants[0]}: nothing is compared.")
    if few := [f"{v} ({seeds[v]})" for v in variants if seeds[v] < FEWEST_SEEDS]:
        texts.append(
            f"Fewer than {FEWEST_SEEDS} seeds for {listed(few)}: from these alone it is not claimable that a variant "
            "is better or worse; the paired differences are between these trained networks only. Verdicts about "
            "components count all runs of a design."
        )
    if RESIMULATION not in set(per_image["variant"]):
        texts.append("The re-simulation is missing, so floors and levels are unknown.")
    return [*texts, *_about_frames(networks), *_about_values(per_image)]


def caption(figure: str, metrics: Sequence[str] = (), reference: str = REFERENCE, **shown: object) -> str:
    """Caption of a figure, by the name of its file without a number; `shown` is what else stands in `captions.jinja`.

    Examples
    --------
    >>> from ablate.analysis import caption
    >>> caption("seeds", ["psnr"])[:42]
    'Scores of all trainings. A ring is the mea'
    """
    labels, note = ", ".join(metric_of(metric).label for metric in metrics), resimulation_note(list(metrics))
    template = _TEMPLATES.get_template("captions.jinja")
    return " ".join(template.render(shown, figure=figure, labels=labels, note=note, reference=reference).split())


def listed(names: list[str]) -> str:
    """Names in a sentence, the rest counted where there are many."""
    more = len(names) - MOST_NAMED
    return ", ".join(names) if more <= 0 else f"{', '.join(names[:MOST_NAMED])} and {more} more"


def _about_frames(networks: pd.DataFrame) -> list[str]:
    texts = []
    sites = networks["site"].nunique()
    if 0 < sites < FEW_SITES:
        text = f"Only {sites} probe site{'' if sites == 1 else 's'}: intervals over sites are rough"
        if sites < FEWEST_SITES:
            text += f", and a test over fewer than {FEWEST_SITES} sites can show nothing"
        texts.append(f"{text}.")
    sites_of = networks.groupby("frame")["site"].nunique()
    if moved := [str(frame) for frame in sites_of.index[sites_of > 1]]:
        texts.append(f"Runs name different probe sites for frame {listed(moved)}: intervals over sites mean nothing.")
    frames = networks.groupby(["variant", "seed"])["frame"].nunique()
    runs = zip(frames.index, frames, strict=True)
    if short := [f"{variant}/seed{seed} ({n})" for (variant, seed), n in runs if n < frames.max()]:
        texts.append(
            f"Not all runs have all {frames.max()} test frames: {listed(short)}; pairs are of frames that both have."
        )
    return texts


def _about_values(per_image: pd.DataFrame) -> list[str]:
    texts = []
    for metric in ordered_metrics(list(per_image["metric"])):
        rows = per_image[per_image["metric"] == metric]
        why = "identical images: " if metric in METRICS else ""  # of the package's, PSNR alone is ever infinite
        for kind, left_out in (("infinite value", rows[np.isinf(rows["value"])]), ("NaN", rows[rows["value"].isna()])):
            if len(left_out):
                of_runs = left_out["frame"].astype(str).groupby([left_out["variant"], left_out["seed"]], sort=False)
                where = [f"{v}/seed{s} frame {', '.join(f.iloc[:3])}{' ...' * (len(f) > 3)}" for (v, s), f in of_runs]
                text = f"{metric_of(metric).label}: {len(left_out)} {kind}{'s' * (len(left_out) > 1)} left out"
                texts.append(f"{text} ({why if kind != 'NaN' else ''}{listed(where)}).")
    return texts


#: Text, or text, spread and whether it is bold, as `cell_texts` gives them.
Cell = str | tuple[str, str, bool]


class Grid(NamedTuple):
    """A table as the templates take it: titles of the columns, and the cells of each row behind its variant."""

    heads: list[str]
    rows: list[tuple[str, list[Cell]]]


def _comparison(table: pd.DataFrame) -> Grid:
    variants, metrics, cells = cell_texts(table)
    return Grid([head(metric) for metric in metrics], [(v, [cells[v, m] for m in metrics]) for v in variants])


def _estimate(row: Mapping[Hashable, Any], name: str, sign: str = "+") -> tuple[str, str]:
    """An estimate and the ends of its interval, one decimal more than its metric has."""
    decimals = metric_of(row["metric"]).decimals + 1
    ends = "–" if pd.isna(row["lower"]) else f"[{row['lower']:.{decimals}f}, {row['upper']:.{decimals}f}]"
    return f"{row[name]:{sign}.{decimals}f}", ends


def _paired(paired: pd.DataFrame) -> Grid:
    rows = []
    for row in paired.to_dict("records"):
        shift, ends = _estimate(row, "shift")
        interval = ends, "", row["lower"] > 0 or row["upper"] < 0
        texts = (f"{row['p_sites_holm']:.2g}", f"{row['p_holm']:.2g}", f"{row['effect']:+.2f}")
        cells: list[Cell] = [metric_of(row["metric"]).title, shift, interval, *texts, f"{row['sites']} / {row['n']}"]
        rows.append((row["variant"], cells))
    return Grid(["metric", "shift", "95 % interval", "p, sites", "p, frames", "effect", "sites / frames"], rows)


def _claims(claims: pd.DataFrame) -> Grid:
    rows = []
    for row in claims[claims["verdict"] != Verdict.not_claimable].to_dict("records"):
        texts = str(row["verdict"]), *_estimate(row, "shift", ""), f"{row['p']:.2g}", str(row["seeds"])
        cells: list[Cell] = [metric_of(row["metric"]).title, *texts]
        rows.append((row["variant"], cells))
    return Grid(["metric", "verdict", "shift", "95 % interval", "p", "seeds"], rows)


def _verdicts(verdicts: pd.DataFrame, labels: Mapping[str, str]) -> Grid:
    rows = []
    for row in verdicts[verdicts["effect"].notna()].to_dict("records"):
        p = f"{row['p_holm']:.2g}" if pd.notna(row["lower"]) else "–"
        texts = (f"{row['band']:g}", f"{row['runs_a']} / {row['runs_b']}", p)
        verdict = str(row["verdict"]).replace("_", " "), "", True
        why = row["why"] if row["verdict"] == Answer.undecided else ""
        cells: list[Cell] = [metric_of(row["metric"]).title, *_estimate(row, "effect"), *texts, verdict, why]
        rows.append((labels.get(row["component"], row["component"]), cells))
    return Grid(["metric", "effect", "95 % interval", "band", "runs with / without", "p, Holm", "verdict", "why"], rows)


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
) -> Path:
    """Write the report to `path`; it needs no other file and no network.

    Parameters
    ----------
    title : str
        Heading, usually the study's name.
    per_image, table, paired, claims, verdicts : DataFrame
        As for `comparison_table`; and what that, `paired_table`, `seed_claims` and `verdict_table` give.
    figures : sequence of (Path, str)
        PNG files and their captions, in order; they are inlined. That of the verdicts, `verdicts.png`, comes first.
    left_out, notes : sequence of str
        What the simulator or the networks did not compute, and why; what else a reader must know before the numbers:
        runs left aside, images that are missing.
    provenance : mapping, optional
        Commit, data hash, hardware and the like, shown as a list.
    components : sequence of Component
        Those of `verdicts`, for their labels.
    """
    unfolded = shown_in(Shown.report)

    def parts(rows: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
        return rows[rows["metric"].isin(unfolded)], rows[~rows["metric"].isin(unfolded)]

    shown: dict[str, list[tuple[str, str]]] = {"answer": [], "figure": [], "folded": []}
    for file, caption in figures:  # folded are box plots of one metric, and chi-square maps of all frames but the first
        folded = file.stem.startswith(("boxplot_", "pchi2_maps_")) and file.stem != "pchi2_maps_0"
        place = "answer" if file.stem == "verdicts" else "folded" if folded else "figure"
        shown[place].append((base64.b64encode(file.read_bytes()).decode("ascii"), caption))
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
        answers=shown["answer"],
        verdicts=None if verdicts is None else _verdicts(verdicts, {c.name: c.label for c in components}),
        figures=shown["figure"],
        more_figures=shown["folded"],
        left_out=left_out,
        provenance=provenance,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, text.lstrip() + "\n")
    return path
