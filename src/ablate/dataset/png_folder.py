"""Pairs made elsewhere, as a folder of PNGs: whether it fits together, and its pixels as a data set.

segmentation/ and image/ hold files of the same names, attenuation/ and low/ may hold more of them. `labels.csv` (label,
tissue) names what the labels stand for, `frames.csv` (name, site and, if wanted, part) says which frames belong
together and which part they are in, `fan.yaml` is the geometry of the fan, as a probe has it.
"""

import hashlib
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from unicodedata import normalize

import numpy as np
from PIL import ExifTags, Image
from skimage.io import imread

from ablate.anatomy import Tissue
from ablate.dataset.filling import fill_all, fill_pairs
from ablate.dataset.pairs import Pairs
from ablate.dataset.png_tables import MOST_LABELS, probe_of_fan, sites_and_parts, tissues_of_labels
from ablate.storage import digest, digest_of_files
from ablate.ultrasound.settings import Probe

#: Folder of each map of a data set.
FOLDERS = {"segmentation": "segmentation", "target": "image", "attenuation": "attenuation", "low": "low"}
_TABLES = ("labels.csv", "frames.csv", "fan.yaml")
MOST_PIXELS = 2**24  # 4096 x 4096; a PNG of a few bytes can decode to gigabytes
_COLOURS = {0: "grey", 2: "RGB", 3: "with a palette", 4: "grey with alpha", 6: "RGBA"}


@dataclass(frozen=True, eq=False)
class PngFolder:
    """A folder that fits together.

    Attributes
    ----------
    folder : Path
    names : tuple of str
        Of the frames, sorted: file names without `.png`.
    files : dict of dict of Path
        By map in a data set, of `FOLDERS` those that are there, and by frame.
    shape : (H, W)
        Of the images.
    sites : tuple of str
        Of each frame; those of one site see almost the same, and stay on one side of a split.
    parts : (n,) uint8 of `Part`, or None
        None where the split is to be drawn.
    tissues : tuple of Tissue, or None
        Behind labels 1, 2, ...; None where no file names them.
    probe : Probe or None
        With the geometry of the fan; None where no file tells it.
    """

    folder: Path
    names: tuple[str, ...]
    files: Mapping[str, Mapping[str, Path]]
    shape: tuple[int, int]
    sites: tuple[str, ...]
    parts: np.ndarray | None
    tissues: tuple[Tissue, ...] | None
    probe: Probe | None

    @property
    def beam_shape(self) -> tuple[int, int]:
        """Rows and scanlines in beam space: 3/2 and 3/8 of the image's, as in simulated frames, in steps of 64."""
        rows, lines = (max(64 * round(n / 64), 64) for n in (self.shape[0] * 3 / 2, self.shape[1] * 3 / 8))
        return rows, lines

    @property
    def maps(self) -> frozenset[str]:
        """The maps that it holds."""
        return frozenset(self.files)


