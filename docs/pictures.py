"""The pictures of one simulated frame, at the paper's size: image, segmentation and attenuation map side by side
(frame.png), and the probe that saw it on the body in 3-D, as `task=preview` draws it (preview.png).

python docs/pictures.py
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from skimage.color import hsv2rgb
from skimage.io import imsave
from skimage.transform import resize

from ablate.analysis import Preview, preview_figure
from ablate.anatomy import fetal_abdomen, fetal_sites
from ablate.dataset import probe_poses
from ablate.ultrasound import ConvexProbe, Frame, Simulator

HERE = Path(__file__).parent
HEIGHT_MM, ANGLE_DEG, TILT_DEG, ROLL_DEG = -15.0, 36.0, 0.0, 90.0
FREQUENCY_MHZ = 3.0  # of the quick preset; at the paper's 8 MHz little of the attenuation map is left to see


def main() -> None:
    """Render and write both beside this file."""
    scene, probe = fetal_abdomen(), ConvexProbe(frequency_mhz=FREQUENCY_MHZ)
    grid = replace(
        fetal_sites(), heights_mm=(HEIGHT_MM,), angles_deg=(ANGLE_DEG,), tilts_deg=(TILT_DEG,), rolls_deg=(ROLL_DEG,)
    )
    (pose,) = (p.probe_to_world for p in probe_poses(scene, grid, press_mm=8))
    frame = Simulator(scene, probe).render(pose)
    write_panels(frame)
    title = f"height {HEIGHT_MM:g} mm, angle {ANGLE_DEG:g}°, roll {ROLL_DEG:g}°"
    shown = Preview(title, pose, frame.image, frame.segmentation, grid.axis, grid.front)
    preview_figure(scene, probe, shown, HERE / "preview.png")


def write_panels(frame: Frame) -> None:
    """Write frame.png: image, segmentation and attenuation map."""
    hues = np.arange(256) * 0.381966 % 1
    colours = hsv2rgb(np.stack([hues, np.full(256, 0.5), np.full(256, 0.85)], axis=-1))
    colours[0] = 0
    panels = [
        np.repeat(frame.image[..., None] / 255, 3, axis=2),
        colours[frame.segmentation],
        np.repeat(frame.attenuation[..., None], 3, axis=2),
    ]
    small = [resize(panel, (500, 693), anti_aliasing=True) for panel in panels]
    imsave(HERE / "frame.png", (np.concatenate(small, axis=1) * 255).astype(np.uint8), check_contrast=False)


if __name__ == "__main__":
    main()
