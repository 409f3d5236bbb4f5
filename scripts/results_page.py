"""What docs/results.md says of the kept studies: verdicts, tables and figures; scripts/results.py calls it."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
from PIL import Image

from ablate.analysis import (
    REFERENCE,
    RESIMULATION,
    Design,
    FramePictures,
    Spread,
    caption,
    comparison_table,
    forest_figure,
    improvements,
    interactions,
    ordered_variants,
    qualitative_figure,
    resimulation_note,
    seed_claims,
    to_markdown,
)
from ablate.comparison.reading import Answers, answers, provenance, scored_frames
from ablate.comparison.usable_runs import UsableRuns, usable_runs
from ablate.jobs.compose import jobs_of
from ablate.metrics import METRICS, Group, Shown, shown_in
from ablate.networks import Noise
from ablate.runs.run import Run
from results_tables import claim_rows, effect_rows, interaction_rows, paper_rows, shortfalls, verdict_rows

BEGIN, END = "<!-- written by scripts/results.py: begin -->", "<!-- written by scripts/results.py: end -->"
FRAME, PICTURES = "frame.npz", "pictures.npz"
# By study, the file of conf/study that lists the runs of its design, and the one that lists those beside it.
PLANS = {"answer": ("answer", "answer_beside")}
BESIDE = [*shown_in(Shown.headline), *(name for name, m in METRICS.items() if m.group is Group.mechanism)]
JUDGED_AGAINST_BARS = (REFERENCE, "sa2h-compensated")


@dataclass(frozen=True, eq=False)
class Numbers:
    """A kept study, read once: its runs, and the tables of `ablate.analysis` that its page shows."""

    usable: UsableRuns
    per_image: pd.DataFrame  # as `scored_frames` gives it, of all anatomies
    beside: pd.DataFrame  # `comparison_table` of the named variants, on the anatomy of the reference
    claims: pd.DataFrame  # `seed_claims` of the same
    answers: Answers


def numbers_of(study: Path) -> Numbers:
    """Read a kept study. Raises ValueError where no run of it can be used."""
    usable = usable_runs(study)
    if not usable.runs:
        raise ValueError(" ".join([f"{study} holds no run that can be shown.", *usable.notes]))
    per_image, scalars = scored_frames(usable.all)
    here = str(usable.runs[0].result["data"])
    shown = {RESIMULATION, *(run.label for run in named(usable.runs))}
    of = [rows[(rows["data"] == here) & rows["variant"].isin(shown)] for rows in (per_image, scalars)]
    beside = comparison_table(*of)
    return Numbers(usable, per_image, beside, seed_claims(*of), answers(usable.all, beside))


def named(runs: Sequence[Run]) -> list[Run]:
    """The runs of variants that have a name of their own, as sa2h-gan; cells of a factorial have none."""
    return [run for run in runs if "." not in run.label]


@cache
def planned_runs(group: str) -> frozenset[str]:
    """Names of the runs of a file of conf/study."""
    return frozenset(job.name for job in jobs_of([f"+study={group}"]))


def finished_of(study: str, runs: Sequence[Run]) -> tuple[list[tuple[int, int]], str]:
    """How many runs of each part of a study's plan are finished, of how many, and a sentence that says so."""
    done = {run.name for run in runs}
    if study not in PLANS:
        return [], f"{len(done)} runs are finished."
    planned = [planned_runs(part) for part in PLANS[study]]
    counts = [(len(part & done), len(part)) for part in planned]
    (design, of_design), together = counts[0], frozenset.union(*planned)
    said = f"{len(together & done)} of {len(together)} runs are finished"
    return counts, said + (f": {design} of the {of_design} runs of the design." if design < of_design else ".")


def study_lines(study: Path) -> Iterator[str]:
    """The page of a kept study, paragraph by paragraph; figures and `verdicts.csv` are written into its folder."""
    found = numbers_of(study)
    runs, design = found.usable.all, found.answers.design
    counts, said = finished_of(study.name, runs)
    preliminary = bool(counts) and counts[0][0] < counts[0][1]
    yield f"## {study.name}"
    yield said + (" **All verdicts are preliminary.**" if preliminary else "")
    yield about(runs, found.per_image)
    found.answers.verdicts.to_csv(study / "verdicts.csv", index=False)
    drawn = {
        path.stem: f"![{path.stem}]({study.parent.name}/{study.name}/{path.name})" for path in figures(study, found)
    }
    if "verdicts" in drawn:
        yield f"{drawn['verdicts']}\n\n*{caption('verdicts', design=design)}*"
        yield from verdict_lines(study.name, found, preliminary)
    if "qualitative" in drawn:
        yield "### Pictures"
        yield (
            f"{drawn['qualitative']}\n\n*A test frame of an unseen probe site. The target has its segmentation in the "
            "left corner and the logarithm of its attenuation map in the right corner. Each network is the first "
            "training of its variant: sa2h-att has no attenuation map, sa2h-compensated the compensated one, sa2h-gan "
            "was trained without a discriminator. Re-simulation is the same frame with other scatterers and ray paths.*"
        )
    yield from beside_lines(found)
    if design is not None:
        yield from design_lines(found, design)


