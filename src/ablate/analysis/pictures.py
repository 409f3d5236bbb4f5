"""What was rendered of a test frame, beside its target and maps."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class FramePictures:
    """The images of one test frame, as figures show them.

    Attributes
    ----------
    name : str
        Stands beside its pictures.
    target : (H, W) uint8
        Grey levels.
    predictions : dict of str to (H, W) uint8
        By variant, in the order shown, after the re-simulation under its own name.
    mask : (H, W) bool
        The fan.
    segmentation : (H, W) uint8
        Labels, shown in a corner of the target.
    attenuation : (H, W) float in [0, 1], optional
        The integral attenuation map; its shadows are shown in the other corner.
    """

    name: str
    target: np.ndarray
    predictions: dict[str, np.ndarray]
    mask: np.ndarray
    segmentation: np.ndarray
    attenuation: np.ndarray | None = None
