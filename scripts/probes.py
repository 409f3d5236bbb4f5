"""Draw one plane of the built-in anatomy as three real transducers see it, into docs/probes.png.

The probes are those of conf/probe: a convex, a linear and a phased array, from the same place on the skin.

python scripts/probes.py
"""

from pathlib import Path

from matplotlib.figure import Figure

from ablate.analysis.figures.style import PAGE_IN, PNG_DPI, house_style
from ablate.anatomy import fetal_abdomen, fetal_planes
from ablate.command.compose import jobs_of
from ablate.ultrasound import Simulator, with_patient_gain
from ablate.ultrasound.probe import fan_of

DOCS = Path(__file__).parents[1] / "docs"
PLANE = "abdomen"
SHOWN = {"c5-2v": "convex, C5-2v", "l11-5v": "linear, L11-5v", "p4-2v": "phased, P4-2v"}
SIZE = [
    "preset=fine",
    "simulator.image_shape=${fan_shape:1000}",
    "simulator.scanlines=192",
    "simulator.axial_samples=2048",
]


def main() -> None:
    """Render the three frames and write the picture."""
    scene = fetal_abdomen()
    jobs = [jobs_of([f"probe={name}", *SIZE])[0].settings for name in SHOWN]
    shapes = [job.simulator.image_shape for job in jobs]
    with house_style():
        widths = [columns / rows for rows, columns in shapes]
        figure = Figure(figsize=(PAGE_IN, PAGE_IN / sum(widths) + 0.35), layout="constrained")
        panels = figure.subplots(1, len(jobs), width_ratios=widths)
        for axes, job, title in zip(panels, jobs, SHOWN.values(), strict=True):
            pose = fetal_planes(press_mm=job.dataset.press_mm)[PLANE]
            chosen = with_patient_gain(scene, job.probe, job.simulator, pose[None])
            image = Simulator(scene, job.probe, chosen, poses=[pose]).render(pose).image
            (height, width), top = fan_of(job.probe).size_mm, -fan_of(job.probe).sag_mm
            axes.imshow(image, cmap="gray", vmin=0, vmax=255, extent=(-width / 2, width / 2, top + height, top))
            axes.set_title(f"{title}, {job.probe.frequency_mhz:g} MHz")
            axes.set_xlabel("lateral (mm)")
        panels[0].set_ylabel("depth (mm)")
        figure.savefig(DOCS / "probes.png", dpi=PNG_DPI)


if __name__ == "__main__":
    main()
