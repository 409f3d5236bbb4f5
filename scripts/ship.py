"""Copy a trained generator into the package, where `ablate.load(name)` finds it.

python scripts/ship.py runs/full_model/sa2h-seed0-b90cb6a8 sa2h
"""

import argparse
from dataclasses import replace
from pathlib import Path

from ablate.dataset import label_values
from ablate.pretrained import Renderer, save, values_of
from ablate.study.training import Training
from ablate.training import load_generator

SHIPPED = Path(__file__).parents[1] / "src/ablate/pretrained"


def renderer_of(folder: Path) -> Renderer:
    """The generator of a training, with the setting that it was trained in."""
    training = Training(folder)
    s, tissues = training.settings, training.data_set.tissues
    values = label_values(tissues, s.encoding, s.label_seed)
    made = {"study": s.study, "variant": training.label, "seed": str(training.seed), "hash": training.hash}
    made["commit"] = str(training.made_with.get("git_commit", ""))
    simulator = replace(s.simulator, time_gain_db=training.data_set.time_gain_db)
    return Renderer(load_generator(training.checkpoint), values_of(tissues, values), s.probe, simulator, made)


def main() -> None:
    """Copy the generator that is named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("training", type=Path, help="its folder")
    parser.add_argument("name")
    arguments = parser.parse_args()
    path = SHIPPED / f"{arguments.name}.pt"
    save(renderer_of(arguments.training.resolve()), path)
    print(f"{path}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
