"""Features of the 2015 Inception network: the only ones whose Frechet distance may be called FID."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import torch

CENTRE, CROP = 512, 299

# inception-2015-12-05.pt, the TorchScript translation of TensorFlow's network published with StyleGAN2-ADA at
# https://nvlabs-fi-cdn.nvidia.com/stylegan2-ada-pytorch/pretrained/metrics/
INCEPTION_SHA256 = "f58cb9b6ec323ed63459aa4fb441fe750cfe39fafad6da5cb504a16f19e958f4"


def four_crops(images: np.ndarray) -> np.ndarray:
    """The four corner crops of 299 px of each image's 512 px centre; they overlap by 86 px (the paper).

    Parameters
    ----------
    images : (n, H, W) uint8
        Grey levels, H and W at least 512.

    Returns
    -------
    (4 n, 299, 299) uint8
        Image by image; no resampling takes place.

    Raises
    ------
    ValueError
        When an image is smaller than 512 px or not uint8.
    """
    if images.ndim != 3 or images.dtype != np.uint8:
        raise ValueError(f"images must be (n, H, W) uint8, got {images.shape} {images.dtype}")
    count, height, width = images.shape
    if min(height, width) < CENTRE:
        raise ValueError(f"FID cuts {CENTRE} px centres; images of {height} x {width} px are too small")
    top, left = (height - CENTRE) // 2, (width - CENTRE) // 2
    starts = (0, CENTRE - CROP)
    crops = [images[:, top + i : top + i + CROP, left + j : left + j + CROP] for i in starts for j in starts]
    return np.stack(crops, axis=1).reshape(4 * count, CROP, CROP)


def inception_features(
    images: np.ndarray,
    path: str | Path,
    batch: int = 16,
    device: str = "cpu",
    sha256: str = INCEPTION_SHA256,
) -> np.ndarray:
    """Pool features of Inception on four crops an image; the grey channel is repeated three times.

    Parameters
    ----------
    images : (n, H, W) uint8
        Grey levels, at least 512 px each way.
    path : str or Path
        TorchScript file; called as `module(x, return_features=True)` with x (b, 3, 299, 299) uint8.
    batch : int
        Crops at a time.
    device : str
        Where the network runs.
    sha256 : str
        Digest that the file must have.

    Returns
    -------
    (4 n, d) float64
        d = 2048 for the published file.

    Raises
    ------
    FileNotFoundError
        When there is no such file.
    ValueError
        When its digest is another, or the images do not fit.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no Inception weights at {path}")
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    if digest != sha256:
        raise ValueError(f"{path} has SHA-256 {digest[:12]}…, expected {sha256[:12]}…: not the network of FID")
    crops = torch.from_numpy(four_crops(images))[:, None]
    module = torch.jit.load(str(path), map_location=device).eval()
    with torch.inference_mode():
        features = [
            module(part.to(device).expand(-1, 3, -1, -1), return_features=True).double().cpu()
            for part in crops.split(batch)
        ]
    return torch.cat(features).numpy() if features else np.zeros((0, 0))
