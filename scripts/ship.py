"""Copy a trained generator into the package, where `ablate.load(name)` finds it.

python scripts/ship.py runs/full_model/sa2h-seed0-b90cb6a8 sa2h
"""

import argparse
from pathlib import Path

from ablate.pretrained import save
from ablate.study.network import renderer_of
from ablate.study.training import Training

SHIPPED = Path(__file__).parents[1] / "src/ablate/pretrained"


def main() -> None:
    """Copy the generator that is named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("training", type=Path, help="its folder")
    parser.add_argument("name")
    arguments = parser.parse_args()
    path = SHIPPED / f"{arguments.name}.pt"
    save(renderer_of(Training(arguments.training.resolve())), path)
    print(f"{path}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
