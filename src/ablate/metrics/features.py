"""What Frechet and kernel distances compare: a description of speckle texture that needs no weights, and Inception's.

The features of the Inception network of 2015 are the only ones whose Frechet distance may be called FID.
"""

import hashlib
import os
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.fft import rfft2

from ablate.metrics.distances import frechet_distance, kernel_distance
from ablate.metrics.metric import Direction, FeatureKind, Group, Metric, Resimulation, SetDistance, Shown
from ablate.metrics.patches import as_patches, patches_inside, value_counts
from ablate.storage import held

PATCH = 48
QUANTILES = (0.05, 0.25, 0.50, 0.75, 0.95)
LAGS_PX = (1, 2, 4)
BAND_EDGES = (1 / 24, 1 / 12, 1 / 6, 1 / 3, 1 / np.sqrt(2.0))  # cycles/px, octaves

# One unit of each feature is about one standard deviation between patches of different tissue, so that no
# feature rules the distance. Fixed, so that values of two studies can be compared.
GREY_UNIT = 48.0
GRADIENT_UNIT = 4.0  # grey levels
CORRELATION_UNIT = 0.4
LOG10_POWER_UNIT = 0.75
FRACTION_UNIT = 0.2
QUANTISATION_VARIANCE = 1.0 / 12.0  # grey levels^2, of rounding to 8 bits; keeps flat patches finite

# Rows and columns of the neighbours of a pixel within 3 x 3, around the circle.
_NEIGHBOURS = ((0, 1), (0, 2), (1, 2), (2, 2), (2, 1), (2, 0), (1, 0), (0, 0))

# Pattern of each code, whose 8 bits tell which neighbours are at least as bright: the number of these bits where they
# change at most twice around the circle, and 9 elsewhere.
_BITS = np.arange(256)[:, None] >> np.arange(8) & 1
_CHANGES = np.count_nonzero(_BITS != np.roll(_BITS, 1, axis=1), axis=1)
_PATTERN_OF_CODE = np.where(_CHANGES <= 2, _BITS.sum(axis=1), 9).astype(np.uint8)

FEATURE_NAMES: tuple[str, ...] = (
    "mean",
    "sd",
    "skewness",
    "kurtosis",
    *(f"quantile_{100 * q:.0f}" for q in QUANTILES),
    *(f"correlation_lateral_{lag}px" for lag in LAGS_PX),
    *(f"correlation_axial_{lag}px" for lag in LAGS_PX),
    "gradient_lateral",
    "gradient_axial",
    *(f"band_{direction}_{k}" for direction in ("lateral", "axial") for k in range(4)),
    *(f"lbp_{k}" for k in range(10)),
)

CENTRE, CROP = 512, 299

# TorchScript translation of TensorFlow's network of 2015-12-05, published with StyleGAN2-ADA; it takes grey levels of
# 0 to 255 and scales them itself. The digest is the one k-diffusion and others pin.
INCEPTION_URL = "https://nvlabs-fi-cdn.nvidia.com/stylegan2-ada-pytorch/pretrained/metrics/inception-2015-12-05.pt"
INCEPTION_SHA256 = "f58cb9b6ec323ed63459aa4fb441fe750cfe39fafad6da5cb504a16f19e958f4"

# (n, H, W) uint8 -> (4 n, d) float64, image by image
InceptionFeatures = Callable[[np.ndarray], np.ndarray]


def _moments(patches: np.ndarray) -> np.ndarray:
    """(n, 9): mean, sd, log skewness and kurtosis, and quantiles of patches (n, PATCH * PATCH) uint8."""
    counts = value_counts(patches, 256)
    levels = np.arange(256.0)
    pixels = patches.shape[1]
    mean = counts @ levels / pixels
    centred = levels - mean[:, None]
    squared = centred * centred
    second = np.einsum("ij,ij->i", counts, squared) / pixels
    third = np.einsum("ij,ij,ij->i", counts, squared, centred) / pixels
    fourth = np.einsum("ij,ij,ij->i", counts, squared, squared) / pixels
    variance = second + QUANTISATION_VARIANCE
    # A single bright pixel in a black patch has a kurtosis of thousands: both are taken as logarithms.
    cubed = third / variance**1.5
    skewness = np.sign(cubed) * np.log1p(np.abs(cubed))
    kurtosis = np.log1p(fourth / variance**2)
    quantiles = np.quantile(patches, QUANTILES, axis=1).T
    return np.column_stack([mean / GREY_UNIT, np.sqrt(variance) / GREY_UNIT, skewness, kurtosis, quantiles / GREY_UNIT])


