"""What a per-image metric reads: a rendered image beside its target, and the maps of its frame."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ablate.metrics.patches import check_pair, patch_chi2


@dataclass(frozen=True, eq=False)
class Pair:
    """A prediction beside its target and the maps of the frame; raises ValueError when shapes or dtypes do not fit.

    The arrays are views that cannot be written to: what one metric changed, all later ones would read.

    Attributes
    ----------
    prediction, target : (H, W) uint8
        Grey levels.
    mask : (H, W) bool
        The fan.
    tissue_mask : (H, W) bool, optional
        Pixels of tissue; fluid, gas and the outside are False.
    attenuation : (H, W) float in [0, 1], optional
        The integral attenuation map.
    depth_mm : (H, W) float, mm, optional
        Distance from the probe's face along the scanline.
    segmentation : (H, W) uint8, optional
        Tissue labels.
    bone_mask : (H, W) bool, optional
        Pixels of bone.
    pixel_mm : (float, float), mm, optional
        Height and width of a pixel.
    draws : (k >= 2, H, W) uint8, optional
        The prediction, and the same frame with other draws of the generator's noise.
    """

    prediction: np.ndarray
    target: np.ndarray
    mask: np.ndarray
    tissue_mask: np.ndarray | None = None
    attenuation: np.ndarray | None = None
    depth_mm: np.ndarray | None = None
    segmentation: np.ndarray | None = None
    bone_mask: np.ndarray | None = None
    pixel_mm: tuple[float, float] | None = None
    draws: np.ndarray | None = None

    def __post_init__(self) -> None:
        check_pair(self.prediction, self.target)
        shape = self.target.shape
        for name, array in vars(self).items():
            if isinstance(array, np.ndarray):
                if name == "draws" and (array.shape[1:] != shape or len(array) < 2):
                    raise ValueError(f"draws must be (k >= 2, {shape[0]}, {shape[1]}), got {array.shape}")
                if name != "draws" and array.shape != shape:
                    raise ValueError(f"{name} must be {shape}, got {array.shape}")
                view = array.view()
                view.flags.writeable = False
                object.__setattr__(self, name, view)

    @cached_property
    def chi2_map(self) -> np.ndarray:
        """(H // 20, W // 20) float: patch chi-square map, computed once."""
        chi2 = patch_chi2(self.prediction, self.target)
        chi2.flags.writeable = False
        return chi2
