"""What docs/results.md says of the kept studies: verdicts, tables and figures; scripts/results.py calls it."""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
from PIL import Image

import ablate
from ablate.analysis import (
    REFERENCE,
    RESIMULATION,
    FramePictures,
    Verdict,
    forest_figure,
    improvements,
    interactions,
    ordered_variants,
    qualitative_figure,
)
from ablate.analysis.figures.style import shown_name
from ablate.analysis.statistics.component_models import ErrorOf
from ablate.analysis.tables import NOTHING, head
from ablate.command.compose import jobs_of
from ablate.metrics import metric_of
from ablate.metrics.metric import FRAME_TIME
from ablate.settings.components import components
from ablate.study.comparable import versions_of
from ablate.study.opened import Study
from ablate.study.reading import provenance
from ablate.study.run import Run, read_list

BEGIN, END = "<!-- written by scripts/results.py: begin -->", "<!-- written by scripts/results.py: end -->"
CAPTION = (
    "What components earn, each on its own metric. The unit is the change that is too small to matter; beyond it the "
    "axis is logarithmic. Zero is the mean of the runs without the component; dots are runs, adjusted for the other "
    "components and the anatomy. The thin line has Holm's correction over the components, and only its ends have a "
    "meaning: does not, if the right end is below 1; otherwise earns, if the left end is above 0. An effect is that "
    "of one change while all else is as in sa2h."
)
AS_THERE = "Drawn, judged and tabulated as [there](results.md#full_model)."
COLUMNS = (
    "An effect is the mean with a component minus the mean without it; the arrow says which values are better. "
    "p (zero) tests that the effect is zero, p (band) that the improvement is at least the band, both corrected over "
    "the components (Holm). A difference in time within the spread of the timing is 0. "
)
FRAME = "frame.npz"
MAIN = "full_model"  # which keeps pictures
STUDIES = (MAIN, "extension")  # of docs/results.md, each a file of conf/study
# What SA2H of preset=traced is to reach, as a share of re-simulation's own score; of FD speckle the value itself.
BARS = {"mae_smooth": 1.7, "pchi2_tissue": 2.0, "shadow_contrast": 2.2, "thin_contrast": 2.0, "crps": 1.3}
BARS |= {"noise_sd": 1.08, "fd_speckle": 0.8}


@cache
def planned_runs(study: str) -> frozenset[str]:
    """Names of the runs of a file of conf/study."""
    return frozenset(job.name for job in jobs_of([f"+study={study}"]))


def finished_of(study: str, runs: Sequence[Run]) -> tuple[bool, str]:
    """Whether runs of a study's design are missing, and a sentence that says how many runs are finished.

    Runs of another variant than the reference are beside the design.
    """
    done = {run.name for run in runs}
    planned = planned_runs(study)
    design = {name for name in planned if re.split(r"[./]", name)[0] == REFERENCE}
    said = f"{len(planned & done)} of {len(planned)} runs are finished"
    if design <= done:
        return False, f"{said}."
    return True, f"{said}: {len(design & done)} of the {len(design)} runs of the design."


def study_lines(folder: Path, first: bool) -> Iterator[str]:
    """Paragraphs of a page on a kept study, into whose folder figures go; the `first` explains figure and table."""
    try:
        study = ablate.open_study(folder)
    except FileNotFoundError as error:
        raise ValueError(str(error)) from error
    runs, answers = study.usable.all, study.results
    preliminary, said = finished_of(folder.name, runs)
    yield f"## {folder.name}"
    yield said + (" **All verdicts are preliminary.**" if preliminary else "")
    yield about(runs, study.per_image)
    answers.verdicts.to_csv(folder / "verdicts.csv", index=False)
    drawn = {path.stem: f"![{path.stem}](results/{folder.name}/{path.name})" for path in figures(folder, study)}
    if "verdicts" in drawn:
        yield f"{drawn['verdicts']}\n\n*{CAPTION if first else AS_THERE}*"
        yield verdict_rows(answers.verdicts, preliminary)
        yield (
            (COLUMNS if first else "") + f"The pooled error has {answers.verdicts['dof'].max():.0f} degrees of freedom"
            f"{own_errors(answers.verdicts)}. "
            f"[verdicts.csv](results/{folder.name}/verdicts.csv) has all columns."
        )
    if folder.name != MAIN:
        return
    yield "### How far from re-simulation"
    table = shares(study)
    yield share_rows(table)
    yield (
        "Scores on test frames as a share of re-simulation's own, mean over the runs of a network; of FD speckle the "
        "score itself. 1 is a perfect renderer that draws its own speckle. All are of one anatomy, and the full model "
        "also of the other. The time includes the maps that the network reads. The bars are those that SA2H of "
        "`preset=traced` was developed for, in another anatomy. They were added while the trainings of the study ran, "
        "and no verdict depends on them."
    )
    if distances := distance_rows(table):
        yield distances
        yield (
            "Distance to re-simulation, as a share of the distance of the full model: 1 is as far as the full model, "
            "and 0 is re-simulation."
        )
    if "qualitative" in drawn:
        yield "### Pictures"
        yield (
            f"{drawn['qualitative']}\n\n*A test frame of an unseen probe site. The target has its segmentation in the "
            "left corner and the logarithm of its attenuation map in the right corner. Each network is the first "
            "training of its variant. Re-simulation is the same frame with other scatterers and ray paths.*"
        )
    if len(answers.effects):
        yield (
            f'`ablate.open_study("docs/results/{folder.name}").results.effects` has all {len(answers.effects)} '
            "effects, on all metrics (exploratory)."
        )


