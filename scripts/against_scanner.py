"""Draw standard planes as this checkout renders them, below the images of an earlier one: docs/against_scanner.png.

python scripts/against_scanner.py path/to/earlier/checkout
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ablate.analysis.figures.style import house_style

PLANES = ("head", "abdomen", "spine", "femur")
DOCS = Path(__file__).parents[1] / "docs"
POSES = 40
RENDER = """
import sys
import numpy as np
from ablate import ultrasound
from ablate.anatomy import fetal_abdomen, fetal_planes, fetal_sites
from ablate.dataset import equally_spaced, place_probe
scene, planes = fetal_abdomen(), fetal_planes()
probe = ultrasound.ConvexProbe(frequency_mhz=4.0)
poses = place_probe(scene, fetal_sites(), 8.0, probe).poses
poses = poses[equally_spaced(np.arange(len(poses)), int(sys.argv[2]))]
settings = {"image_shape": (500, 693), "lateral_fwhm_mm": 1.2, "axial_fwhm_mm": 0.4}
if hasattr(ultrasound, "TimeGain"):
    settings["tgc"] = ultrasound.TimeGain.patient

def simulator(**changes):
    chosen = ultrasound.SimulatorSettings(**{**settings, **changes})
    if hasattr(ultrasound, "TimeGain"):
        chosen = ultrasound.with_patient_gain(scene, probe, chosen, poses)
    return ultrasound.Simulator(scene, probe, chosen)

large, small = simulator(), simulator(scanlines=96, axial_samples=768, rays=8, image_shape=(200, 277))
shown = {name: large.image(planes[name]) for name in sys.argv[3:]}
fluid = 1 + [tissue.name for tissue in scene.tissues].index("amniotic_fluid")
frames = [small.render(pose) for pose in poses]
shares = [[(f.segmentation == fluid)[f.mask].mean(), (f.image >= 250)[f.mask].mean()] for f in frames]
np.savez(sys.argv[1], shares=shares, **shown)
"""


def rendered(checkout: Path, folder: Path, when: str) -> dict[str, np.ndarray]:
    """The planes, by name, with the sources of a checkout; prints what a sonographer sees first."""
    path = folder / "images.npz"
    environment = {**os.environ, "PYTHONPATH": str(checkout / "src")}
    subprocess.run([sys.executable, "-c", RENDER, str(path), str(POSES), *PLANES], env=environment, check=True)
    with np.load(path) as images:
        fluid, white = images["shares"].T
        cells = (f"{fluid.mean():.0%}", f"{fluid.max():.0%}", f"{white.mean():.1%}", f"{white.max():.1%}")
        print(f"| {when} | {' | '.join(cells)} |", flush=True)
        return {name: images[name] for name in PLANES}


def main() -> None:
    """Render both, print the table and write the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("earlier", type=Path, help="folder of an earlier checkout")
    checkouts = {"before": parser.parse_args().earlier, "now": Path(__file__).parents[1]}
    print(f"Shares of the fan in {POSES} frames at 4 MHz: amniotic fluid, and white (250 and brighter).\n")
    print("| | fluid, mean | most | white, mean | most |\n| --- | --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as folder:
        rows = [rendered(checkout, Path(folder), when) for when, checkout in checkouts.items()]
    with house_style():
        figure = Figure(figsize=(13, 5.2), layout="constrained")
        panels = figure.subplots(2, len(PLANES))
        for line, images, when in zip(panels, rows, ("before", "now"), strict=True):
            for axes, (name, image) in zip(line, images.items(), strict=True):
                axes.imshow(image, cmap="gray", vmin=0, vmax=255, interpolation="antialiased")
                axes.set_title(f"{name}, {when}")
                axes.set_axis_off()
        figure.savefig(DOCS / "against_scanner.png", dpi=110)


if __name__ == "__main__":
    main()
