"""Draw one simulated frame at the paper's size, in two pictures.

docs/frame.png shows image, segmentation and attenuation map side by side. docs/preview.png shows the probe on the body
in 3-D, as `task=preview` draws it.

python scripts/pictures.py
"""

from pathlib import Path

import numpy as np
from skimage.io import imsave
from skimage.transform import resize

from ablate.analysis import preview_figure
from ablate.analysis.figures.scene_parts import tissue_colours
from ablate.anatomy import Scene, fetal_abdomen, fetal_planes, fetal_sites
from ablate.ultrasound import ConvexProbe, Frame, Simulator, SimulatorSettings, TimeGain, with_patient_gain

DOCS = Path(__file__).parents[1] / "docs"
PLANE = "spine"
FREQUENCY_MHZ = 3.0  # of the quick preset; at the paper's 8 MHz little of the attenuation map is left to see


def main() -> None:
    """Render the frame and write both pictures."""
    scene, probe, grid = fetal_abdomen(), ConvexProbe(frequency_mhz=FREQUENCY_MHZ), fetal_sites()
    planes, patient = fetal_planes(), SimulatorSettings(tgc=TimeGain.patient)
    settings, pose = with_patient_gain(scene, probe, patient, np.array(list(planes.values()))), planes[PLANE]
    frame = Simulator(scene, probe, settings).render(pose)
    write_panels(scene, frame)
    title = f"sagittal plane of the {PLANE}"
    preview_figure(DOCS / "preview.png", title, scene, probe, pose, frame.image, frame.segmentation, grid)


def write_panels(scene: Scene, frame: Frame) -> None:
    """Write frame.png: image, segmentation and attenuation map."""
    colours = np.concatenate([[(0.0, 0.0, 0.0)], tissue_colours(scene.tissues)])
    panels = [
        np.repeat(frame.image[..., None] / 255, 3, axis=2),
        colours[frame.segmentation],
        np.repeat(frame.attenuation[..., None], 3, axis=2),
    ]
    small = [resize(panel, (500, 693), anti_aliasing=True) for panel in panels]
    imsave(DOCS / "frame.png", (np.concatenate(small, axis=1) * 255).astype(np.uint8), check_contrast=False)


if __name__ == "__main__":
    main()
