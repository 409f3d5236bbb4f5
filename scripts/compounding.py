"""Draw one plane of the built-in anatomy without and with spatial compounding, into docs/compounding.png.

Above as a convex probe sees it, of one angle and of five; below a linear one, over the mother's wall.

python scripts/compounding.py
"""

from dataclasses import replace
from pathlib import Path

from matplotlib.figure import Figure

from ablate.analysis.figures.style import PAGE_IN, PNG_DPI, house_style
from ablate.anatomy import fetal_abdomen, fetal_planes
from ablate.command.compose import jobs_of
from ablate.ultrasound import Simulator, with_patient_gain
from ablate.ultrasound.probe import fan_of

DOCS = Path(__file__).parents[1] / "docs"
SHOWN = {"c5-2v": "spine", "l11-5v": "abdomen"}  # plane of each probe of conf/probe
ANGLES = (1, 5)
SIZE = ["preset=paper", "simulator.scanlines=192", "simulator.axial_samples=2048", "simulator.rays=16"]


def main() -> None:
    """Render the frames and write the picture."""
    scene = fetal_abdomen()
    jobs = {name: jobs_of([f"probe={name}", *SIZE])[0].settings for name in SHOWN}
    tall = [rows / columns for rows, columns in (job.simulator.image_shape for job in jobs.values())]
    with house_style():
        figure = Figure(figsize=(PAGE_IN, PAGE_IN / len(ANGLES) * sum(tall) + 0.9), layout="constrained")
        rows = figure.subplots(len(SHOWN), len(ANGLES), height_ratios=tall)
        for panels, (name, plane) in zip(rows, SHOWN.items(), strict=True):
            job = jobs[name]
            pose = fetal_planes(press_mm=job.dataset.press_mm)[plane]
            chosen = with_patient_gain(scene, job.probe, job.simulator, pose[None])
            (height, width), top = fan_of(job.probe).size_mm, -fan_of(job.probe).sag_mm
            for axes, angles in zip(panels, ANGLES, strict=True):
                settings = replace(chosen, compound_angles=angles)
                image = Simulator(scene, job.probe, settings, poses=[pose]).render(pose).image
                axes.imshow(image, cmap="gray", vmin=0, vmax=255, extent=(-width / 2, width / 2, top + height, top))
                axes.set_title(f"{name}, {angles} angle{'s' if angles > 1 else ''}")
                axes.set_xlabel("lateral (mm)")
            panels[0].set_ylabel("depth (mm)")
        figure.savefig(DOCS / "compounding.png", dpi=PNG_DPI)


if __name__ == "__main__":
    main()
