"""Pairs made elsewhere, as a folder of PNGs: what is in it and whether it fits together, before any pixel is read.

segmentation/ and image/ hold files of the same names, attenuation/ and low/ may hold more of them. `labels.csv` (label,
tissue) names what the labels stand for, `frames.csv` (name, site and, if wanted, part) says which frames belong
together and which part they are in.
"""

import csv
import difflib
import hashlib
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from ablate.anatomy import Tissue, load_tissues
from ablate.dataset.split import Part

#: Folder of each map of a data set.
FOLDERS = {"segmentation": "segmentation", "target": "image", "attenuation": "attenuation", "low": "low"}
MOST_LABELS = 254
MOST_PIXELS = 2**24  # 4096 x 4096; a PNG of a few bytes can decode to gigabytes
_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_COLOURS = {0: "grey", 2: "RGB", 3: "with a palette", 4: "grey with alpha", 6: "RGBA"}


@dataclass(frozen=True, eq=False)
class PngFolder:
    """A folder that fits together.

    Attributes
    ----------
    names : tuple of str
        Of the frames, sorted; file names without `.png`.
    files : dict of str to dict of str to Path
        By the map's name in a data set (of FOLDERS, those that are there) and by the frame's name.
    shape : (H, W)
    sites : tuple of str
        Of each frame: frames of one site see almost the same, and stay on one side of a split.
    parts : (n,) uint8 of `Part`, or None where the split is to be drawn
    tissues : tuple of Tissue behind labels 1, 2, ..., or None where no file names them
    """

    folder: Path
    names: tuple[str, ...]
    files: Mapping[str, Mapping[str, Path]]
    shape: tuple[int, int]
    sites: tuple[str, ...]
    parts: np.ndarray | None
    tissues: tuple[Tissue, ...] | None

    @property
    def maps(self) -> frozenset[str]:
        """The maps that it holds."""
        return frozenset(self.files)