def about(runs: Sequence[Run], per_image: pd.DataFrame) -> str:
    """Size, data, versions, code and machines of a study, in a paragraph."""
    s = runs[0].training.about["settings"]
    rows, columns = s["simulator"]["image_shape"]
    sets = ", ".join(f"`{name}`" for name in dict.fromkeys(run.data for run in runs))
    tested = per_image[per_image["variant"] != RESIMULATION]
    made = {run.name: provenance([run]) for run in runs}
    commits = Counter(of.get("git_commit", "")[:7] for of in made.values())
    machines = Counter(of.get("hardware", "") for of in made.values())
    started = min(str(run.training.result["started"]) for run in runs)
    scored = min(run.first_scored for run in runs)
    versions = " and ".join(f"version {version} of the {what}" for what, version in versions_of(runs))
    said = [
        f"Frames of {rows} x {columns} pixels, networks of {s['model']['width']:g} times the paper's width, "
        f"{s['training']['steps']:,} training steps. Data: {sets}; in the first {tested['frame'].nunique()} test "
        f"frames of {tested['site'].nunique()} sites.",
        f"The results are of {versions}.",
        f"The first run was started at {started}, and the first test frame was scored at {scored}.",
        f"Commits: {', '.join(filter(None, commits))}." if any(commits) else "",
        f"Machines: {'; '.join(f'{name} ({n} runs)' for name, n in machines.items())}." if any(machines) else "",
        "Times a frame on different machines cannot be compared." if len(machines) > 1 else "",
    ]
    return " ".join(filter(None, said))


def network_of(label: str) -> str:
    """What a network is called: its label without the anatomy; of another variant than the reference its name alone."""
    variant, *changes = re.sub(r"\.anatomy_seed-\d+", "", label).split(".")
    return ".".join([variant, *changes]) if variant == REFERENCE else variant


def shares(study: Study) -> pd.DataFrame:
    """A row a network on the reference's data, and the reference on other anatomies: scores over re-simulation's.

    Of FD speckle the score itself; `runs` is the number of trainings and `ms` the time of a frame.
    """
    ms = study.table[study.table["metric"] == FRAME_TIME].set_index("variant")["mean"]
    rows = []
    for run in (*study.usable.runs, *(run for run in study.usable.blocks if network_of(run.label) == REFERENCE)):
        scalars = run.scalars
        row = {name: scalars[f"test/{name}"] / scalars[f"test/floor_{name}"] for name in list(BARS)[:-1]}
        name = network_of(run.label) if run in study.usable.runs else run.label
        row |= {"fd_speckle": scalars["test/fd_speckle"], "runs": 1, "ms": ms.get(run.label)}
        rows.append({"network": name, **row})
    of = pd.DataFrame(rows).groupby("network")
    table = of.mean().assign(runs=of.size())
    return table.loc[ordered_variants(list(table.index))]


def share_rows(table: pd.DataFrame) -> str:
    """What `shares` gives, below the bars."""
    bars = [f"*{bar:g}*" if name != "noise_sd" else "*0.92 to 1.08*" for name, bar in BARS.items()]
    rows = [["*bar*", NOTHING, *bars, NOTHING]]
    for name, row in table.iterrows():
        scores = [f"{row[metric]:.2f}" for metric in BARS]
        ms = NOTHING if pd.isna(row["ms"]) else f"{row['ms']:.0f}"
        rows.append([shown_name(str(name), components()), f"{row['runs']:.0f}", *scores, ms])
    return pipe_table(("network", "runs", *(metric_of(name).label for name in BARS), "ms a frame"), rows)


def distance_rows(table: pd.DataFrame) -> str:
    """How far networks beside the design are from re-simulation, in shares of the full model's distance."""
    metrics = [name for name in BARS if name not in ("noise_sd", "fd_speckle")]
    beside = [str(name) for name in table.index if str(name).partition(".")[0] != REFERENCE]
    if REFERENCE not in table.index or not beside:
        return ""
    rows = []
    for name in beside:
        distances = (table.loc[name, metrics] - 1) / (table.loc[REFERENCE, metrics] - 1)
        rows.append([name, *(f"{value:.1f}" for value in distances)])
    return pipe_table(("network", *(metric_of(name).label for name in metrics)), rows)


