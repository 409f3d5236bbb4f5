"""Measure again figures, CSV files and tables of docs/numerics.md, teachers.md, own_simulator.md; on a quiet machine.

make precision RUNS=runs PRESET=laptop PATIENT=path/to/scene     # an hour and a half at most on two cores
python scripts/numerics.py --parts fetal                            # only the built-in anatomy with the trained runs
python scripts/numerics.py --draw                                   # the figures again, from the CSV files

The part of the paper's size trains SA2H there first and shows its frames and scores. Of a patient, figures of errors
and times are shown and no image. The teacher is that of `+study=compounded`, which is trained before, and so is
`+study=pymust`. Tables stand between `<!-- table: name -->` and `<!-- end -->`; all other text is left as it is.
"""

import argparse
import re
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import pandas as pd

from ablate.analysis import error_vs_runtime
from ablate.metrics import METRICS
from ablate.numerics.precision.figures import draw, renderers, resimulation_level
from ablate.numerics.precision.task import tables, verdict
from ablate.numerics.precision.worth import worth

DOCS = Path(__file__).parents[1] / "docs"
PAGE = DOCS / "numerics.md"
TEACHER = DOCS / "teachers.md"
PYMUST = DOCS / "own_simulator.md"
PARTS = ("fetal", "paper", "patient", "teacher", "pymust", "scaling")
BY_DEFAULT = ("fetal", "paper", "patient", "scaling")  # the others need a study that is trained before
#: What stands on a figure that is drawn from the CSV files.
MACHINE = "processor B (docs/processors.md)"
#: The metrics of README's figure, and what it leaves out: a network's other precision.
OF_README, LEFT_OUT = ("pchi2", "mae_smooth"), "fp32"
#: The setting that is the re-simulation, by what the names of figures end with.
USUAL = {
    "": "rays 16",
    "_paper": "rays 32",
    "_patient": "rays 16",
    "_teacher": "rays 16",
    "_pymust": "ablate.simulators.pymust_waves.diverging_waves",
}
#: The paper's sizes; all else is the preset's.
PAPERS_SIZE = (
    "scene.triangles=675000",
    "probe.frequency_mhz=8",
    "simulator.image_shape=[1000,1386]",
    "simulator.scanlines=192",
    "simulator.axial_samples=3072",
    "simulator.rays=32",
    "simulator.axial_fwhm_mm=0.3",
    "simulator.lateral_fwhm_mm=0.8",
    "simulator.elevational_fwhm_mm=2.5",
    "simulator.active_aperture_mm=16",
    "simulator.noise_level_db=-177",
    "simulator.most_gain_db=null",
)
#: Metrics of the table of scores.
SCORES = [
    "psnr",
    "mae",
    "mae_smooth",
    "pchi2_tissue",
    "shadow_contrast",
    "thin_contrast",
    "crps",
    "noise_sd",
    "fd_speckle",
]
FIGURES = ("precision.png", "renderers.png")
ORDER = "Observed order"  # the first words of the table of the summary that stands on the page


def measure(arguments: list[str], runs: Path, suffix: str) -> dict[str, str]:
    """Run the task, copy its figures and points here; returns what belongs on the page."""
    subprocess.run([sys.executable, "-m", "ablate", "task=precision", f"runs_dir={runs}", *arguments], check=True)
    made = runs / "precision"
    shutil.copy(made / "precision.csv", DOCS / f"precision{suffix}.csv")
    for name in FIGURES:
        copy_if_shown(made / name, suffix)
    points = pd.read_csv(made / "precision.csv", dtype={"setting": str})
    details = pd.read_csv(made / "details.csv", dtype={"setting": str})
    usual = USUAL[suffix]
    order = next((table for name, table in tables(points, usual).items() if name.startswith(ORDER)), pd.DataFrame())
    halved = (details["table"] == "reference").any()  # not where the simulator is another one
    converged = verdict(details) if halved else ""
    return {"order": markdown(order), "verdict": converged, "worth": markdown(worth(points, usual))}


def copy_if_shown(figure: Path, suffix: str) -> None:
    """Copy a figure into the pages' folder, if one of them shows it."""
    name = f"{figure.stem}{suffix}{figure.suffix}"
    if any(f"]({name})" in page.read_text() for page in (PAGE, TEACHER, PYMUST)):
        shutil.copy(figure, DOCS / name)