def about(runs: Sequence[Run], per_image: pd.DataFrame) -> str:
    """Size, data, code and machines of a study, in a paragraph."""
    s = runs[0].spec["settings"]
    rows, columns = s["simulator"]["image_shape"]
    tested = per_image[per_image["variant"] != RESIMULATION].groupby("data")
    sets = ", ".join(f"`{name}` ({of['frame'].nunique()} of {of['site'].nunique()} sites)" for name, of in tested)
    made = {run.name: provenance([run]) for run in runs}
    commits = Counter(of.get("git_commit", "")[:7] for of in made.values())
    machines = Counter(of.get("hardware", "") for of in made.values())
    said = [
        f"Frames of {rows} x {columns} pixels, networks of {s['model']['width']:g} times the paper's width, "
        f"{s['training']['steps']:,} training steps. Test frames: {sets}.",
        f"Commits: {', '.join(filter(None, commits))}." if any(commits) else "",
        f"Machines: {'; '.join(f'{name} ({n} runs)' for name, n in machines.items())}." if any(machines) else "",
        "Times a frame on different machines cannot be compared." if len(machines) > 1 else "",
    ]
    return " ".join(filter(None, said))


def verdict_lines(study: str, found: Numbers, preliminary: bool) -> Iterator[str]:
    """The verdicts as a table, and why where nothing can be said."""
    yield verdict_rows(found.answers.verdicts, preliminary)
    dof = found.answers.verdicts["dof"].max()
    yield (
        "An effect is the mean of the runs with a component minus the mean of those without it, averaged over all "
        "other components, or where all others are on. The arrow says which values are better. p (zero) tests "
        "the hypothesis that the effect is zero, and p (band) the hypothesis that the improvement is at least as large "
        "as the band. Both are corrected over the components (Holm). Times and weights are averaged in the same way; a "
        "difference in time within the spread of the timing is shown as 0. "
        f"{'' if pd.isna(dof) else f'The error has {dof} degrees of freedom. '}"
        f"[verdicts.csv](results/{study}/verdicts.csv) has all columns."
    )
    unknown = found.answers.verdicts[found.answers.verdicts["p_holm"].isna()]
    yield "\n".join(f"- {row['component']}: {row['why']}." for row in unknown.to_dict("records"))


def beside_lines(found: Numbers) -> Iterator[str]:
    """Named variants with re-simulation, the full model against its bars, and whether noise is alive."""
    shown = found.beside[found.beside["metric"].isin((*BESIDE, "ms_per_frame"))]
    yield "### The runs beside the design"
    yield (
        "Mean ± standard deviation of the trainings' means. The best network is bold.\n\n"
        f"{to_markdown(shown, Spread.seeds)}"
    )
    yield resimulation_note(list(dict.fromkeys(shown["metric"])))
    claims = found.claims[found.claims["metric"].isin(BESIDE)]
    if claims["p"].notna().any():
        yield claim_rows(claims)
        yield (
            f"Difference of the trainings' mean from {REFERENCE} (Welch's test). **Bold**: p is below 5 % after Holm's "
            "correction over all variants and metrics. *Italic*: suggested, p is below 5 % only without it."
        )
    if table := shortfalls(found.beside, JUDGED_AGAINST_BARS):
        yield "### How far from re-simulation"
        yield table
    rows = found.per_image[found.per_image["metric"] == "noise_sd"]
    injecting = {run.name for run in found.usable.all if run.spec["semantic"]["model"]["noise"] == Noise.inject}
    means = rows.groupby(["variant", "seed", "data"])["value"].mean().reset_index()
    levels = means[means["variant"] == RESIMULATION].set_index("data")["value"]
    means = means[(means["variant"] + "/seed" + means["seed"].astype(str)).isin(injecting)]
    if len(means) and set(means["data"]) <= set(levels.index):
        shares = means["value"] / means["data"].map(levels)
        yield (
            f"{len(means)} runs inject noise. Their standard deviation over draws (`noise_sd`) is "
            f"{means['value'].min():.1f} to {means['value'].max():.1f} grey levels, {shares.min():.2f} to "
            f"{shares.max():.2f} times that of re-simulation on the same anatomy."
        )