def validate_png_folder(folder: str | Path) -> PngFolder:
    """Check a folder by the names and headers of its files.

    A FileNotFoundError when a folder or a partner of a file is missing. A ValueError when a file is no grey PNG of 8
    bits (16 are allowed for attenuation), sizes differ, or a table is not as it should be; the message names the file
    and what is allowed.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileNotFoundError(f"scene.folder: {folder} is not a folder")
    for name in ("segmentation", "target"):
        if not (folder / FOLDERS[name]).is_dir():
            raise FileNotFoundError(
                f"{folder}: no folder {FOLDERS[name]} in it; needed are segmentation and image, "
                "attenuation and low are read where they are there"
            )
    watched = (folder / name for name in (*FOLDERS.values(), *_TABLES))
    return _validated(folder, tuple(path.stat().st_mtime_ns if path.exists() else 0 for path in watched))


@lru_cache(maxsize=8)
def _validated(folder: Path, _changed: tuple[int, ...]) -> PngFolder:
    """Looked at once a process for as long as no file comes or goes and no table changes."""
    files = {name: _pngs(folder / place) for name, place in FOLDERS.items() if (folder / place).is_dir()}
    names = tuple(sorted(set().union(*files.values())))
    for name, by_frame in files.items():
        if not by_frame:
            raise FileNotFoundError(f"{folder / FOLDERS[name]}: no PNG in it; JPEG is not read, as it changes labels")
        missing = [frame for frame in names if frame not in by_frame]
        if missing:
            partner = next(others[missing[0]] for others in files.values() if missing[0] in others)
            more = f" (and {len(missing) - 1} more)" if len(missing) > 1 else ""
            path = folder / FOLDERS[name] / f"{missing[0]}.png"
            raise FileNotFoundError(f"{path}: missing{more}, though its partner {partner} is there")
    shape = _common_shape(files, names[0])
    sites, parts = sites_and_parts(folder / "frames.csv", names)
    return PngFolder(
        folder=folder,
        names=names,
        files=files,
        shape=shape,
        sites=sites,
        parts=parts,
        tissues=tissues_of_labels(folder / "labels.csv"),
        probe=probe_of_fan(folder / "fan.yaml"),
    )


def _pngs(folder: Path) -> dict[str, Path]:
    """The PNGs of a folder by the name of their frame, composed (NFC): macOS decomposes the names of files.

    Two files of one frame, such as `a.png` and `a.PNG`, are a ValueError.
    """
    by_frame: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() == ".png":
            first = by_frame.setdefault(normalize("NFC", path.stem), path)
            if first != path:
                raise ValueError(f"{path}: there is {first.name}, too; allowed is one file a frame")
    return by_frame


def _common_shape(files: Mapping[str, Mapping[str, Path]], first_frame: str) -> tuple[int, int]:
    """The size of all images, (H, W), by their headers; a ValueError where one differs or is not grey as allowed."""
    first = files["segmentation"][first_frame]
    shape, _, _ = _header(first)
    for name, by_frame in files.items():
        allowed = (8, 16) if name == "attenuation" else (8,)
        for path in by_frame.values():
            (height, width), bits, colour = _header(path)
            if colour != 0 or bits not in allowed:
                kind = f"{bits}-bit {_COLOURS.get(colour, 'of an unknown kind')}"
                raise ValueError(f"{path}: is {kind}; allowed is {' or '.join(f'{b}-bit' for b in allowed)} grey")
            if (height, width) != shape:
                size = f"{width} x {height} px"
                raise ValueError(f"{path}: is {size}, but {first} is {shape[1]} x {shape[0]}; all must have one size")
    return shape


def read_fan(checked: PngFolder) -> tuple[np.ndarray, int]:
    """Decode every segmentation; return the fan they share, (H, W) bool, where they are not 0, and the highest label.

    A ValueError names the first file whose fan or labels do not fit, or which cannot be decoded.
    """
    highest = 0
    allowed = MOST_LABELS if checked.tissues is None else len(checked.tissues)
    paths = [checked.files["segmentation"][name] for name in checked.names]
    mask = _decoded(paths[0], checked.shape) > 0
    for path in paths:
        labels = _decoded(path, checked.shape)
        highest = max(highest, int(labels.max()))
        if highest > allowed:
            why = "" if checked.tissues is None else f", those that {checked.folder / 'labels.csv'} names"
            raise ValueError(f"{path}: has label {highest}; allowed are 0, outside the fan, to {allowed}{why}")
        differs = int(np.count_nonzero((labels > 0) != mask))
        if differs:
            raise ValueError(
                f"{path}: its fan, the pixels that are not 0, differs at {differs} of {labels.size} pixels from "
                f"that of {paths[0]}; all frames must have one fan"
            )
    if highest == 0:
        raise ValueError(f"{paths[0]}: all its pixels are 0, so there is no fan")
    return mask, highest


def import_pairs(checked: PngFolder, names: Sequence[str], pairs: Pairs, maps: frozenset[str]) -> None:
    """Fill what is missing of a data set from the PNGs; what lies outside the fan becomes 0.

    Parameters
    ----------
    checked : PngFolder
        The folder.
    names : sequence of str
        Of the frames, in the order of the data set.
    pairs : Pairs
        The data set.
    maps : frozenset of str
        Some of `checked.maps`.

    Raises
    ------
    ValueError
        When a file cannot be decoded.
    OSError
        When a shard cannot be written.
    """
    mask = pairs.mask()

    def image(name: str, frame: int) -> np.ndarray:
        decoded = mask * _decoded(checked.files[name][names[frame]], checked.shape)
        if name == "attenuation" and decoded.dtype == np.uint8:
            return np.uint16(257) * decoded  # 255 becomes 65535
        return decoded

    def read(frames: np.ndarray, wanted: frozenset[str]) -> Mapping[str, np.ndarray]:
        return {name: np.stack([image(name, frame) for frame in frames]) for name in wanted}

    fill_all(pairs, maps, "import", lambda: fill_pairs(pairs, maps, read))


def _decoded(path: Path, shape: tuple[int, int]) -> np.ndarray:
    """The grey levels of a PNG, (H, W) uint8, or uint16 of an attenuation map."""
    try:
        content = path.read_bytes()
        image: np.ndarray = imread(BytesIO(content))  # closed, whatever is raised
        turned = _orientation(content)
    except Exception as error:  # every chunk of a PNG raises its own
        raise ValueError(f"{path}: cannot be decoded ({' '.join(str(error).split())})") from error
    if image.shape != shape or (image.dtype != np.uint8 and path.parent.name != FOLDERS["attenuation"]):
        raise ValueError(f"{path}: is not plain grey of 8 bits (transparent pixels? written again?)")
    if turned != 1:
        upright = "allowed is 1, pixels as they are seen; save it upright, without Exif"
        raise ValueError(f"{path}: has an Exif orientation of {turned}, so viewers turn it; {upright}")
    return image


def _orientation(content: bytes) -> int:
    """The orientation that the metadata of a PNG ask viewers for, 1 where they ask for none."""
    if not any(mark in content for mark in (b"eXIf", b"Raw profile type", b"XML:com.adobe.xmp")):
        return 1
    with Image.open(BytesIO(content)) as picture:
        return int(picture.getexif().get(ExifTags.Base.Orientation, 1))


def picture_digests(checked: PngFolder, mask: np.ndarray) -> list[bytes]:
    """A digest of the pixels of each frame's image within the fan, (H, W) bool, however its file is compressed."""
    files = checked.files["target"]
    pictures = (_decoded(files[name], checked.shape)[mask] for name in checked.names)
    return [hashlib.sha256(picture.tobytes()).digest() for picture in pictures]


