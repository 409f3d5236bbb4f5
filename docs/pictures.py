"""The simulated frame that README shows: image, segmentation and attenuation map side by side, at the paper's size.

python docs/pictures.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from skimage.color import hsv2rgb
from skimage.io import imsave
from skimage.transform import resize

from ablate.anatomy import fetal_abdomen, fetal_sites
from ablate.dataset import probe_poses
from ablate.ultrasound import ConvexProbe, Simulator

HERE = Path(__file__).parent
HEIGHT_MM, ANGLE_DEG, TILT_DEG, ROLL_DEG = -15.0, 36.0, 0.0, 90.0
FREQUENCY_MHZ = 3.0  # of the quick preset; at the paper's 8 MHz little of the attenuation map is left to see


def main() -> None:
    """Render and write frame.png beside this file."""
    scene, grid = fetal_abdomen(), fetal_sites()
    poses = probe_poses(scene, grid, press_mm=8)
    per_angle = len(grid.tilts_deg) * len(grid.rolls_deg)
    place = grid.heights_mm.index(HEIGHT_MM) * len(grid.angles_deg) + grid.angles_deg.index(ANGLE_DEG)
    turn = grid.tilts_deg.index(TILT_DEG) * len(grid.rolls_deg) + grid.rolls_deg.index(ROLL_DEG)
    frame = Simulator(scene, ConvexProbe(frequency_mhz=FREQUENCY_MHZ)).render(
        poses[place * per_angle + turn].probe_to_world
    )
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
