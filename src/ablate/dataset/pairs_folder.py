"""The folder of a data set: laid out empty, and opened."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from filelock import FileLock
from zarr.codecs import Crc32cCodec, ZstdCodec

from ablate.dataset.pairs import MEND, PAIRS_VERSION, Pairs
from ablate.dataset.zarr_v3 import open_group, read_whole
from ablate.networks.spec import Space
from ablate.setting import plain
from ablate.storage import check_unpacked, write_json
from ablate.ultrasound import Probe
from ablate.ultrasound.settings import probe_from


@dataclass(frozen=True, eq=False)
class PlacedFrames:
    """The frames of a data set that is to be made, of which there are n.

    Attributes
    ----------
    poses : (n, 4, 4) float64
        Probe to world, mm; NaN where it is not known.
    sites : (n,) int
        Frames of one site see almost the same anatomy.
    split : (n,) uint8 of `Part`
    mask : (H, W) bool
        The fan of the images.
    """

    poses: np.ndarray
    sites: np.ndarray
    split: np.ndarray
    mask: np.ndarray


@dataclass(frozen=True)
class StoredAs:
    """How the frames of a data set are stored; what each fact means is said by `Pairs`."""

    shard: int
    tissues: Sequence[str]
    space: Space = Space.image
    probe: Probe | None = None
    beam_shape: tuple[int, int] = (0, 0)


def create_pairs(folder: Path, frames: PlacedFrames, stored_as: StoredAs, about: Mapping[str, object]) -> Pairs:
    """Lay out an empty data set, or open the one that is there. Safe to call from several processes.

    Parameters
    ----------
    folder : Path
        Of the data set; it is made where it is missing.
    frames : PlacedFrames
        Arrays of their maps are created by `fill_pairs` when they are first needed.
    stored_as : StoredAs
        How the arrays are stored.
    about : mapping of JSON values
        What the set is made from, kept as `about.json`.

    Returns
    -------
    Pairs
        As `open_pairs` opens them.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with FileLock(folder / ".create.lock"):
        if not (folder / "about.json").exists():
            _write_layout(folder / "pairs.zarr", frames, stored_as)
            write_json(folder / "about.json", about)
    return open_pairs(folder)


def _write_layout(path: Path, frames: PlacedFrames, stored_as: StoredAs) -> None:
    group = zarr.open_group(path, mode="w", zarr_format=3)
    arrays = {
        "pose": frames.poses,
        "site": frames.sites.astype("int32"),
        "split": frames.split,
        "mask": frames.mask,
    }
    for name, values in arrays.items():
        group.create_array(name, data=np.ascontiguousarray(values), compressors=[ZstdCodec(), Crc32cCodec()])
    attributes = {
        "version": PAIRS_VERSION,
        "shard": stored_as.shard,
        "tissues": list(stored_as.tissues),
        "space": str(stored_as.space),
        "beam_shape": list(stored_as.beam_shape),
        "probe": None if stored_as.probe is None else plain(stored_as.probe),
    }
    group.attrs.update(attributes)


def open_pairs(folder: str | Path) -> Pairs:
    """Open a data set that `create_pairs` laid out.

    A FileNotFoundError when there is none; a ValueError when its poses, sites, split or mask are not as they were
    written, or it is stored in another version or by another program.
    """
    folder = Path(folder)
    if not (folder / "about.json").exists():
        raise FileNotFoundError(f"no data set at {folder}; {MEND} makes it")
    path = folder / "pairs.zarr"
    attributes: dict[str, Any] = dict(open_group(path).attrs)
    version = attributes.get("version")
    if version != PAIRS_VERSION:
        raise ValueError(
            f"{folder}: pairs stored in version {version}, this program reads version {PAIRS_VERSION}; {MEND} makes "
            "them again in a folder of their own, after which this one can be removed"
        )
    height, width = read_whole(path / "mask").shape
    rows, scanlines = attributes["beam_shape"]
    check_unpacked(path, int(rows) * int(scanlines))
    return Pairs(
        folder=folder,
        poses=read_whole(path / "pose"),
        sites=read_whole(path / "site"),
        split=read_whole(path / "split"),
        shape=(height, width),
        shard=attributes["shard"],
        tissues=tuple(attributes["tissues"]),
        space=Space(attributes["space"]),
        probe=attributes["probe"] and probe_from(attributes["probe"]),
        beam_shape=(int(rows), int(scanlines)),
    )