def _spatial(x: np.ndarray) -> np.ndarray:
    """(n, 8): autocorrelation and mean absolute gradient, laterally and axially, of (n, PATCH, PATCH)."""
    centred = x - x.mean(axis=(1, 2), keepdims=True)
    variance = np.einsum("nij,nij->n", centred, centred) / PATCH**2 + QUANTISATION_VARIANCE
    columns = []
    for along_rows in (centred, centred.swapaxes(1, 2)):
        for lag in LAGS_PX:
            products = np.einsum("nij,nij->n", along_rows[..., lag:], along_rows[..., :-lag])
            columns.append(products / (PATCH * (PATCH - lag)) / variance / CORRELATION_UNIT)
    for axis in (2, 1):
        columns.append(np.abs(np.diff(x, axis=axis)).mean(axis=(1, 2)) / GRADIENT_UNIT)
    return np.column_stack(columns)


def _band_powers(x: np.ndarray) -> np.ndarray:
    """(n, 8): log10 power in four octaves, nearer to the lateral or to the axial frequency axis."""
    window = np.outer(np.hanning(PATCH), np.hanning(PATCH))
    tapered = (x - x.mean(axis=(1, 2), keepdims=True)) * window
    power = np.abs(rfft2(tapered)) ** 2 / np.square(window).sum()
    axial = np.abs(np.fft.fftfreq(PATCH))[:, None]
    lateral = np.fft.rfftfreq(PATCH)[None, :]
    octave = np.digitize(np.hypot(axial, lateral), BAND_EDGES) - 1
    columns = []
    for side in (lateral >= axial, axial > lateral):
        for k in range(len(BAND_EDGES) - 1):
            band = power[:, side & (octave == k)].mean(axis=1)
            columns.append(np.log10(band + QUANTISATION_VARIANCE) / LOG10_POWER_UNIT)
    return np.column_stack(columns)


def _local_binary_patterns(image: np.ndarray) -> np.ndarray:
    """(H, W) uint8: rotation-invariant uniform pattern of the 8 neighbours (Ojala et al. 2002)."""
    padded = np.pad(image, 1, mode="edge")
    height, width = image.shape
    codes = np.zeros(image.shape, np.uint8)
    for bit, (i, j) in enumerate(_NEIGHBOURS):
        codes |= (padded[i : i + height, j : j + width] >= image).view(np.uint8) << np.uint8(bit)
    return _PATTERN_OF_CODE[codes]


def speckle_features(images: np.ndarray, mask: np.ndarray | None = None) -> np.ndarray:
    """Describe the texture of every 48 x 48 px patch that lies wholly inside the fan by the 35 `FEATURE_NAMES`.

    Parameters
    ----------
    images : (n, H, W) uint8
        Grey levels.
    mask : (H, W) bool, optional
        The fan; without it every patch counts.

    Returns
    -------
    (n * patches, 35) float64
        Image by image, patches in reading order: row k belongs to image k // patches.

    Raises
    ------
    ValueError
        When no patch lies inside the mask.
    """
    mask = np.ones(images.shape[1:], bool) if mask is None else mask
    if images.dtype != np.uint8 or mask.shape != images.shape[1:]:
        raise ValueError(f"images must be (n, H, W) uint8 and the mask (H, W), got {images.dtype} and {mask.shape}")
    inside = patches_inside(mask, PATCH)
    if not inside.any():
        raise ValueError(f"no patch of {PATCH} x {PATCH} px lies wholly inside the mask; FD speckle needs a larger one")
    rows = [np.zeros((0, len(FEATURE_NAMES)))]
    for image in images:
        flat = as_patches(image, PATCH)[inside]
        patterns = as_patches(_local_binary_patterns(image), PATCH)[inside]
        square = flat.reshape(-1, PATCH, PATCH).astype(np.float64)
        histogram = value_counts(patterns, 10) / PATCH**2 / FRACTION_UNIT
        rows.append(np.hstack((_moments(flat), _spatial(square), _band_powers(square), histogram)))
    return np.concatenate(rows)


