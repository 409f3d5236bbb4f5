"""Copy a trained generator into the package, where `ablate.load(name)` finds it.

python scripts/ship.py runs/full_model/sa2h/seed0 sa2h
"""

import argparse
from dataclasses import replace
from pathlib import Path

from ablate.runs.run import Run

from ablate.dataset import label_values
from ablate.pretrained import Renderer, save, values_of
from ablate.study.reading import provenance
from ablate.training import load_generator

SHIPPED = Path(__file__).parents[1] / "src/ablate/pretrained"


def renderer_of(folder: Path) -> Renderer:
    """The generator of a finished run, with the setting that it was trained in."""
    run = Run(folder)
    s, tissues = run.settings, run.data_set.tissues
    values = label_values(tissues, s.encoding, s.label_seed)
    made = {"study": s.study, "variant": run.label, "seed": str(run.seed), "hash": str(run.result["hash"])}
    made |= {"commit": provenance([run]).get("git_commit", "")}
    simulator = replace(s.simulator, time_gain_db=run.data_set.time_gain_db)
    return Renderer(load_generator(run.checkpoint), values_of(tissues, values), s.probe, simulator, made)


def main() -> None:
    """Copy the generator that is named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="folder of a finished run")
    parser.add_argument("name")
    arguments = parser.parse_args()
    path = SHIPPED / f"{arguments.name}.pt"
    save(renderer_of(arguments.run.resolve()), path)
    print(f"{path}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