def validate_png_folder(folder: str | Path) -> PngFolder:
    """Check a folder by the names and headers of its files.

    Raises
    ------
    FileNotFoundError
        When a folder or a partner of a file is missing.
    ValueError
        When a file is no grey PNG of 8 bits (16 are allowed for attenuation), sizes differ, or a table is not as
        it should be; the message names the file and what is allowed.
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
    watched = (*(folder / place for place in FOLDERS.values()), folder / "frames.csv", folder / "labels.csv")
    return _validated(folder, tuple(path.stat().st_mtime_ns if path.exists() else 0 for path in watched))


@lru_cache(maxsize=8)
def _validated(folder: Path, _changed: tuple[int, ...]) -> PngFolder:
    """Looked at once a process for as long as no file comes or goes and no table changes."""
    files = {
        name: {path.stem: path for path in sorted((folder / place).iterdir()) if path.suffix.lower() == ".png"}
        for name, place in FOLDERS.items()
        if (folder / place).is_dir()
    }
    names = _common_names(folder, files)
    shape = _common_shape(files)
    sites, parts = _frames(folder / "frames.csv", names)
    return PngFolder(folder, names, files, shape, sites, parts, _tissues(folder / "labels.csv"))


def png_shape(folder: str | Path) -> tuple[int, int]:
    """Height and width of the first segmentation in a folder, px.

    Raises
    ------
    OSError, ValueError
        When there is none, or it is no PNG.
    """
    found = sorted(path for path in (Path(folder) / FOLDERS["segmentation"]).iterdir() if path.suffix.lower() == ".png")
    if not found:
        raise FileNotFoundError(f"{folder}: no PNG file in {FOLDERS['segmentation']}")
    return _header(found[0])[0]


def content_digest(checked: PngFolder) -> str:
    """SHA-256, hexadecimal, of all that becomes part of a data set: names and bytes of the files."""
    files = [checked.files[name][frame] for name in sorted(checked.maps) for frame in checked.names]
    tables = [path for path in (checked.folder / "labels.csv", checked.folder / "frames.csv") if path.exists()]
    stats = tuple((str(path), path.stat().st_size, path.stat().st_mtime_ns) for path in (*files, *tables))
    return _digest(checked.folder, stats)


@lru_cache(maxsize=8)
def _digest(folder: Path, stats: tuple[tuple[str, int, int], ...]) -> str:
    """Read once a process for as long as no file changes."""
    digest = hashlib.sha256()
    for path, _, _ in stats:
        digest.update(Path(path).relative_to(folder).as_posix().encode())
        digest.update(hashlib.sha256(Path(path).read_bytes()).digest())
    return digest.hexdigest()


def _common_names(folder: Path, files: Mapping[str, Mapping[str, Path]]) -> tuple[str, ...]:
    everything = set().union(*files.values())
    for name, found in files.items():
        if not found:
            raise FileNotFoundError(f"{folder / FOLDERS[name]}: no PNG in it")
        missing = sorted(everything - found.keys())
        if missing:
            partner = next(there[missing[0]] for there in files.values() if missing[0] in there)
            more = f" (and {len(missing) - 1} more)" if len(missing) > 1 else ""
            path = folder / FOLDERS[name] / f"{missing[0]}.png"
            raise FileNotFoundError(f"{path}: missing{more}, though its partner {partner} is there")
    return tuple(sorted(everything))


def _common_shape(files: Mapping[str, Mapping[str, Path]]) -> tuple[int, int]:
    """Height and width of all images, px."""
    first = next(iter(files["segmentation"].values()))
    h0, w0 = _header(first)[0]
    for name, paths in files.items():
        allowed = (8, 16) if name == "attenuation" else (8,)
        for path in paths.values():
            (h, w), bits, colour = _header(path)
            if colour != 0 or bits not in allowed:
                kind = f"{bits}-bit {_COLOURS.get(colour, 'of an unknown kind')}"
                raise ValueError(f"{path}: is {kind}; allowed is {' or '.join(f'{b}-bit' for b in allowed)} grey")
            if (h, w) != (h0, w0):
                raise ValueError(f"{path}: is {w} x {h} px, but {first} is {w0} x {h0}; all must have one size")
    return h0, w0


def _header(path: Path) -> tuple[tuple[int, int], int, int]:
    """Height and width, bits a sample and colour type of a PNG, from its first chunk."""
    with path.open("rb") as stream:
        data = stream.read(26)
    if len(data) < 26 or data[:8] != _SIGNATURE or data[12:16] != b"IHDR":
        raise ValueError(f"{path}: not a PNG file")
    width, height, bits, colour = struct.unpack(">IIBB", data[16:26])
    if not 0 < width * height <= MOST_PIXELS:
        raise ValueError(f"{path}: is {width} x {height} px; allowed are 1 to {MOST_PIXELS} pixels")
    return (height, width), bits, colour


def _frames(path: Path, names: tuple[str, ...]) -> tuple[tuple[str, ...], np.ndarray | None]:
    """Site and part of every frame; without the table a site is what stands before the last `_` of a name."""
    if not path.exists():
        return tuple(name.rpartition("_")[0] or name for name in names), None
    known = set(names)
    rows: dict[str, dict[str, str]] = {}
    for number, row in _table(path, ("name", "site"), ("part",)):
        name = row["name"].removesuffix(".png")
        if name not in known:
            raise ValueError(f"{path}, line {number}: there is no frame '{name}'")
        if name in rows:
            raise ValueError(f"{path}, line {number}: frame '{name}' is listed twice")
        if not row["site"]:
            raise ValueError(f"{path}, line {number}: no site; any word will do")
        if "part" in row and row["part"] not in Part.__members__:
            allowed = ", ".join(Part.__members__)
            raise ValueError(f"{path}, line {number}: part '{row['part']}' is not one of {allowed}")
        rows[name] = row
    missing = [name for name in names if name not in rows]
    if missing:
        raise ValueError(f"{path}: {len(missing)} frames are not listed, the first is '{missing[0]}'")
    sites = tuple(rows[name]["site"] for name in names)
    if "part" not in rows[names[0]]:
        return sites, None
    parts = np.array([Part[rows[name]["part"]] for name in names], np.uint8)
    for part in Part:
        if part not in parts:
            raise ValueError(
                f"{path}: no frame is in part {part.name}; each of {', '.join(Part.__members__)} needs one"
            )
    return sites, parts


def _tissues(path: Path) -> tuple[Tissue, ...] | None:
    """The tissue of the built-in table behind each label."""
    if not path.exists():
        return None
    known = load_tissues()
    found: dict[int, Tissue] = {}
    for number, row in _table(path, ("label", "tissue"), ()):
        if not row["label"].isdecimal() or not 1 <= int(row["label"]) <= MOST_LABELS:
            raise ValueError(f"{path}, line {number}: label '{row['label']}'; allowed are 1 to {MOST_LABELS}")
        if row["tissue"] not in known:
            close = difflib.get_close_matches(row["tissue"], list(known), n=1)
            hint = f"; did you mean '{close[0]}'?" if close else ""
            raise ValueError(
                f"{path}, line {number}: unknown tissue '{row['tissue']}'{hint} known: {', '.join(known)} "
                "(take the one that is most alike: it decides the order of the labels and what is fluid)"
            )
        if int(row["label"]) in found:
            raise ValueError(f"{path}, line {number}: label {row['label']} is listed twice")
        found[int(row["label"])] = known[row["tissue"]]
    if sorted(found) != list(range(1, len(found) + 1)) or not found:
        raise ValueError(f"{path}: the labels must be 1, 2, ... without a gap, not {sorted(found)}")
    return tuple(found[label] for label in sorted(found))


def _table(path: Path, needed: Sequence[str], optional: Sequence[str]) -> list[tuple[int, dict[str, str]]]:
    """Line numbers and rows of a CSV file with a header line, values without blanks around them."""
    try:
        return _rows(path, needed, optional)
    except (csv.Error, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: not readable as CSV in UTF-8 ({error})") from error


def _rows(path: Path, needed: Sequence[str], optional: Sequence[str]) -> list[tuple[int, dict[str, str]]]:
    with path.open(newline="", encoding="utf-8-sig") as stream:
        reader = csv.DictReader(stream, skipinitialspace=True)
        columns = [column.strip() for column in reader.fieldnames or ()]
        unknown = [column for column in columns if column not in (*needed, *optional)]
        if unknown or any(column not in columns for column in needed):
            also = f" and, if wanted, {', '.join(optional)}" if optional else ""
            raise ValueError(f"{path}: its first line must be {','.join(needed)}{also}, not {','.join(columns)}")
        reader.fieldnames = columns
        return [(reader.line_num, {k: (v or "").strip() for k, v in row.items() if k}) for row in reader]