def design_lines(found: Numbers, design: Design) -> Iterator[str]:
    """The paper's differences, the interactions on primary metrics, and all effects."""
    if table := paper_rows(found.answers.paper):
        yield "### The differences that the paper reports"
        yield table
        yield (
            "Mean with a component minus mean without it. The paper's are those of its Table II, one training each at "
            'its own size. If the paper\'s difference lies outside our 95 % interval, the column "excluded" says '
            "whether our effect is smaller (less here) or larger (more here). It names both intervals if they disagree."
        )
    if table := interaction_rows(
        interactions(found.answers.means, design, found.answers.components), found.answers.verdicts
    ):
        yield "### Interactions"
        yield table
        yield (
            "Half of the difference between the improvement of a component (row) with and without another component "
            "(column), in the unit of the metric of the row. Positive values mean that the component helps more with "
            "the other one. Bold: the false discovery rate is below 5 %."
        )
    effects = found.answers.effects
    if len(effects):
        yield "### All effects"
        yield effect_rows(effects, design.factors)
        yield (
            "Exploratory. Mean with a component minus mean without it. Bold, and named in the last column: the false "
            f"discovery rate over all {len(effects)} effects and interactions of the table is below 5 %."
        )


def figures(study: Path, found: Numbers) -> list[Path]:
    """Draw the verdicts and the kept frame as PNG into the folder of the study; PDF is for `task=compare`."""
    kept = []
    with TemporaryDirectory() as folder:
        tables = (
            found.answers.verdicts,
            improvements(found.answers.means, found.answers.design, found.answers.components),
            interactions(found.answers.means, found.answers.design, found.answers.components),
        )
        made = forest_figure(*tables, found.answers.components, Path(folder) / "verdicts")
        if frame := kept_frame(study, named(found.usable.runs)):
            made += qualitative_figure([frame], Path(folder) / "qualitative", found.answers.components)
        for path in made:
            if path.suffix == ".png":
                kept.append(study / path.name)
                with Image.open(path) as image:  # 256 colours: a third of the size
                    image.convert("RGB").quantize(256).save(kept[-1], optimize=True)
    return kept


def kept_frame(study: Path, runs: Sequence[Run]) -> FramePictures | None:
    """The kept frame with what the first training of each variant made of it; None where it was not kept."""
    if not (study / FRAME).exists():
        return None
    with np.load(study / FRAME) as file:
        maps = dict(file)
    number = int(maps["number"])
    predictions = {RESIMULATION: maps["resimulation"]} if "resimulation" in maps else {}
    order = ordered_variants([run.label for run in runs])
    for run in sorted(runs, key=lambda run: (order.index(run.label), run.seed)):
        if run.label not in predictions and (run.folder / PICTURES).exists():
            with np.load(run.folder / PICTURES) as file:
                if number in file["frames"]:
                    predictions[run.label] = file["images"][file["frames"].tolist().index(number)]
    name, of = f"frame {number}", (maps["mask"], maps["segmentation"], maps.get("attenuation"))
    return FramePictures(name, maps["target"], predictions, *of)


def write_page(kept: Path, page: Path) -> None:
    """Write what stands between the markers of the page; a page without them is begun.

    `kept` is the folder of kept studies. Raises ValueError when nothing is kept.
    """
    studies = sorted({path.parents[2] for path in kept.glob("*/*/seed*/result.json")})
    if not studies:
        raise ValueError(f"{kept} holds no study; `python scripts/results.py keep runs/answer` copies one")
    text = page.read_text() if page.exists() else f"# Results\n\n{BEGIN}\n{END}\n"
    before, _, rest = text.partition(BEGIN)
    _, ended, after = rest.partition(END)
    if not ended:
        raise ValueError(f"{page} lacks the markers {BEGIN} and {END}")
    paragraphs = [line.strip() for study in studies for line in study_lines(study) if line]
    page.write_text(before + BEGIN + "\n\n" + "\n\n".join(paragraphs) + "\n\n" + END + after)
