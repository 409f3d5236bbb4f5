"""Features of the 2015 Inception network: the only ones whose Frechet distance may be called FID."""

import hashlib
import os
import shutil
import urllib.request
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from filelock import FileLock
from tqdm import tqdm

from ablate.metrics.distances import frechet_distance, kernel_distance
from ablate.metrics.metric import Direction, FeatureKind, Group, Metric, Resimulation, SetDistance, Shown
from ablate.storage import written_whole

CENTRE, CROP = 512, 299

# TorchScript translation of TensorFlow's network of 2015-12-05, published with StyleGAN2-ADA; it takes grey levels of
# 0 to 255 and scales them itself. The digest is the one k-diffusion and others pin.
INCEPTION_URL = "https://nvlabs-fi-cdn.nvidia.com/stylegan2-ada-pytorch/pretrained/metrics/inception-2015-12-05.pt"
INCEPTION_SHA256 = "f58cb9b6ec323ed63459aa4fb441fe750cfe39fafad6da5cb504a16f19e958f4"

# (n, H, W) uint8 -> (4 n, d) float64, image by image
InceptionFeatures = Callable[[np.ndarray], np.ndarray]


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
        with FileLock(path.with_suffix(".lock")):
            if not path.exists():
                _download(path)
    else:
        path = Path(where).expanduser()
    if not path.is_file():
        raise FileNotFoundError(f"no Inception weights at {path}")
    _check_digest(path)
    return path


def _download(path: Path) -> None:
    with written_whole(path) as partial:
        try:
            with urllib.request.urlopen(INCEPTION_URL, timeout=60) as response, partial.open("wb") as file:
                size = int(response.headers.get("Content-Length") or 0) or None
                bar = tqdm.wrapattr(response, "read", total=size, desc=path.name, unit_scale=True, disable=None)
                with bar as stream:
                    shutil.copyfileobj(stream, file)
        except OSError as error:
            why = f"{INCEPTION_URL} cannot be downloaded: {error}; give the path of the file"
            raise ConnectionError(why) from error
        _check_digest(partial)


def _check_digest(path: Path) -> None:
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    if digest != INCEPTION_SHA256:
        raise ValueError(
            f"{path} has SHA-256 {digest[:12]}..., expected {INCEPTION_SHA256[:12]}...: not the network of FID"
        )


def load_inception(path: Path, device: str = "cpu", batch: int = 16) -> InceptionFeatures:
    """The network as a function of images, (n, H, W) uint8 with at least 512 px a side -> (4 n, 2048) float64.

    These are the pool features of the corner crops, of 299 px, of each image's 512 px centre, the grey channel repeated
    three times; `batch` of them are computed at a time. The file, from `inception_file`, is TorchScript, called as
    `module(x, return_features=True)` with x (b, 3, 299, 299) uint8.
    """
    import torch  # only here: every other metric does without it

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*torch.jit.load.*", category=DeprecationWarning)
        module = torch.jit.load(str(path), map_location=device).eval()

    def features(images: np.ndarray) -> np.ndarray:
        top, left = ((size - CENTRE) // 2 for size in images.shape[1:])
        starts = (0, CENTRE - CROP)
        crops = [images[:, top + i : top + i + CROP, left + j : left + j + CROP] for i in starts for j in starts]
        grey = torch.from_numpy(np.stack(crops, axis=1).reshape(-1, 1, CROP, CROP))
        with torch.inference_mode():
            parts = [module(c.to(device).expand(-1, 3, -1, -1), return_features=True) for c in grey.split(batch)]
        return torch.cat(parts).double().cpu().numpy()

    return features


_FLOOR = ("", Direction.lower, Resimulation.floor, Group.set)
FID = Metric(
    *("fid", "FID", *_FLOOR, 2, Shown.table | Shown.report),
    of_set=SetDistance(FeatureKind.inception, frechet_distance, resamples=100),  # of 2048 features each takes seconds
    place=42,
)
KID = Metric(*("kid", "KID", *_FLOOR, 3), of_set=SetDistance(FeatureKind.inception, kernel_distance), place=43)
