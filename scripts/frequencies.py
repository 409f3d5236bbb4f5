"""Draw one plane of the built-in anatomy at three frequencies, with a part of each enlarged, into docs/frequencies.png.

Probe and settings are those of preset=fine at the paper's image size.

python scripts/frequencies.py
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ablate.analysis.figures.style import PAGE_IN, PNG_DPI, house_style
from ablate.anatomy import fetal_abdomen, fetal_planes
from ablate.command.compose import jobs_of
from ablate.ultrasound import Simulator, with_patient_gain
from ablate.ultrasound.probe import fan_of

DOCS = Path(__file__).parents[1] / "docs"
PLANE = "abdomen"
FREQUENCIES_MHZ = (2, 5, 12)
SIZE = ["preset=fine", "simulator.image_shape=[1000,1386]", "simulator.scanlines=256", "simulator.axial_samples=3072"]
ENLARGED_MM = (-20.0, 20.0, 62.0, 36.0)  # left, right, bottom, top


def main() -> None:
    """Render the three frames and write the picture."""
    scene, planes = fetal_abdomen(), fetal_planes()
    pose, (left, right, bottom, top) = planes[PLANE], ENLARGED_MM
    with house_style():
        figure = Figure(figsize=(PAGE_IN, 0.5 * PAGE_IN), layout="constrained")
        panels = figure.subplots(2, len(FREQUENCIES_MHZ), height_ratios=(1.0, 0.85))
        for (whole, enlarged), frequency_mhz in zip(panels.T, FREQUENCIES_MHZ, strict=True):
            (job,) = jobs_of([*SIZE, f"probe.frequency_mhz={frequency_mhz}"])
            chosen = with_patient_gain(scene, job.settings.probe, job.settings.simulator, np.array([*planes.values()]))
            image = Simulator(scene, job.settings.probe, chosen, poses=[pose]).render(pose).image
            fan = fan_of(job.settings.probe)
            (height, width), sag = fan.size_mm, fan.sag_mm
            for axes in (whole, enlarged):
                extent = (-width / 2, width / 2, height - sag, -sag)
                axes.imshow(image, cmap="gray", vmin=0, vmax=255, extent=extent, interpolation="antialiased")
            whole.set_title(f"{frequency_mhz} MHz")
            whole.add_patch(Rectangle((left, top), right - left, bottom - top, fill=False, ec="#f0e442", lw=0.6))
            enlarged.set_xlim(left, right)
            enlarged.set_ylim(bottom, top)
            enlarged.set_xlabel("lateral (mm)")
        for axes in panels[:, 0]:
            axes.set_ylabel("depth (mm)")
        figure.savefig(DOCS / "frequencies.png", dpi=0.8 * PNG_DPI)


if __name__ == "__main__":
    main()
