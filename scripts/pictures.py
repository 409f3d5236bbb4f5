"""Draw one simulated frame at the paper's size, in two pictures.

docs/frame.png shows image, segmentation and attenuation map side by side, with depths and the names of tissues.
docs/preview.png shows the probe on the body in 3-D, as `task=preview` draws it.

python scripts/pictures.py
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from ablate.analysis import preview_figure
from ablate.analysis.figures.scene_parts import tissue_colours
from ablate.analysis.figures.style import PAGE_IN, PNG_DPI, house_style
from ablate.anatomy import Scene, fetal_abdomen, fetal_planes, fetal_sites
from ablate.command.compose import jobs_of
from ablate.ultrasound import ConvexProbe, Frame, Simulator, with_patient_gain
from ablate.ultrasound.probe import fan_of

DOCS = Path(__file__).parents[1] / "docs"
PLANE = "spine"
LEAST_SHARE = 0.002  # of the fan, or a tissue is not named
#: A scanner's noise, gain and pulse at the paper's image size.
SETTINGS = ["preset=fine", "simulator.image_shape=[1000,1386]", "simulator.axial_samples=3072", "simulator.rays=32"]
FREQUENCY_MHZ = 3.0  # of the quick preset; at the paper's 8 MHz little of the attenuation map is left to see


def main() -> None:
    """Render the frame and write both pictures."""
    scene, probe, grid = fetal_abdomen(), ConvexProbe(frequency_mhz=FREQUENCY_MHZ), fetal_sites()
    planes, patient = fetal_planes(), jobs_of(SETTINGS)[0].settings.simulator
    settings, pose = with_patient_gain(scene, probe, patient, np.array(list(planes.values()))), planes[PLANE]
    frame = Simulator(scene, probe, settings).render(pose)
    write_panels(scene, probe, frame)
    title = f"sagittal plane of the {PLANE}"
    preview_figure(DOCS / "preview.png", title, scene, probe, pose, frame.image, frame.segmentation, grid)


def write_panels(scene: Scene, probe: ConvexProbe, frame: Frame) -> None:
    """Write frame.png: image, segmentation with the names of its tissues, and attenuation map, by depth in mm."""
    colours = np.concatenate([[(0.0, 0.0, 0.0)], tissue_colours(scene.tissues)])
    (height, width), top = fan_of(probe).size_mm, -fan_of(probe).sag_mm
    placed = {"extent": (-width / 2, width / 2, top + height, top), "interpolation": "antialiased"}
    with house_style():
        figure = Figure(figsize=(PAGE_IN, 0.4 * PAGE_IN))
        image, segmentation, attenuation = figure.subplots(
            1, 3, sharey=True, gridspec_kw={"left": 0.075, "right": 0.9, "top": 0.93, "bottom": 0.3, "wspace": 0.05}
        )
        image.imshow(frame.image, cmap="gray", vmin=0, vmax=255, **placed)
        segmentation.imshow(colours[frame.segmentation], **placed)
        shares = attenuation.imshow(frame.attenuation, cmap="gray", vmin=0, vmax=1, **placed)
        image.set_ylabel("depth (mm)")
        for axes, title in zip(figure.axes, ("B-mode image", "segmentation S", "attenuation map A"), strict=True):
            axes.set_title(title, pad=3)
            axes.set_xlabel("lateral (mm)")
            axes.set_xticks((-50, 0, 50))
        box = attenuation.get_position()
        figure.colorbar(shares, cax=figure.add_axes((0.91, box.y0, 0.012, box.height)), label="share of the sound left")
        seen = np.bincount(frame.segmentation.ravel())
        most_first = [i for i in np.argsort(-seen, kind="stable") if i and seen[i] > LEAST_SHARE * seen[1:].sum()]
        named = [Patch(facecolor=colours[i], label=scene.tissues[i - 1].name.replace("_", " ")) for i in most_first]
        figure.legend(
            handles=named, frameon=False, loc="lower center", ncols=7, handlelength=0.9, handleheight=0.9, fontsize=7
        )
        figure.savefig(DOCS / "frame.png", dpi=PNG_DPI)


if __name__ == "__main__":
    main()