def inception_file(where: str) -> Path:
    """The network's file, downloaded if need be, and known to be the one.

    Parameters
    ----------
    where : str
        Path of the file, or `download`: `inception-2015-12-05.pt` in `$XDG_CACHE_HOME/ablate` (`~/.cache/ablate`),
        fetched once (91 MiB). Several processes may ask at the same time.

    Raises
    ------
    FileNotFoundError
        When there is no such file.
    ConnectionError
        When it cannot be downloaded; the message says from where.
    ValueError
        When its SHA-256 is another than `INCEPTION_SHA256`.
    """
    if where == "download":
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "ablate"
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / INCEPTION_URL.rpartition("/")[2]
        with held(path.with_suffix(".lock"), "downloads the Inception weights"):
            if not path.exists():
                _download(path)
    else:
        path = Path(where).expanduser()
    if not path.is_file():
        raise FileNotFoundError(f"no Inception weights at {path}")
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    if digest != INCEPTION_SHA256:
        expected = INCEPTION_SHA256[:12]
        raise ValueError(f"{path} has SHA-256 {digest[:12]}..., expected {expected}...: not the network of FID")
    return path


def _download(path: Path) -> None:
    from torch.hub import download_url_to_file  # only here, as in `load_inception`

    try:
        download_url_to_file(INCEPTION_URL, str(path), INCEPTION_SHA256)
    except OSError as error:
        message = f"{INCEPTION_URL} cannot be downloaded: {error}; give the path of the file"
        raise ConnectionError(message) from error
    except RuntimeError as error:
        raise ValueError(f"{INCEPTION_URL} has another SHA-256: {error}") from error


def load_inception(path: Path, device: str = "cpu", batch: int = 16) -> InceptionFeatures:
    """The network as a function of images.

    Features are those of the pool layer, of the corner crops, of 299 px, of each image's 512 px centre, the grey
    channel repeated three times.

    Parameters
    ----------
    path : Path
        From `inception_file`: TorchScript, called as `module(x, return_features=True)` with x (b, 3, 299, 299) uint8.
    device : str
        Where it computes, as torch names devices.
    batch : int
        Crops at a time.

    Returns
    -------
    callable
        Of (n, H, W) uint8 with at least 512 px a side; (4 n, 2048) float64, image by image.
    """
    import torch  # only here: every other metric does without it

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*torch.jit.load.*", category=DeprecationWarning)
        module = torch.jit.load(str(path), map_location=device).eval()

    def features(images: np.ndarray) -> np.ndarray:
        if images.dtype != np.uint8:
            raise ValueError(f"images must be uint8, got {images.dtype}")
        top, left = ((size - CENTRE) // 2 for size in images.shape[1:])
        rows = [slice(first, first + CROP) for first in (top, top + CENTRE - CROP)]
        columns = [slice(first, first + CROP) for first in (left, left + CENTRE - CROP)]
        crops = [images[:, row, column] for row in rows for column in columns]
        grey = torch.from_numpy(np.stack(crops, axis=1).reshape(-1, 1, CROP, CROP))
        with torch.inference_mode():
            parts = [module(c.to(device).expand(-1, 3, -1, -1), return_features=True) for c in grey.split(batch)]
        return torch.cat(parts).double().cpu().numpy()

    return features


FD_SPECKLE = Metric(
    name="fd_speckle",
    label="FD speckle",
    better=Direction.lower,
    resimulation=Resimulation.floor,
    group=Group.set,
    decimals=2,
    shown=Shown.everywhere,
    of_set=SetDistance(features=FeatureKind.speckle, distance=frechet_distance),
    place=40,
)
KD_SPECKLE = Metric(
    name="kd_speckle",
    label="KD speckle",
    better=Direction.lower,
    resimulation=Resimulation.floor,
    group=Group.set,
    decimals=3,
    of_set=SetDistance(features=FeatureKind.speckle, distance=kernel_distance),
    place=41,
)
# Of 2048 features each resample takes seconds.
FID = Metric(
    name="fid",
    label="FID",
    better=Direction.lower,
    resimulation=Resimulation.floor,
    group=Group.set,
    decimals=2,
    shown=Shown.table | Shown.report,
    of_set=SetDistance(features=FeatureKind.inception, distance=frechet_distance, resamples=100),
    place=42,
)
KID = Metric(
    name="kid",
    label="KID",
    better=Direction.lower,
    resimulation=Resimulation.floor,
    group=Group.set,
    decimals=3,
    of_set=SetDistance(features=FeatureKind.inception, distance=kernel_distance),
    place=43,
)
