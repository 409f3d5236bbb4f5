"""Pictures of speckle in a fan with known shadows, for tests of the metrics."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from ablate.metrics import Pair

RADIUS_MM, HALF_FOV, DEPTH_MM = 40.0, np.deg2rad(35.0), 150.0


@dataclass(frozen=True, eq=False)
class SyntheticFrame:
    image: np.ndarray
    mask: np.ndarray
    tissue: np.ndarray
    attenuation: np.ndarray
    depth_mm: np.ndarray
    shadow: np.ndarray
    enhanced: np.ndarray
    labels: np.ndarray
    bone: np.ndarray
    pixel_mm: tuple[float, float]

    def pair(self, prediction, **changes):
        """A prediction beside this frame and all its maps."""
        maps = {"target": self.image, "mask": self.mask, "tissue_mask": self.tissue, "attenuation": self.attenuation}
        maps |= {"depth_mm": self.depth_mm, "segmentation": self.labels, "bone_mask": self.bone}
        return Pair(prediction, **(maps | {"pixel_mm": self.pixel_mm} | changes))


def synthetic_frame(seed=0, shape=(250, 346), shadow_grey=-70.0, enhanced_grey=40.0):
    """Log-compressed speckle of mean 120 grey levels, with one shadow, one enhancement, a fluid disc and three ribs.

    The ribs are bright where they face the probe and dark inside. Label 1 is fluid, 2 tissue above 90 mm, 3 below, and
    4 bone.
    """
    width = 2 * (RADIUS_MM + DEPTH_MM) * np.sin(HALF_FOV)
    height = RADIUS_MM + DEPTH_MM - RADIUS_MM * np.cos(HALF_FOV)
    x = (np.arange(shape[1]) + 0.5) * width / shape[1] - width / 2
    z = (np.arange(shape[0]) + 0.5) * height / shape[0] - RADIUS_MM * (1 - np.cos(HALF_FOV))
    x, z = np.meshgrid(x, z)
    radius, angle = np.hypot(x, z + RADIUS_MM), np.arctan2(x, z + RADIUS_MM)
    mask = (np.abs(angle) <= HALF_FOV) & (radius >= RADIUS_MM) & (radius <= RADIUS_MM + DEPTH_MM)
    depth = np.where(mask, radius - RADIUS_MM, 0.0)
    shadow = mask & (np.abs(angle + 0.2) < 0.08) & (depth > 60)
    enhanced = mask & (np.abs(angle - 0.2) < 0.08) & (depth > 60)
    fluid = np.hypot(x - 35, z - 40) < 12

    bone, bright = np.zeros(shape, bool), np.zeros(shape, bool)
    for centre in ((-55, 75), (0, 50), (60, 100)):
        from_centre = np.hypot(x - centre[0], z - centre[1])
        bone |= from_centre < 6
        bright |= (from_centre < 6) & (np.hypot(x - centre[0], z - centre[1] - 2) >= 6)

    rng = np.random.default_rng(seed)
    real, imaginary = (gaussian_filter(rng.standard_normal(shape), (0.8, 1.4)) for _ in range(2))
    speckle = np.hypot(real, imaginary)
    grey = 120 + 255 / 60 * 20 * np.log10(speckle / np.sqrt(np.mean(speckle**2)) + 1e-6)
    grey = np.where(fluid, 5 + 2 * rng.random(shape), grey)
    grey = np.where(bone, grey - 60, grey) + np.where(bright, 120, 0)
    grey = grey + np.where(shadow, shadow_grey, 0) + np.where(enhanced, enhanced_grey, 0)
    attenuation = np.exp(-depth / 50) * np.where(shadow, 0.2, np.where(enhanced, 2.0, 1.0)) * mask
    return SyntheticFrame(
        image=(np.clip(grey, 0, 255) * mask).astype(np.uint8),
        mask=mask,
        tissue=mask & ~fluid,
        attenuation=np.minimum(attenuation, 1.0).astype(np.float32),
        depth_mm=depth.astype(np.float32),
        shadow=shadow,
        enhanced=enhanced,
        labels=np.select([~mask, fluid, bone, depth < 90], [0, 1, 4, 2], 3).astype(np.uint8),
        bone=bone & mask,
        pixel_mm=(height / shape[0], width / shape[1]),
    )


@pytest.fixture(scope="session")
def make_frame():
    """`synthetic_frame` itself: one seed, one picture."""
    return synthetic_frame
