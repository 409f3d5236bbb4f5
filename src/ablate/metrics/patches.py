"""Small patches of images: their histograms, and the chi-square distance between those of two images."""

import numpy as np

PEAK = 255.0


def check_pair(a: np.ndarray, b: np.ndarray, mask: np.ndarray | None = None) -> None:
    """Raise ValueError unless `a` and `b` are (H, W) uint8 and `mask`, (H, W) bool, leaves a pixel to compare."""
    for name, image in (("a", a), ("b", b)):
        if image.dtype != np.uint8 or image.ndim != 2 or isinstance(image, np.ma.MaskedArray):
            raise ValueError(f"{name} must be (H, W) uint8, got {image.shape} {type(image).__name__} {image.dtype}")
    if a.shape != b.shape:
        raise ValueError(f"images must have one shape, got {a.shape} and {b.shape}")
    if mask is not None and (mask.dtype != np.bool_ or mask.shape != a.shape):
        raise ValueError(f"mask must be {a.shape} bool, got {mask.shape} {mask.dtype}")
    if a.size == 0 or (mask is not None and not mask.any()):
        raise ValueError("no pixel to compare: the image or the mask is empty")


def as_patches(image: np.ndarray, patch: int) -> np.ndarray:
    """Cut an image (H, W) into squares of `patch` px, (H // patch, W // patch, patch * patch); the rest is cropped."""
    rows = image.shape[0] // patch
    columns = image.shape[1] // patch
    squares = image[: rows * patch, : columns * patch].reshape(rows, patch, columns, patch)
    return squares.swapaxes(1, 2).reshape(rows, columns, patch * patch)


def patches_inside(mask: np.ndarray, patch: int = 20) -> np.ndarray:
    """Which patches of `patch` px lie wholly inside a mask (H, W) bool: (H // patch, W // patch) bool."""
    return np.asarray(as_patches(mask, patch).all(axis=-1))


def value_counts(patches: np.ndarray, values: int) -> np.ndarray:
    """How often each value occurs in each patch, (..., values) int64, of (..., pixels) uint8 under `values`."""
    flat = patches.reshape(-1, patches.shape[-1])
    first = np.arange(len(flat), dtype=np.int32)[:, None] * np.int32(values)
    counts = np.bincount((flat + first).ravel(), minlength=len(flat) * values)
    return counts.reshape(*patches.shape[:-1], values)


def patch_counts(image: np.ndarray, patch: int, bins: int) -> np.ndarray:
    """Histograms (H // patch, W // patch, bins) int64 of the patches of an image (H, W) uint8.

    The bins are those of `linspace(0, 255, bins + 1)`, the last one closed, as `numpy.histogram` has them.
    """
    edges = np.linspace(0.0, PEAK, bins + 1)
    bin_of_level = np.minimum(np.searchsorted(edges, np.arange(256), side="right") - 1, bins - 1).astype(np.uint8)
    return value_counts(as_patches(bin_of_level.take(image), patch), bins)


def patch_chi2(a: np.ndarray, b: np.ndarray, patch: int = 20, bins: int = 50) -> np.ndarray:
    """Chi-square distance between the patch histograms of two images.

    chi2 = 1/2 sum (h_a - h_b)^2 / (h_a + h_b) with h of sum 1 over `linspace(0, 255, bins + 1)`, the last bin closed,
    and 0/0 = 0 (Zhang et al., quantitative evaluation, where range, normalisation and remainder are open).

    Parameters
    ----------
    a, b : (H, W) uint8
        Grey levels.
    patch : int
        Side of the non-overlapping patches, px; remainder rows and columns are cropped.
    bins : int
        Histogram bins, 1 to 256.

    Returns
    -------
    (H // patch, W // patch) float64 in [0, 1]
        0 where the histograms agree, 1 where they share no bin.

    Raises
    ------
    ValueError
        When shapes or dtypes do not fit, or patch or bins are out of range.
    """
    check_pair(a, b)
    if patch < 1:
        raise ValueError(f"patch must be at least 1 px, got {patch}")
    if not 1 <= bins <= 256:
        raise ValueError(f"bins must be 1 to 256, got {bins}")
    counts_a = patch_counts(a, patch, bins)
    counts_b = patch_counts(b, patch, bins)
    difference = (counts_a - counts_b).astype(np.float64)
    total = counts_a + counts_b
    # Where total is 0 so is the difference: dividing by 1 gives the 0 wanted.
    terms = difference * difference / np.maximum(total, 1)
    return terms.sum(axis=-1) / (2.0 * patch * patch)


def rms(chi2_map: np.ndarray, patches: np.ndarray | None = None) -> float | None:
    """Root mean square of a patch map (h, w), the figure that is reported for patch chi-square.

    Only `patches`, (h, w) bool as from `patches_inside`, count if they are given. It is None when no patch counts.
    """
    values = chi2_map.ravel() if patches is None else chi2_map[patches]
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else None
