"""Pairs on disk: one Zarr v3 group, filled shard by shard by any number of processes."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import zarr
from filelock import FileLock, Timeout
from zarr.codecs import Crc32cCodec, ZstdCodec

from ablate.dataset.split import Part

MAPS = ("segmentation", "attenuation", "high", "low", "high_again")
_DTYPES = {
    "segmentation": "uint8",
    "attenuation": "uint16",
    "high": "uint8",
    "low": "uint8",
    "high_again": "uint8",
}
ATTENUATION_SCALE = 65535.0

log = logging.getLogger(__name__)

Renderer = Callable[[np.ndarray, frozenset[str]], Mapping[str, np.ndarray]]


@dataclass(frozen=True)
class Pairs:
    """A data set on disk.

    Attributes
    ----------
    folder : Path
        Holds `pairs.zarr`, `about.json` (what the set was made from), pictures and lock files.
    poses : (n, 4, 4) float64
        Probe to world, mm.
    sites : (n,) int32
    split : (n,) uint8 of `Part`
    shape : (H, W)
    shard : int
        Frames a shard.
    tissues : tuple of str
        Names behind the values 1, 2, ... of `segmentation`.
    """

    folder: Path
    poses: np.ndarray
    sites: np.ndarray
    split: np.ndarray
    shape: tuple[int, int]
    shard: int
    tissues: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.sites)

    @property
    def shards(self) -> int:
        return -(-len(self) // self.shard)

    def frames(self, part: Part) -> np.ndarray:
        """Indices of the frames of one part, increasing."""
        return np.flatnonzero(self.split == part)

    def frames_of_shard(self, shard: int) -> np.ndarray:
        return np.arange(shard * self.shard, min(len(self), (shard + 1) * self.shard))

    def wanted_in_shard(self, shard: int, maps: frozenset[str]) -> frozenset[str]:
        """Which of `maps` this shard holds: re-simulation only where there are validation or test frames."""
        if (self.split[self.frames_of_shard(shard)] == Part.train).all():
            return maps - {"high_again"}
        return maps

    def missing(self, maps: frozenset[str]) -> tuple[int, ...]:
        """Shards of which at least one wanted array is not yet on disk."""
        return tuple(s for s in range(self.shards) if self._missing_maps(s, maps))

    def _missing_maps(self, shard: int, maps: frozenset[str]) -> frozenset[str]:
        return frozenset(m for m in self.wanted_in_shard(shard, maps) if not self._shard_file(m, shard).exists())

    def _shard_file(self, name: str, shard: int) -> Path:
        return self.folder / "pairs.zarr" / name / "c" / str(shard) / "0" / "0"

    def array(self, name: str) -> zarr.Array:
        """The Zarr array of one map, (n, H, W); checksums are verified on reading."""
        found = zarr.open_group(self.folder / "pairs.zarr", mode="r")[name]
        assert isinstance(found, zarr.Array)
        return found

    def read(self, name: str, frames: Sequence[int] | np.ndarray) -> np.ndarray:
        """Frames of one map, (k, H, W); `attenuation` as float32 in [0, 1], the others as stored."""
        array = self.array(name)
        stack = np.stack([np.asarray(array[int(i)]) for i in frames])
        return (stack / ATTENUATION_SCALE).astype(np.float32) if name == "attenuation" else stack

    def mask(self) -> np.ndarray:
        """The fan, (H, W) bool."""
        return np.asarray(zarr.open_group(self.folder / "pairs.zarr", mode="r")["mask"][...])


def create_pairs(
    folder: Path,
    poses: np.ndarray,
    sites: np.ndarray,
    split: np.ndarray,
    mask: np.ndarray,
    shard: int,
    tissues: Sequence[str],
    about: Mapping[str, object],
) -> Pairs:
    """Lay out an empty data set, or open the one that is there.

    Arrays of maps are created by `fill_pairs` when first needed. Safe to call from several processes.

    Raises
    ------
    PermissionError
        When the folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with FileLock(folder / ".create.lock"):
        if not (folder / "about.json").exists():
            group = zarr.open_group(folder / "pairs.zarr", mode="w", zarr_format=3)
            for name, data in (
                ("pose", poses),
                ("site", sites.astype("int32")),
                ("split", split),
                ("mask", mask),
            ):
                group.create_array(name, data=np.ascontiguousarray(data))
            group.attrs.update({"shard": shard, "tissues": list(tissues)})
            partial = folder / "about.json.partial"
            partial.write_text(json.dumps(dict(about), indent=2, sort_keys=True, default=str))
            partial.rename(folder / "about.json")
    return open_pairs(folder)


