"""What docs/results.md says of the kept studies: tables, tests and figures in Markdown; scripts/results.py calls it."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
from PIL import Image

from ablate.analysis import (
    REFERENCE,
    RESIMULATION,
    Design,
    FramePictures,
    Spread,
    boxplot_caption,
    boxplot_panels,
    cautions,
    comparison_table,
    effects_caption,
    effects_plot,
    effects_table,
    find_design,
    ordered_variants,
    paired_table,
    qualitative_caption,
    qualitative_figure,
    resimulation_note,
    seed_claims,
    seed_plot,
    seeds_caption,
    to_markdown,
)
from ablate.metrics import METRICS, Group, Shown, metric_of, shown_in
from ablate.studies.comparison.answers import FACTORS, components_of
from ablate.studies.comparison.results import Finished, scored_frames
from ablate.studies.comparison.usable_runs import usable_runs

BEGIN, END = "<!-- written by scripts/results.py: begin -->", "<!-- written by scripts/results.py: end -->"
HEADLINE, PANELS = shown_in(Shown.headline), shown_in(Shown.panels)
TABLE_II = [*shown_in(Shown.table), "ms_per_frame"]
MECHANISM = [name for name, metric in METRICS.items() if metric.group is Group.mechanism]
FIGURE_4 = [name for name in HEADLINE if METRICS[name].of_image]
FRAME, PICTURES = "frame.npz", "pictures.npz"


def kept_frame(study: Path, runs: Sequence[Finished]) -> list[FramePictures]:
    """The kept frame with what every variant made of it; empty when it was not kept.

    Parameters
    ----------
    study : Path
        Folder of a kept study.
    runs : sequence of Finished

    Returns
    -------
    list of FramePictures
        One or none.
    """
    if not (study / FRAME).exists():
        return []
    with np.load(study / FRAME) as file:
        maps = dict(file)
    number = int(maps["number"])
    predictions = {RESIMULATION: maps["resimulation"]} if "resimulation" in maps else {}
    order = ordered_variants([run.label for run in runs])
    for run in sorted(runs, key=lambda run: order.index(run.label)):
        if (run.folder / PICTURES).exists():
            with np.load(run.folder / PICTURES) as file:
                if number in file["frames"]:
                    predictions[run.label] = file["images"][file["frames"].tolist().index(number)]
    return [
        FramePictures(
            f"frame {number}", maps["target"], predictions, maps["mask"], maps["segmentation"], maps.get("attenuation")
        )
    ]


def study_lines(study: Path) -> Iterator[str]:
    """Tables and figures of a kept study, paragraph by paragraph; figures are written into its folder."""
    usable = usable_runs(study)
    per_image, scalars = scored_frames(usable.runs)
    table = comparison_table(per_image, scalars)
    networks = per_image[per_image["variant"] != RESIMULATION]
    yield f"## {study.name}"
    yield (
        f"{len(usable.runs)} runs, {networks['frame'].nunique()} test frames of {networks['site'].nunique()} unseen "
        f"probe sites, data set `{usable.runs[0].result['data']}`."
    )
    yield "\n".join(f"- {note}" for note in (*usable.notes, *cautions(per_image)))
    shown = table[table["metric"].isin(TABLE_II)]
    yield f"Mean ± standard deviation over test frames. The best network is bold.\n\n{to_markdown(shown)}"
    spread = table[table["metric"].isin((*HEADLINE, *MECHANISM))]
    yield (
        "Mean ± standard deviation over the means of the seeds, with the mechanism metrics.\n\n"
        f"{to_markdown(spread, Spread.seeds)}"
    )
    yield resimulation_note(list(dict.fromkeys([*shown["metric"], *spread["metric"]])))
    for reference, labels in families(list(dict.fromkeys(per_image["variant"]))).items():
        where = "" if reference == REFERENCE else f", compared with {reference}"
        of, sets = (rows[rows["variant"].isin(labels)] for rows in (per_image, scalars))
        claims, paired = seed_claims(of, sets, reference), paired_table(of, reference)
        yield f"### Do the components matter{where}?\n\n{claims_text(claims, reference)}"
        yield f"### Do the trained networks differ{where}?\n\n{paired_text(paired, reference)}"
    design = find_design({run.label: components_of(run) for run in usable.runs}, FACTORS)
    for path, caption in figures(study, usable.runs, design):
        yield f"![{path.stem}]({study.parent.name}/{study.name}/{path.name})\n\n*{caption}*"


def families(labels: Sequence[str]) -> dict[str, list[str]]:
    """What is compared with what: all with sa2h, and what shares a change with it, as sa2h.encoding-arbitrary."""
    found = {REFERENCE: list(labels)}
    for label in labels:
        name, dot, change = label.partition(".")
        alike = [other for other in labels if other.endswith(dot + change)]
        if name == REFERENCE and dot and len(alike) > 1:
            found[label] = alike
    return found


def grid_text(rows: pd.DataFrame, cell: Callable[[str, dict[str, Any]], str]) -> str:
    """A row a variant and a column a metric, in Markdown."""
    metrics = list(dict.fromkeys(rows["metric"]))
    lines = [["variant", *(metric_of(m).title for m in metrics)], ["---", *["---:"] * len(metrics)]]
    for variant, of in rows.groupby("variant", sort=False):
        cells = of.set_index("metric").to_dict("index")
        lines.append([str(variant), *(cell(m, cells[m]) if m in cells else "–" for m in metrics)])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def claims_text(claims: pd.DataFrame, reference: str = REFERENCE) -> str:
    """Whether components matter, judged on trainings."""
    claims = claims[claims["metric"].isin((*TABLE_II, *MECHANISM))]
    if claims["p"].isna().all():
        return "Not claimable: this needs the reference and three seeds per network."

    def cell(metric: str, claim: dict[str, Any]) -> str:
        if pd.isna(claim["p"]):
            return str(claim["verdict"])
        text = f"{claim['shift']:+.{metric_of(metric).decimals}f}"
        return {"differs": f"**{text}**", "suggested": f"*{text}*"}.get(str(claim["verdict"]), text)

    return (
        f"Difference from {reference} between the means over the seeds (Welch's test). **Bold**: p is below 5 % after "
        "Holm's correction over all rows and metrics. *Italic*: suggested, p is below 5 % only before it.\n\n"
        f"{grid_text(claims, cell)}"
    )


def paired_text(paired: pd.DataFrame, reference: str = REFERENCE) -> str:
    """How the trained networks differ on the same frames."""
    paired = paired[paired["metric"].isin((*FIGURE_4, *MECHANISM))]
    if paired.empty:
        return "There is no pair of networks to compare."

    def cell(metric: str, row: dict[str, Any]) -> str:
        shift, lower, upper = (f"{row[k]:+.{metric_of(metric).decimals}f}" for k in ("shift", "lower", "upper"))
        return f"{f'**{shift}**' if row['p_sites_holm'] < 0.05 else shift} [{lower}, {upper}]"

    return (
        f"Median shift relative to {reference} on the same frames, with its 95 % interval over probe sites. **Bold**: "
        "Wilcoxon's test over the means of the sites gives p below 5 % after Holm's correction over all rows and "
        "metrics.\n\n"
        f"{grid_text(paired, cell)}"
    )


def figures(study: Path, runs: Sequence[Finished], effects_of: Design | None) -> list[tuple[Path, str]]:
    """The figures of a kept study as PNG, each with its caption; PDF is for `task=compare`."""
    per_image, scalars = scored_frames(runs)
    made: list[tuple[list[Path], str]] = []
    with TemporaryDirectory() as folder:
        drawn = Path(folder)
        if frames := kept_frame(study, runs):
            made.append((qualitative_figure(frames, drawn / "qualitative"), qualitative_caption()))
        boxes = boxplot_panels(per_image, FIGURE_4, drawn / "boxplots", paired=paired_table(per_image))
        made.append((boxes, boxplot_caption(FIGURE_4)))
        made.append((seed_plot(per_image, scalars, PANELS, drawn / "seeds"), seeds_caption(PANELS)))
        if effects_of is not None and len(effects := effects_table(per_image, effects_of, scalars)):
            made.append((effects_plot(effects, PANELS, drawn / "effects"), effects_caption(effects_of, effects)))
        kept = []
        for paths, caption in made:
            for path in paths:
                if path.suffix == ".png":
                    kept.append((study / path.name, caption))
                    with Image.open(path) as image:  # 256 colours: a third of the size
                        image.convert("RGB").quantize(256).save(study / path.name, optimize=True)
    return kept


def write_page(kept: Path, page: Path) -> None:
    """Write what stands between the markers of the page; a page without them is begun.

    Parameters
    ----------
    kept : Path
        Folder of kept studies.
    page : Path

    Raises
    ------
    ValueError
        When nothing is kept.
    """
    studies = sorted({path.parents[2] for path in kept.glob("*/*/seed*/result.json")})
    if not studies:
        raise ValueError(f"{kept} holds no study; `python scripts/results.py keep runs/laptop-fetal` copies one")
    text = page.read_text() if page.exists() else f"# Results\n\n{BEGIN}\n{END}\n"
    before, _, rest = text.partition(BEGIN)
    _, found, after = rest.partition(END)
    if not found:
        raise ValueError(f"{page} lacks the markers {BEGIN} and {END}")
    paragraphs = [line for study in studies for line in study_lines(study) if line]
    page.write_text(before + BEGIN + "\n\n" + "\n\n".join(paragraphs) + "\n\n" + END + after)
