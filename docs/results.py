"""Results that are kept in the repository: small copies of finished runs, and the tables and figures made from them.

python docs/results.py keep runs/laptop-fetal    # copy what is finished into docs/results/laptop-fetal
python docs/results.py restore                   # put it back into runs/: the same sweep then goes on where it stopped
python docs/results.py table                     # write the tables of docs/results.md and its figures

A run is kept with its configuration, its scalars and its values a frame; not with its weights. Prose in docs/results.md
stays as it is: only what stands between the two markers is written.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd

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
    facts_of,
    find_design,
    paired_table,
    qualitative_caption,
    qualitative_figure,
    resimulation_note,
    seed_claims,
    seed_plot,
    seeds_caption,
    to_markdown,
)
from ablate.studies.compare import COMPONENTS, components_of
from ablate.studies.identity import write_json
from ablate.studies.results import Finished, pictures, scored_frames
from ablate.studies.usable_runs import usable_runs

DOCS = Path(__file__).resolve().parent
KEPT, PAGE = DOCS / "results", DOCS / "results.md"
BEGIN, END = "<!-- written by docs/results.py: begin -->", "<!-- written by docs/results.py: end -->"
TABLE_II = ("psnr", "mae", "pchi2", "fd_speckle", "fid", "ms_per_frame", "parameters")
MECHANISM = ("shadow_contrast", "mae_smooth", "nyquist_excess", "noise_sd", "pchi2_tissue")
FIGURE_4 = ("psnr", "mae", "pchi2")
PANELS = ("psnr", "mae", "pchi2", "fd_speckle", *MECHANISM[:4])
TESTED = ("psnr", "mae", "pchi2", *MECHANISM)
FRAME, VALUES, PICTURES = "frame.npz", "per_image.parquet", "pictures.npz"


def keep(study: Path, kept: Path = KEPT) -> list[str]:
    """Copy the finished runs of a study, small: what is kept already and has the same hash stays as it is.

    Parameters
    ----------
    study : Path
        As `runs/laptop-fetal`.
    kept : Path
        Folder of kept studies.

    Returns
    -------
    list of str
        A line a run copied, and a sentence for what was left aside.

    Raises
    ------
    ValueError
        When the study has no finished run, or a kept run has another configuration.
    """
    usable = usable_runs(study)
    if not usable.runs:
        raise ValueError(f"{study} holds no finished run; allowed is the folder of a study, as runs/laptop-fetal")
    target = kept / study.resolve().name
    said = list(usable.notes)
    for run in usable.runs:
        folder = target / run.label / f"seed{run.seed}"
        there = folder / "result.json"
        if there.exists():
            if json.loads(there.read_text())["hash"] != run.result["hash"]:
                raise ValueError(f"{folder} holds another configuration of {run.name}: remove it or keep it elsewhere")
            continue
        folder.mkdir(parents=True, exist_ok=True)
        own = {"runs_dir": "runs", "tracking": {**run.spec["settings"].get("tracking", {}), "uri": None}}
        write_json(folder / "spec.json", {**run.spec, "settings": {**run.spec["settings"], **own}})
        pack(run.folder / VALUES, folder / VALUES)
        if run.seed == 0 and (run.folder / PICTURES).exists():
            with np.load(run.folder / PICTURES) as shown:
                np.savez_compressed(folder / PICTURES, frames=shown["frames"][:1], images=shown["images"][:1])
        write_json(there, run.result)  # last: a run that has it is whole
        said.append(f"kept {run.name}")
    if not (target / FRAME).exists():
        said += keep_frame(usable.runs, target / FRAME)
    return said


def pack(source: Path, target: Path) -> None:
    """Copy per-image values: float32, the smallest integers, zstd.

    Parameters
    ----------
    source, target : Path
    """
    table = pd.read_parquet(source)
    for name in ("frame", "site", "seed"):
        table[name] = pd.to_numeric(table[name], downcast="integer")
    table.astype({"value": "float32"}).to_parquet(target, compression="zstd", compression_level=19, index=False)


def keep_frame(runs: Sequence[Finished], path: Path) -> list[str]:
    """Keep the target, the re-simulation and the maps of the first frame that all runs show, where pairs are on disk.

    Parameters
    ----------
    runs : sequence of Finished
    path : Path

    Returns
    -------
    list of str
        Why it is not kept; empty when it is.
    """
    try:
        frames = pictures(runs)
    except (OSError, ValueError, KeyError) as error:
        return [f"no picture of the target is kept: {' '.join(str(error).split())}"]
    if not frames:
        return ["no picture of the target is kept: the runs show no frame in common"]
    shown = frames[0]
    maps = {"target": shown.target, "mask": shown.mask, "segmentation": shown.segmentation}
    if shown.attenuation is not None:
        maps["attenuation"] = shown.attenuation.astype(np.float16)
    if RESIMULATION in shown.predictions:
        maps["again"] = shown.predictions[RESIMULATION]
    np.savez_compressed(path, number=int(shown.name.split()[-1]), **{k: v for k, v in maps.items() if v is not None})
    return []


def restore(kept: Path = KEPT, runs_dir: Path = Path("runs")) -> list[str]:
    """Put kept runs back where a sweep looks for them; a run that is there stays.

    Parameters
    ----------
    kept : Path
        Folder of kept studies.
    runs_dir : Path

    Returns
    -------
    list of str
        A line a run.
    """
    said = []
    for result in sorted(kept.glob("*/*/seed*/result.json")):
        name = result.parent.relative_to(kept)
        target = runs_dir / name
        if (target / "spec.json").exists():
            said.append(f"there already: {name}")
            continue
        target.mkdir(parents=True, exist_ok=True)
        for file in sorted(result.parent.iterdir(), key=lambda path: path.name == "result.json"):
            shutil.copyfile(file, target / file.name)
        said.append(f"restored {name}")
    return said


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
    predictions = {RESIMULATION: maps["again"]} if "again" in maps else {}
    for run in sorted(runs, key=lambda run: (run.label != REFERENCE, run.label)):
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
    table, paired = comparison_table(per_image, scalars), paired_table(per_image)
    networks = per_image[per_image["variant"] != RESIMULATION]
    yield f"## {study.name}"
    yield (
        f"{len(usable.runs)} runs, {networks['frame'].nunique()} test frames of {networks['site'].nunique()} unseen "
        f"probe sites, data set `{usable.runs[0].result['data']}`."
    )
    yield "\n".join(f"- {note}" for note in (*usable.notes, *cautions(per_image)))
    shown = table[table["metric"].isin(TABLE_II)]
    yield f"Mean ± standard deviation over test frames; the best network in bold.\n\n{to_markdown(shown)}"
    spread = table[table["metric"].isin((*TABLE_II[:4], *MECHANISM))]
    yield (
        "Mean ± standard deviation of the seeds' means, with the metrics that ask whether a component does what it is "
        f"for.\n\n{to_markdown(spread, Spread.seeds)}"
    )
    yield resimulation_note(list(dict.fromkeys([*shown["metric"], *spread["metric"]])))
    yield f"### Do the components matter?\n\n{claims_text(seed_claims(per_image, scalars))}"
    yield f"### Do the trained networks differ?\n\n{paired_text(paired)}"
    design = find_design({run.label: components_of(run) for run in usable.runs}, COMPONENTS)
    yield from (f"![{alt}]({path.relative_to(DOCS)})\n\n*{alt}*" for path, alt in figures(study, usable.runs, design))


def claims_text(claims: pd.DataFrame) -> str:
    """Verdicts in Markdown: a row a variant, a column a metric."""
    if claims.empty or claims["p"].isna().all():
        return "Not claimable: it takes the reference and three seeds a network."
    claims = claims[claims["metric"].isin((*TABLE_II, *MECHANISM))]
    metrics = list(dict.fromkeys(claims["metric"]))
    lines = [["variant", *(facts_of(m).title for m in metrics)], ["---", *["---:"] * len(metrics)]]
    for variant, of in claims.groupby("variant", sort=False):
        cells = of.set_index("metric").to_dict("index")
        lines.append([str(variant), *(claim_cell(m, cells[m]) if m in cells else "–" for m in metrics)])
    head = (
        "Difference of the seeds' means to sa2h (Welch), **bold** where it differs after Holm's correction over all "
        "rows, *italic* where it is suggested (differs when its row is taken alone)."
    )
    return f"{head}\n\n" + "\n".join(f"| {' | '.join(line)} |" for line in lines)


def claim_cell(metric: str, claim: dict[str, object]) -> str:
    """One cell of `claims_text`."""
    if claim["shift"] is None or pd.isna(claim["shift"]):
        return str(claim["verdict"])
    text = f"{claim['shift']:+.{facts_of(metric).decimals}f}"
    return {"differs": f"**{text}**", "suggested": f"*{text}*"}.get(str(claim["verdict"]), text)


def paired_text(paired: pd.DataFrame) -> str:
    """Median shifts with their intervals in Markdown: a row a variant, a column a metric."""
    paired = paired[paired["metric"].isin(TESTED)]
    if paired.empty:
        return "There is no pair of networks to compare."
    metrics = list(dict.fromkeys(paired["metric"]))
    lines = [["variant", *(facts_of(m).title for m in metrics)], ["---", *["---:"] * len(metrics)]]
    for variant, of in paired.groupby("variant", sort=False):
        cells = of.set_index("metric").to_dict("index")
        lines.append([str(variant), *(shift_cell(m, cells[m]) if m in cells else "–" for m in metrics)])
    head = (
        "Median shift to sa2h over the same frames with its 95 % interval over probe sites, **bold** where Wilcoxon's "
        "test over the sites' means stays below 5 % after Holm's correction over all rows and metrics."
    )
    return f"{head}\n\n" + "\n".join(f"| {' | '.join(line)} |" for line in lines)


def shift_cell(metric: str, row: dict[str, float]) -> str:
    """One cell of `paired_text`."""
    decimals = facts_of(metric).decimals
    shift = f"{row['shift']:+.{decimals}f}"
    shift = f"**{shift}**" if row["p_sites_holm"] < 0.05 else shift
    return f"{shift} [{row['low']:.{decimals}f}, {row['high']:.{decimals}f}]"


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
                    shutil.copyfile(path, kept[-1][0])
    return kept


def write_page(kept: Path = KEPT, page: Path = PAGE) -> None:
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
        raise ValueError(f"{kept} holds no study; `python docs/results.py keep runs/laptop-fetal` copies one")
    text = page.read_text() if page.exists() else f"# Results\n\n{BEGIN}\n{END}\n"
    before, _, rest = text.partition(BEGIN)
    _, found, after = rest.partition(END)
    if not found:
        raise ValueError(f"{page} lacks the markers {BEGIN} and {END}")
    paragraphs = [line for study in studies for line in study_lines(study) if line]
    page.write_text(before + BEGIN + "\n\n" + "\n\n".join(paragraphs) + "\n\n" + END + after)


def main() -> int:
    """Keep, restore or write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("keep").add_argument("study", type=Path)
    commands.add_parser("restore").add_argument("--runs", type=Path, default=Path("runs"))
    commands.add_parser("table")
    args = parser.parse_args()
    try:
        if args.command == "table":
            write_page()
        else:
            print("\n".join(keep(args.study) if args.command == "keep" else restore(runs_dir=args.runs)))
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