def open_pairs(folder: Path) -> Pairs:
    """Open a data set that `create_pairs` laid out.

    Raises
    ------
    FileNotFoundError
        When there is none.
    """
    if not (folder / "about.json").exists():
        raise FileNotFoundError(f"no data set at {folder}; run `python -m ablate task=simulate` with the same settings")
    group = zarr.open_group(folder / "pairs.zarr", mode="r")
    pose, site, split, mask = (np.asarray(group[k][...]) for k in ("pose", "site", "split", "mask"))
    height, width = mask.shape
    return Pairs(
        folder=folder,
        poses=pose,
        sites=site,
        split=split,
        shape=(int(height), int(width)),
        shard=int(group.attrs["shard"]),
        tissues=tuple(str(t) for t in group.attrs["tissues"]),
    )


def fill_pairs(pairs: Pairs, maps: frozenset[str], render: Renderer) -> Iterator[int]:
    """Make the shards that are missing and that nobody else is making; yield the frames made after each.

    A shard is written whole under another name and renamed into place, with a CRC32C over each frame, so a kill
    loses at most the one in flight; shards that another process holds are skipped.

    Parameters
    ----------
    pairs : Pairs
    maps : frozenset of str, out of `MAPS`
    render : callable (frames (k,) int64, wanted maps) -> {name: (k, H, W) array}
        uint8, but `attenuation` float in [0, 1]; a map may be left out of frames that have none by zeros.
    """
    _create_maps(pairs, maps)
    for shard in pairs.missing(maps):
        with _claimed(pairs.folder / f".shard{shard}.lock") as mine:
            if not mine:
                continue
            names = pairs._missing_maps(shard, maps)
            if not names:
                continue
            frames = pairs.frames_of_shard(shard)
            group = zarr.open_group(pairs.folder / "pairs.zarr", mode="r+")
            for name, stack in render(frames, names).items():
                if name == "attenuation":
                    stack = np.round(np.clip(stack, 0, 1) * ATTENUATION_SCALE)
                array = group[name]
                array[frames[0] : frames[-1] + 1] = stack.astype(_DTYPES[name])
            yield len(frames)


def _create_maps(pairs: Pairs, maps: frozenset[str]) -> None:
    unknown = maps - set(MAPS)
    if unknown:
        raise ValueError(f"unknown maps {sorted(unknown)}; allowed: {', '.join(MAPS)}")
    height, width = pairs.shape
    with FileLock(pairs.folder / ".create.lock"):
        group = zarr.open_group(pairs.folder / "pairs.zarr", mode="a")
        for name in sorted(m for m in maps if m not in group):
            group.create_array(
                name,
                shape=(len(pairs), height, width),
                dtype=_DTYPES[name],
                chunks=(1, height, width),
                shards=(pairs.shard, height, width),
                compressors=[ZstdCodec(level=3), Crc32cCodec()],
                config={"write_empty_chunks": True},
            )


@contextmanager
def _claimed(path: Path) -> Iterator[bool]:
    lock = FileLock(path, timeout=0)
    try:
        lock.acquire()
    except Timeout:
        yield False
        return
    try:
        yield True
    finally:
        lock.release()
