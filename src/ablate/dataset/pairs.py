"""Pairs on disk: one Zarr v3 group, what it holds, and how its frames are read."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import zarr
from filelock import FileLock

from ablate.dataset.shards import FrameFormat, check_shard, read_frame
from ablate.dataset.split import Part

#: Part of every data set's identity: raise it when the same frames are stored otherwise.
PAIRS_VERSION = 2
# Labels repeat as whole bytes; grey levels and 16-bit values pack better with bits, or bytes, of like place together.
FORMATS = {
    "segmentation": FrameFormat("uint8", "noshuffle"),
    "attenuation": FrameFormat("uint16", "shuffle"),
    "high": FrameFormat("uint8", "bitshuffle"),
    "low": FrameFormat("uint8", "bitshuffle"),
    "high_again": FrameFormat("uint8", "bitshuffle"),
}
_ATTENUATION_SCALE = np.float32(65535)
_ATTENUATION_BITS = 9
_MEND = "`python -m ablate task=simulate` with the same settings"


class DamagedShardError(ValueError):
    """A shard is not as it was written; the message names it and what mends it, `what` the shard alone."""

    def __init__(self, what: str) -> None:
        super().__init__(f"{what}; {_MEND} finds and makes again what is damaged")
        self.what = what


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

    @property
    def maps(self) -> frozenset[str]:
        """Names of the maps that are laid out; which shards of them are made tells `missing`."""
        return frozenset(m for m in FORMATS if (self.folder / "pairs.zarr" / m / "zarr.json").exists())

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

    def missing_in_shard(self, shard: int, maps: frozenset[str]) -> frozenset[str]:
        """Which of `maps` this shard should hold and does not."""
        return frozenset(m for m in self.wanted_in_shard(shard, maps) if not self.shard_file(m, shard).exists())

    def missing(self, maps: frozenset[str]) -> tuple[int, ...]:
        """Shards of which at least one wanted array is not yet on disk."""
        return tuple(s for s in range(self.shards) if self.missing_in_shard(s, maps))

    def shard_file(self, name: str, shard: int) -> Path:
        return self.folder / "pairs.zarr" / name / "c" / str(shard) / "0" / "0"

    def check(self, name: str, shard: int) -> None:
        """Compare one shard of one map with its checksums.

        Raises
        ------
        DamagedShardError, FileNotFoundError
        """
        try:
            check_shard(self.shard_file(name, shard), len(self.frames_of_shard(shard)), self.shard)
        except ValueError as error:
            raise self._damaged(name, shard, error) from error

    def stored(self, name: str, frame: int) -> np.ndarray:
        """One frame of one map as it is stored, (H, W) uint8 or, of attenuation, uint16.

        Raises
        ------
        DamagedShardError
            When it is not as it was written.
        FileNotFoundError
            When it has not been made.
        """
        shard, slot = divmod(int(frame), self.shard)
        file = self.shard_file(name, shard)
        try:
            return read_frame(file, slot, self.shard, FORMATS[name], self.shape)
        except ValueError as error:
            raise self._damaged(name, shard, error) from error
        except FileNotFoundError as error:
            raise FileNotFoundError(f"{file}: not made yet; {_MEND} makes it") from error

    def _damaged(self, name: str, shard: int, why: ValueError) -> DamagedShardError:
        frames = self.frames_of_shard(shard)
        return DamagedShardError(
            f"{self.shard_file(name, shard)}, '{name}' of frames {frames[0]} to {frames[-1]}, is damaged: {why}"
        )

    def read(self, name: str, frames: Sequence[int] | np.ndarray) -> np.ndarray:
        """Frames of one map, (k, H, W); `attenuation` as float32 in [0, 1], the others as stored.

        Raises
        ------
        DamagedShardError, FileNotFoundError
            As `stored`.
        """
        stack = np.stack([self.stored(name, i) for i in frames])
        return decode_attenuation(stack) if name == "attenuation" else stack

    def mask(self) -> np.ndarray:
        """The fan, (H, W) bool."""
        return np.asarray(zarr.open_group(self.folder / "pairs.zarr", mode="r")["mask"][...])


def encode_attenuation(values: np.ndarray) -> np.ndarray:
    """Attenuation in [0, 1] as uint16, of which the 9 leading bits are kept: within 0.2 % or half a step of 65535.

    The bits below are noise to zstd and to nobody else; without them a frame of attenuation takes about half the
    space (`make bench-dataset`), and small values are as fine as before.
    """
    scaled = np.multiply(np.clip(values, 0, 1), _ATTENUATION_SCALE, dtype=np.float32)
    bits = scaled.view(np.uint32)
    dropped = np.uint32(24 - _ATTENUATION_BITS)  # of the 24 significant bits of a float32
    bits += np.uint32(1) << (dropped - np.uint32(1))
    bits >>= dropped
    bits <<= dropped
    np.minimum(scaled, _ATTENUATION_SCALE, out=scaled)
    return np.rint(scaled, out=scaled).astype(np.uint16)


def decode_attenuation(stored: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
    """The inverse of `encode_attenuation`, float32."""
    return np.divide(stored, _ATTENUATION_SCALE, out=out, dtype=np.float32)


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
        raise FileNotFoundError(f"no data set at {folder}; {_MEND} makes it")
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
