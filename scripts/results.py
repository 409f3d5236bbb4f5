"""Results that are kept in the repository: small copies of finished runs, and the tables and figures made from them.

python scripts/results.py keep runs/full_model    # copy what its comparison is of into docs/results/full_model
python scripts/results.py restore             # put it back into runs/: comparing it, or the same sweep, trains nothing
python scripts/results.py table               # write the tables of docs/results.md and docs/components.md, and figures

`keep` adds what has finished since, on whichever machine. A run is kept with its configuration, its scores and what it
was made with; not with its weights. Times a frame are kept, too. Of each variant on the data of the reference the first
training keeps one picture. Prose stays as it is: what stands between the two markers is written.
"""

import argparse
import shutil
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import components_page
from ablate.analysis import RESIMULATION
from ablate.storage import known_json, write_json
from ablate.study.comparable import comparable_runs
from ablate.study.frame_times import TIMES
from ablate.study.reading import pictures
from ablate.study.run import COMPARISON, LIST, Run, RunList, read_list, write_list
from ablate.study.training import ABOUT, RESULT
from results_page import FRAME, MAIN, write_between, write_results

DOCS = Path(__file__).resolve().parents[1] / "docs"
KEPT = DOCS / "results"
PAGE = DOCS / "results.md"


def keep(study: Path, kept: Path = KEPT) -> list[str]:
    """Copy the runs that a study's comparison is of, small: what is kept already stays as it is.

    A run that is kept with the same name and another configuration is replaced. A study without a comparison of
    finished runs is a ValueError. What is returned is a line a run copied, and a sentence for what was left aside.
    """
    study = study.resolve()
    listed = read_list(study)
    usable = comparable_runs(listed)
    if not usable.runs:
        raise ValueError(f"{study} holds no comparison; allowed is the folder of a compared study, as runs/full_model")
    target = kept / study.name
    lines = list(usable.notes)
    for run in usable.all:
        folder = target / run.training.folder.name
        if _is_kept(run, folder):
            continue
        shutil.rmtree(folder, ignore_errors=True)
        _copy(run, folder)
        if run.seed == 0 and target.name == MAIN and run in usable.runs and run.training.pictures_file.exists():
            with np.load(run.training.pictures_file) as shown:
                copied = folder / run.training.pictures_file.name
                np.savez_compressed(copied, frames=shown["frames"][:1], images=shown["images"][:1])
        lines.append(f"kept {run.name}")
    _write_list(target, replace(listed, runs=usable.all))
    if (study / TIMES).exists():
        shutil.copyfile(study / TIMES, target / TIMES)
    if target.name == MAIN and not (target / FRAME).exists():
        lines += keep_frame(usable.runs, target / FRAME)
    return lines


def _is_kept(run: Run, folder: Path) -> bool:
    """Whether the folder has the same training, and every score."""
    same = known_json(folder / RESULT) == run.training.result
    return same and all((folder / "scores" / name).exists() for name in run.score_names)


def _copy(run: Run, folder: Path) -> None:
    """Copy a run without its weights, and without paths of this machine."""
    training = run.training
    settings = training.about["settings"]
    scene = dict(settings["scene"])
    if scene.get("folder"):
        scene["folder"] = Path(scene["folder"]).name
    tracking = {**settings.get("tracking", {}), "uri": None}
    settings = {**settings, "runs_dir": "runs", "tracking": tracking, "scene": scene}
    (folder / "scores").mkdir(parents=True)
    write_json(folder / ABOUT, {**training.about, "settings": settings})
    for name in run.score_names:
        shutil.copyfile(training.scores / name, folder / "scores" / name)
    if training.made_with:
        (folder / "provenance").mkdir()
        write_json(folder / "provenance" / "made_with.json", training.made_with)
    write_json(folder / RESULT, training.result)  # last: a training that has it is whole


def _write_list(target: Path, listed: RunList) -> None:
    """Add runs to those that are kept of a study, and remove those of the same names."""
    names = {run.name for run in listed.runs}
    folders = {run.training.folder.name for run in listed.runs}
    others = []
    for run in read_list(target).runs:
        if run.name not in names:
            others.append(run)
        elif run.training.folder.name not in folders:
            shutil.rmtree(run.training.folder)
    (target / COMPARISON).mkdir(exist_ok=True)
    write_list(target / COMPARISON, replace(listed, runs=(*listed.runs, *others)))


def keep_frame(runs: Sequence[Run], path: Path) -> list[str]:
    """Keep the target, the re-simulation and the maps of the first frame that all runs show, where pairs are on disk.

    What is returned says why it is not kept; it is empty when it is.
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
        maps["resimulation"] = shown.predictions[RESIMULATION]
    np.savez_compressed(path, number=int(shown.name.split()[-1]), **{k: v for k, v in maps.items() if v is not None})
    return []


def restore(kept: Path = KEPT, runs_dir: Path = Path("runs")) -> list[str]:
    """Put kept runs, and the lists of those that are compared, where commands look for them. What is there stays."""
    lines = []
    for result in sorted(kept.glob(f"*/*/{RESULT}")):
        name = result.parent.relative_to(kept)
        target = runs_dir / name
        if (target / RESULT).exists():
            lines.append(f"there already: {name}")
            continue
        all_else = shutil.ignore_patterns(RESULT)  # it comes last: a training that has it is whole
        shutil.copytree(result.parent, target, dirs_exist_ok=True, ignore=all_else)
        shutil.copyfile(result, target / RESULT)
        lines.append(f"restored {name}")
    for file in (*kept.glob(f"*/{TIMES}"), *kept.glob(f"*/{COMPARISON}/{LIST}")):
        target = runs_dir / file.relative_to(kept)
        if not target.exists():
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, target)
    return lines


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
            write_results(KEPT, PAGE)
            if read_list(KEPT / components_page.STUDY).runs:
                write_between(DOCS / "components.md", components_page.lines(KEPT / components_page.STUDY))
        else:
            print("\n".join(keep(args.study) if args.command == "keep" else restore(runs_dir=args.runs)))
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
