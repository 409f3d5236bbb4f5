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
RENDER = """
import sys
import numpy as np
from ablate import ultrasound
from ablate.anatomy import fetal_abdomen, fetal_planes
scene, planes, probe = fetal_abdomen(), fetal_planes(), ultrasound.ConvexProbe(frequency_mhz=4.0)
settings = ultrasound.SimulatorSettings(image_shape=(500, 693), lateral_fwhm_mm=1.2, axial_fwhm_mm=0.4)
if hasattr(ultrasound, "TimeGain"):
    settings = ultrasound.SimulatorSettings(
        image_shape=(500, 693), lateral_fwhm_mm=1.2, axial_fwhm_mm=0.4, tgc=ultrasound.TimeGain.patient
    )
    settings = ultrasound.with_patient_gain(scene, probe, settings, np.array(list(planes.values())))
simulator = ultrasound.Simulator(scene, probe, settings)
np.savez(sys.argv[1], **{name: simulator.image(planes[name]) for name in sys.argv[2:]})
"""


def rendered(checkout: Path, folder: Path) -> dict[str, np.ndarray]:
    """The planes, by name, with the sources of a checkout."""
    path = folder / "images.npz"
    environment = {**os.environ, "PYTHONPATH": str(checkout / "src")}
    subprocess.run([sys.executable, "-c", RENDER, str(path), *PLANES], env=environment, check=True)
    with np.load(path) as images:
        return {name: images[name] for name in PLANES}


def main() -> None:
    """Render both and write the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("earlier", type=Path, help="folder of an earlier checkout")
    earlier = parser.parse_args().earlier
    with tempfile.TemporaryDirectory() as folder:
        rows = [rendered(checkout, Path(folder)) for checkout in (earlier, Path(__file__).parents[1])]
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
