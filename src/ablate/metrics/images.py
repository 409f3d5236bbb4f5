"""What metrics ask of images: two of them with one shape, and maps that fit."""

import numpy as np

PEAK = 255.0


def check_pair(a: np.ndarray, b: np.ndarray, mask: np.ndarray | None = None) -> None:
    """Raise ValueError unless `a` and `b` are (H, W) uint8 and `mask`, (H, W) bool, leaves a pixel to compare."""
    for name, image in (("a", a), ("b", b)):
        if image.dtype != np.uint8 or image.ndim != 2:
            raise ValueError(f"image {name} must be (H, W) uint8, got {image.shape} {image.dtype}")
    if a.shape != b.shape:
        raise ValueError(f"images must have one shape, got {a.shape} and {b.shape}")
    if mask is not None and (mask.dtype != np.bool_ or mask.shape != a.shape):
        raise ValueError(f"mask must be {a.shape} bool, got {mask.shape} {mask.dtype}")
    if a.size == 0 or (mask is not None and not mask.any()):
        raise ValueError("no pixel to compare: the image or the mask is empty")


def check_shapes(target: np.ndarray, /, **maps: np.ndarray | None) -> None:
    """Raise ValueError unless every map that is given has the shape of `target`."""
    for name, array in maps.items():
        if array is not None and array.shape != target.shape:
            raise ValueError(f"{name} must be {target.shape}, got {array.shape}")
