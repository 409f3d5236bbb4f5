"""Results that are kept in the repository: small copies of finished runs, and the tables and figures made from them.

python scripts/results.py keep runs/full_model    # copy what is finished into docs/results/full_model
python scripts/results.py restore             # put it back into runs/: the same sweep goes on where it stopped
python scripts/results.py table               # write the tables of docs/results.md and its figures

`keep` adds what has finished since, on whichever machine. A run is kept with its configuration, its scalars, its values
a frame and what it was made with; not with its weights. Times a frame are kept, too. Of each variant on the data of the
reference the first training keeps one picture. Prose in docs/results.md stays as it is: only what stands between the
two markers is written.
"""

import argparse
import json
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from ablate.runs.run import Run, State

from ablate.analysis import RESIMULATION
from ablate.storage import write_json
from ablate.study.comparable import usable_runs
from ablate.study.frame_times import TIMES
from ablate.study.reading import pictures
from results_page import FRAME, MAIN, PICTURES, write_page

DOCS = Path(__file__).resolve().parents[1] / "docs"
KEPT, PAGE = DOCS / "results", DOCS / "results.md"
VALUES, MADE_WITH = "per_image.parquet", "provenance/made_with.json"


def keep(study: Path, kept: Path = KEPT) -> list[str]:
    """Copy the finished runs of a study, small: what is kept already and has the same hash stays as it is.

    Parameters
    ----------
    study : Path
        As `runs/full_model`.
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
        raise ValueError(f"{study} holds no finished run; allowed is the folder of a study, as runs/full_model")
    target = kept / study.resolve().name
    said = list(usable.notes)
    for run in usable.all:
        folder = target / run.label / f"seed{run.seed}"
        there = folder / "result.json"
        if there.exists():
            before = json.loads(there.read_text())
            if before["hash"] != run.result["hash"]:
                raise ValueError(f"{folder} holds another configuration of {run.name}: remove it or keep it elsewhere")
            if before == run.result:
                continue
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        settings = run.spec["settings"]
        scene = {name: Path(v).name if name == "folder" and v else v for name, v in settings["scene"].items()}
        own = {"runs_dir": "runs", "tracking": {**settings.get("tracking", {}), "uri": None}, "scene": scene}
        write_json(folder / "spec.json", {**run.spec, "settings": {**settings, **own}})
        pack(run.folder / VALUES, folder / VALUES)
        if run.seed == 0 and target.name == MAIN and run in usable.runs and (run.folder / PICTURES).exists():
            with np.load(run.folder / PICTURES) as shown:
                np.savez_compressed(folder / PICTURES, frames=shown["frames"][:1], images=shown["images"][:1])
        if (run.folder / MADE_WITH).exists():
            (folder / MADE_WITH).parent.mkdir(exist_ok=True)
            shutil.copyfile(run.folder / MADE_WITH, folder / MADE_WITH)
        write_json(there, run.result)  # last: a run that has it is whole
        said.append(f"kept {run.name}")
    if (study / TIMES).exists():
        shutil.copyfile(study / TIMES, target / TIMES)
    if target.name == MAIN and not (target / FRAME).exists():
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


def keep_frame(runs: Sequence[Run], path: Path) -> list[str]:
    """Keep the target, the re-simulation and the maps of the first frame that all runs show, where pairs are on disk.

    Parameters
    ----------
    runs : sequence of Run
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
        maps["resimulation"] = shown.predictions[RESIMULATION]
    np.savez_compressed(path, number=int(shown.name.split()[-1]), **{k: v for k, v in maps.items() if v is not None})
    return []


def restore(kept: Path = KEPT, runs_dir: Path = Path("runs")) -> list[str]:
    """Put kept runs back where a sweep looks for them. What is finished there, or has another configuration, stays.

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
    results = sorted(kept.glob("*/*/seed*/result.json"))
    if older := [result for result in results if Run(result.parent).state is not State.finished]:
        why = Run(older[0].parent).why
        said.append(f"{len(older)} kept runs stay where they are: they are of an older version of ablate ({why})")
    for result in (result for result in results if result not in older):
        name = result.parent.relative_to(kept)
        target = runs_dir / name
        if (target / "result.json").exists() or _hash(target) not in ("", _hash(result.parent)):
            said.append(f"there already: {name}")
            continue
        whole = shutil.ignore_patterns("result.json")  # it comes last: a run that has it is whole
        shutil.copytree(result.parent, target, dirs_exist_ok=True, ignore=whole)
        shutil.copyfile(result, target / "result.json")
        said.append(f"restored {name}")
    for times in kept.glob(f"*/{TIMES}"):
        if not (there := runs_dir / times.relative_to(kept)).exists():
            shutil.copyfile(times, there)
    return said


def _hash(run: Path) -> str:
    """The hash of a run's configuration; empty where it was never started."""
    spec = run / "spec.json"
    return str(json.loads(spec.read_text())["hash"]) if spec.exists() else ""


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
            write_page(KEPT, PAGE)
        else:
            print("\n".join(keep(args.study) if args.command == "keep" else restore(runs_dir=args.runs)))
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