def figures(folder: Path, study: Study) -> list[Path]:
    """Draw the verdicts and the kept frame as PNG into the folder of the study; PDF is for `task=compare`."""
    kept, answers = [], study.results
    of_study = answers.means, answers.design, answers.components
    with TemporaryDirectory() as scratch:
        tables = answers.verdicts, improvements(*of_study), interactions(*of_study)
        made = forest_figure(*tables, answers.components, Path(scratch) / "verdicts")
        if frame := kept_frame(folder, study.usable.runs):
            made += qualitative_figure([frame], Path(scratch) / "qualitative", answers.components)
        for path in made:
            if path.suffix == ".png":
                kept.append(folder / path.name)
                with Image.open(path) as image:  # 256 colours: a third of the size
                    image.convert("RGB").quantize(256).save(kept[-1], optimize=True)
    return kept


def kept_frame(folder: Path, runs: Sequence[Run]) -> FramePictures | None:
    """The kept frame with what the first training of each variant made of it; None where it was not kept."""
    if not (folder / FRAME).exists():
        return None
    with np.load(folder / FRAME) as file:
        maps = dict(file)
    number = int(maps["number"])
    predictions = {RESIMULATION: maps["resimulation"]} if "resimulation" in maps else {}
    order = ordered_variants([run.label for run in runs])
    for run in sorted(runs, key=lambda run: (order.index(run.label), run.seed)):
        images = run.training.pictures
        if number in images:
            predictions.setdefault(network_of(run.label), images[number])
    of = maps["mask"], maps["segmentation"], maps.get("attenuation")
    return FramePictures(f"frame {number}", maps["target"], predictions, *of)


def verdict_rows(verdicts: pd.DataFrame, preliminary: bool) -> str:
    """What `verdict_table` gives, a row a component that some run goes without."""
    rows = []
    for row in verdicts[verdicts["effect"].notna()].to_dict("records"):
        decimals = metric_of(row["metric"]).decimals
        effect = signed(row["effect"], decimals)
        if pd.notna(row["lower"]):
            effect += f" [{signed(row['lower'], decimals)}, {signed(row['upper'], decimals)}]"
        word = f"**{Verdict(row['verdict']).replace('_', ' ')}**" + (" (preliminary)" if preliminary else "")
        chances = (probability(row[name]) for name in ("p_holm", "p_band_holm"))
        costs = signed(row["ms_per_frame"], 1), signed(row["parameters"] / 1000, 0)
        rows.append([row["component"], head(row["metric"]), word, effect, f"{row['band']:.3g}", *chances, *costs])
    titles = ("effect [95 %]", "band", "p (zero)", "p (band)", "ms a frame", "parameters (1000)")
    return pipe_table(("component", "metric", "verdict", *titles), rows, 3)


def own_errors(verdicts: pd.DataFrame) -> str:
    """Which components are tested by the spread of their own runs, as a clause; empty where none is."""
    names = list(verdicts.loc[verdicts["error"] == ErrorOf.own, "component"])
    return f"; that of {' and '.join(names)} is by the spread of the runs with it and without it" if names else ""


def pipe_table(head_cells: Sequence[str], rows: Iterable[Sequence[str]], words: int = 1) -> str:
    """A pipe table; the first `words` columns hold words, the others numbers."""
    under = ["---"] * words + ["---:"] * (len(head_cells) - words)
    first, *others = (f"| {' | '.join(cells)} |" for cells in (head_cells, *rows))
    return "\n".join([first, f"|{'|'.join(under)}|", *others])


def signed(value: float, decimals: int) -> str:
    """A number with its sign; a dash where it is missing, and no sign where it is printed as zero."""
    if pd.isna(value):
        return NOTHING
    text = f"{value:+,.{decimals}f}"
    return text.replace("-", "−") if text.strip("+-0.,") else text[1:]


def probability(p: float) -> str:
    """Three decimals; what is smaller is said to be smaller."""
    return NOTHING if pd.isna(p) else "< 0.001" if p < 0.001 else f"{p:.3f}"


def write_results(kept: Path, page: Path) -> None:
    """Write the page of the studies; a ValueError when nothing is kept in the folder."""
    studies = [kept / name for name in STUDIES if read_list(kept / name).runs]
    if not studies:
        raise ValueError(f"{kept} holds no study; `python scripts/results.py keep runs/full_model` copies one")
    write_between(page, chain(*(study_lines(study, first=study is studies[0]) for study in studies)))


def write_between(page: Path, paragraphs: Iterable[str]) -> None:
    """Write what stands between the markers of a page; one that is not there is begun."""
    text = page.read_text() if page.exists() else f"# Results\n\n{BEGIN}\n{END}\n"
    before, _, rest = text.partition(BEGIN)
    _, ended, after = rest.partition(END)
    if not ended:
        raise ValueError(f"{page} lacks the markers {BEGIN} and {END}")
    written = "\n\n".join(paragraph.strip() for paragraph in paragraphs if paragraph)
    page.write_text(f"{before}{BEGIN}\n\n{written}\n\n{END}{after}")