def content_digest(checked: PngFolder) -> str:
    """Digest of all that becomes part of a data set: its maps, names and bytes of the files."""
    files = [checked.files[name][frame] for name in sorted(checked.maps) for frame in checked.names]
    tables = [checked.folder / name for name in _TABLES if (checked.folder / name).exists()]
    stats = ((path, path.stat()) for path in (*files, *tables))
    read = _digest(tuple((path, stat.st_size, stat.st_mtime_ns) for path, stat in stats))
    return digest([sorted(checked.maps), read])


@lru_cache(maxsize=8)
def _digest(stats: tuple[tuple[Path, int, int], ...]) -> str:
    """Read once a process for as long as no file changes."""
    return digest_of_files(path for path, _, _ in stats)


def _header(path: Path) -> tuple[tuple[int, int], int, int]:
    """Height and width, bits a sample and colour type of a PNG, from its first chunk.

    Pillow calls grey of 2 and 4 bits grey of 8, and then scales labels.
    """
    with path.open("rb") as stream:
        data = stream.read(26)
    if len(data) < 26 or data[:8] != b"\x89PNG\r\n\x1a\n" or data[12:16] != b"IHDR":
        raise ValueError(f"{path}: not a PNG file")
    width, height, bits, colour = struct.unpack(">IIBB", data[16:26])
    if not 0 < width * height <= MOST_PIXELS:
        raise ValueError(f"{path}: is {width} x {height} px; allowed are 1 to {MOST_PIXELS} pixels")
    return (height, width), bits, colour