def draw_kept() -> None:
    """Draw the figures from the CSV files of the page."""
    for suffix, usual in USUAL.items():
        if not (DOCS / f"precision{suffix}.csv").exists():  # not measured yet
            continue
        points = pd.read_csv(DOCS / f"precision{suffix}.csv", dtype={"setting": str})
        with TemporaryDirectory() as folder:
            draw(points, usual, Path(folder), MACHINE)
            for name in FIGURES:
                copy_if_shown(Path(folder) / name, suffix)


def draw_for_readme() -> None:
    """Draw the renderers of a compounded frame with two metrics only, from the CSV file."""
    points = pd.read_csv(DOCS / "precision_teacher.csv", dtype={"setting": str})
    points = points[points["metric"].isin(OF_README)]
    usual = USUAL["_teacher"]
    shown = renderers(points, usual)
    shown = shown[shown["setting"] != LEFT_OUT]
    with TemporaryDirectory() as folder:
        error_vs_runtime(shown, Path(folder) / "worth", resimulation_level(points, usual), MACHINE)
        shutil.copy(Path(folder) / "worth.png", DOCS)


def markdown(table: pd.DataFrame) -> str:
    """A table with the columns of its index first."""
    if table.empty:
        return "(nothing of this kind was measured)"
    flat = table.reset_index().astype(str)
    rows = [list(map(str, flat.columns)), ["---"] * flat.shape[1], *flat.to_numpy().tolist()]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def fill(page: str, texts: dict[str, str]) -> str:
    """Put texts between their marks."""
    for name, text in texts.items():
        mark = re.compile(rf"(<!-- table: {re.escape(name)} -->\n).*?(<!-- end -->)", re.S)
        page = mark.sub(lambda m, text=text: f"{m[1]}{text}\n{m[2]}", page)  # type: ignore[misc]
    return page


def main() -> None:
    """Measure the parts that are asked for and rewrite the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="holds the trained runs (runs_dir)")
    parser.add_argument("--preset", default="quick", help="what they were trained with")
    parser.add_argument("--patient", type=Path, help="a scene folder; left out without")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=BY_DEFAULT)
    parser.add_argument("--draw", action="store_true", help="draw the figures again from the CSV files")
    args = parser.parse_args()
    if args.draw:
        draw_kept()
        draw_for_readme()
        return
    jobs = {
        "fetal": ([f"preset={args.preset}"], args.runs, ""),
        "paper": ([f"preset={args.preset}", *PAPERS_SIZE], args.runs / "paper-size", "_paper"),
        "patient": (
            ["scene=folder", f"scene.folder={args.patient}", "evaluation.timed_frames=20"],
            args.runs / "patient",
            "_patient",
        ),
        "teacher": (["+study=compounded"], args.runs, "_teacher"),
        "pymust": (["+study=pymust"], args.runs, "_pymust"),
    }
    for part in args.parts:
        if part == "paper":
            arguments, runs, _ = jobs[part]
            train = ["variant=sa2h", f"runs_dir={runs}", *arguments, "training.threads=0"]
            subprocess.run([sys.executable, "-m", "ablate", *train], check=True)
            made = runs / f"{args.preset}-fetal" / "comparison"
            shutil.copy(made / "qualitative_0.png", DOCS / "paper_size.png")
            means = pd.read_csv(made / "table.csv", index_col="variant")[[f"{name}_mean" for name in SCORES]]
            scores = means.map("{:.3g}".format).set_axis([METRICS[name].label for name in SCORES], axis=1)
            PAGE.write_text(fill(PAGE.read_text(), {"paper scores": markdown(scores)}))
        if part in jobs and not (part == "patient" and args.patient is None):
            found = {f"{part} {name}": text for name, text in measure(*jobs[part]).items()}
            page = {"teacher": TEACHER, "pymust": PYMUST}.get(part, PAGE)
            page.write_text(fill(page.read_text(), found))
            if part == "teacher":
                draw_for_readme()
        if part == "scaling":
            script = DOCS.parent / "benchmarks" / "scaling.py"
            shown = []
            with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True) as done:
                assert done.stdout is not None
                for line in done.stdout:
                    print(line, end="", flush=True)
                    shown.append(line)
            PAGE.write_text(fill(PAGE.read_text(), {"scaling": "".join(shown).strip()}))
            if done.returncode:
                raise SystemExit("the scaling benchmark ended early")


if __name__ == "__main__":
    main()
