"""Pairs on disk: one Zarr v3 group, what it holds, and how its frames are read, in beam space or as images.

Simulated frames are stored in beam space, and images are scan-converted from them; pairs made elsewhere are images.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import zarr
from filelock import FileLock
from zarr.codecs import Crc32cCodec, ZstdCodec

from ablate.dataset.encoding import ATTENUATION_SCALE, decode_attenuation
from ablate.dataset.split import Part
from ablate.networks.spec import OF_POSITION, OF_SURFACES, Space
from ablate.setting import plain, shown
from ablate.storage import write_json
from ablate.ultrasound import Probe, compensated_attenuation, compensated_beam, position_maps
from ablate.ultrasound.settings import probe_from

if TYPE_CHECKING:
    from ablate.ultrasound import ScanConverter

# Of several threads Zarr starts some later, which without memory may never return (CPython 140746).
zarr.config.set({"threading.max_workers": 1, "async.timeout": 300})

#: Part of every data set's identity: raise it when the same frames are stored otherwise.
PAIRS_VERSION = 6
# Each map's type for NumPy and shuffle for Blosc: labels repeat as whole bytes, other values pack better by place.
FORMATS = {
    "segmentation": ("uint8", "noshuffle"),
    "attenuation": ("uint16", "shuffle"),
    "interfaces": ("uint8", "noshuffle"),
    "illumination": ("uint8", "noshuffle"),
    "target": ("uint8", "bitshuffle"),
    "low": ("uint8", "bitshuffle"),
    "resimulation": ("uint8", "bitshuffle"),
}
#: What is not stored but made from a stored map when it is read, by the name of that map.
DERIVED = {"compensated": "attenuation"}
_MEND = "`python -m ablate task=simulate` with the same settings"


class DamagedShardError(ValueError):
    """A shard is not as it was written; the message names it and what mends it, `what` the shard alone."""

    def __init__(self, what: str) -> None:
        super().__init__(f"{what}; {_MEND} finds and makes again what is damaged")
        self.what = what


@dataclass(frozen=True)
class Pairs:
    """A data set on disk.

    `folder` holds `pairs.zarr`, `about.json` (what the set was made from), pictures and lock files. There are `shard`
    frames in a shard; `tissues` are the names behind the values 1, 2, ... of `segmentation`.

    Each frame has a pose in `poses`, (n, 4, 4) float64, probe to world, mm, a site in `sites`, (n,) int32, and a `Part`
    in `split`, (n,) uint8. Stored arrays are in `space`. Images are of `shape`, (H, W), and frames in beam space of
    `beam_shape`, (rows, scanlines).

    `probe` is None where the geometry of the fan is not known; then there are images alone. `tgc` is the time gain that
    the frames were simulated with, for `compensated`, and None where it is not known.
    """

    folder: Path
    poses: np.ndarray
    sites: np.ndarray
    split: np.ndarray
    shape: tuple[int, int]
    shard: int
    tissues: tuple[str, ...]
    space: Space = Space.image
    probe: Probe | None = None
    beam_shape: tuple[int, int] = (0, 0)
    tgc: float | tuple[float, ...] | None = None

    def __len__(self) -> int:
        return len(self.sites)

    @property
    def stored_shape(self) -> tuple[int, int]:
        return self.shape_in(self.space)

    def shape_in(self, space: Space) -> tuple[int, int]:
        """The shape of a frame in one space."""
        return self.beam_shape if Space(space) is Space.beam else self.shape

    @property
    def converter(self) -> ScanConverter:
        """The scan converter; a ValueError where the geometry of the fan is not known."""
        from ablate.ultrasound import scan_converter  # here, because it is compiled

        return scan_converter(self._geometry, self.beam_shape, self.shape)

    @property
    def _geometry(self) -> Probe:
        if self.probe is None:
            raise ValueError(f"{self.folder}: the geometry of the fan is not known, which fan.yaml names for pairs")
        return self.probe

    @property
    def shards(self) -> int:
        return -(-len(self) // self.shard)

    @property
    def maps(self) -> frozenset[str]:
        """Names of the maps that are laid out; which shards of them are made tells `missing`."""
        return frozenset(m for m in FORMATS if (self.folder / "pairs.zarr" / m / "zarr.json").exists())

    def frames(self, part: Part) -> np.ndarray:
        """Indices of the frames of one part, increasing."""
        return np.flatnonzero(self.split == Part(part))

    def frames_of_shard(self, shard: int) -> np.ndarray:
        return np.arange(shard * self.shard, min(len(self), (shard + 1) * self.shard))

    def missing_in_shard(self, shard: int, maps: frozenset[str]) -> frozenset[str]:
        """Which of `maps` this shard lacks; re-simulation is only for validation and test frames."""
        trains = (self.split[self.frames_of_shard(shard)] == Part.train).all()
        wanted = maps - {"resimulation"} if trains else maps
        return frozenset(m for m in wanted if not self.shard_file(m, shard).exists())

    def missing(self, maps: frozenset[str]) -> tuple[int, ...]:
        """Shards of which at least one wanted array is not yet on disk."""
        return tuple(s for s in range(self.shards) if self.missing_in_shard(s, maps))

    def shard_file(self, name: str, shard: int) -> Path:
        return self.folder / "pairs.zarr" / name / "c" / str(shard) / "0" / "0"

    def stored(self, name: str, frames: int | Sequence[int] | np.ndarray, space: Space = Space.image) -> np.ndarray:
        """Frames of one map in the type in which it is stored, uint8 or, of attenuation, uint16.

        The result is (H, W) for one number and (k, H, W) for several, of which those of one shard are read at once;
        in beam space (rows, scanlines). `compensated` is `compensated_attenuation` in steps of 1/65535.

        A DamagedShardError when a frame is not as it was written, a FileNotFoundError when it has not been made, an
        IndexError when there is none of its number.
        """
        given, source = np.atleast_1d(np.asarray(frames)), DERIVED.get(name, name)
        if given.size and (given.dtype.kind not in "iu" or not 0 <= given.min() <= given.max() < len(self)):
            raise IndexError(f"{self.folder}: frames={shown(frames)}: allowed are their numbers, 0 to {len(self) - 1}")
        numbers = given.astype(np.int64)
        stack = np.empty((len(numbers), *self.shape_in(space)), FORMATS[source][0])
        for shard in np.unique(numbers // self.shard):
            here = numbers // self.shard == shard
            first, last = numbers[here].min(), numbers[here].max()
            read = self._of_shard(source, shard, slice(first, last + 1))[numbers[here] - first]
            stack[here] = read if space == self.space else [self._converted(name, frame) for frame in read]
        if name in DERIVED:
            stack = self._compensated(stack, space)
        return stack if np.ndim(frames) else stack[0]

    def _converted(self, name: str, frame: np.ndarray) -> np.ndarray:
        """One stored frame in the other space: the nearest label, other values by bilinear interpolation."""
        converter, to_image = self.converter, self.space is Space.beam
        if name == "segmentation":
            return converter.labels_to_image(frame) if to_image else converter.labels_to_beam(frame)
        made = converter.to_image(frame) if to_image else converter.to_beam(frame)
        return made if made.dtype == frame.dtype else np.rint(made).astype(frame.dtype)

    def _compensated(self, stack: np.ndarray, space: Space) -> np.ndarray:
        if self.probe is None or self.tgc is None:
            raise ValueError(f"{self.folder}: compensated attenuation needs the probe and the TGC of the simulation")
        compensate = compensated_attenuation if space == Space.image else compensated_beam
        shares = compensate(decode_attenuation(stack), self.probe, self.tgc)
        return np.rint(shares * ATTENUATION_SCALE).astype(np.uint16)

    def _of_shard(self, name: str, shard: int, frames: slice) -> np.ndarray:
        """A range of frames, all of one shard, as stored."""
        file = self.shard_file(name, shard)
        if not file.exists():  # Zarr would read zeros
            raise FileNotFoundError(f"{file}: not made yet; {_MEND} makes it")
        if name not in self._arrays:
            self._arrays[name] = zarr.open_array(self.folder / "pairs.zarr" / name, mode="r")
        try:
            return np.asarray(self._arrays[name][frames])
        except (ValueError, RuntimeError) as error:
            numbers = self.frames_of_shard(shard)
            what = f"{file}, '{name}' of frames {numbers[0]} to {numbers[-1]}, is damaged"
            raise DamagedShardError(f"{what}: it does not match its checksum") from error

    @cached_property
    def _arrays(self) -> dict[str, zarr.Array]:
        """Arrays are opened when they are first read, which takes longer than reading a frame."""
        return {}

    def read(self, name: str, frames: Sequence[int] | np.ndarray, space: Space = Space.image) -> np.ndarray:
        """Frames of one map, (k, H, W) or, in beam space, (k, rows, scanlines). Raises as `stored`.

        Labels and grey levels are uint8. Attenuation, interfaces and illumination are float32 in [0, 1], and the maps
        of position, `depth` and `lateral`, float32 in [-1, 1].
        """
        if name in OF_POSITION:
            return np.broadcast_to(self.positions(space)[name], (len(frames), *self.shape_in(space))).copy()
        return decoded(name, self.stored(name, frames, space))

    def positions(self, space: Space = Space.image) -> dict[str, np.ndarray]:
        """The maps of position, by name."""
        return position_maps(self._geometry, self.shape if Space(space) is Space.image else None, self.beam_shape)

    def mask(self, space: Space = Space.image) -> np.ndarray:
        """The fan, (H, W) bool; in beam space it is everything."""
        return np.ones(self.beam_shape, bool) if Space(space) is Space.beam else _read_whole(self.folder, "mask")


def decoded(name: str, stored: np.ndarray) -> np.ndarray:
    """Values of a map from those that are stored, as `Pairs.read` has them."""
    if stored.dtype == np.uint16:
        return decode_attenuation(stored)
    return stored / np.float32(255) if name in OF_SURFACES else stored


def create_pairs(
    folder: Path,
    poses: np.ndarray,
    sites: np.ndarray,
    split: np.ndarray,
    mask: np.ndarray,
    shard: int,
    tissues: Sequence[str],
    about: Mapping[str, object],
    space: Space = Space.image,
    probe: Probe | None = None,
    beam_shape: tuple[int, int] = (0, 0),
) -> Pairs:
    """Lay out an empty data set, or open the one that is there.

    `mask`, (H, W) bool, is the fan of the images. Arrays of maps are created by `fill_pairs` when first needed. Safe to
    call from several processes.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with FileLock(folder / ".create.lock"):
        if not (folder / "about.json").exists():
            group = zarr.open_group(folder / "pairs.zarr", mode="w", zarr_format=3)
            for name, data in {"pose": poses, "site": sites.astype("int32"), "split": split, "mask": mask}.items():
                group.create_array(name, data=np.ascontiguousarray(data), compressors=[ZstdCodec(), Crc32cCodec()])
            group.attrs.update({"version": PAIRS_VERSION, "shard": shard, "tissues": list(tissues)})
            group.attrs.update({"space": str(space), "beam_shape": list(beam_shape)})
            group.attrs.update({"probe": None if probe is None else plain(probe)})
            write_json(folder / "about.json", about)
    return open_pairs(folder)


def open_pairs(folder: str | Path) -> Pairs:
    """Open a data set that `create_pairs` laid out.

    A FileNotFoundError when there is none; a ValueError when its poses, sites, split or mask are not as they were
    written, or it is stored in another version.
    """
    folder = Path(folder)
    if not (folder / "about.json").exists():
        raise FileNotFoundError(f"no data set at {folder}; {_MEND} makes it")
    group = zarr.open_group(folder / "pairs.zarr", mode="r")
    if (version := group.attrs.get("version")) != PAIRS_VERSION:
        raise ValueError(
            f"{folder}: pairs stored in version {version}, this program reads version {PAIRS_VERSION}; {_MEND} makes "
            "them again in a folder of their own, after which this one can be removed"
        )
    pose, site, split, mask = (_read_whole(folder, name) for name in ("pose", "site", "split", "mask"))
    known: dict[str, Any] = dict(group.attrs)
    tissues, probe = tuple(known["tissues"]), known["probe"] and probe_from(known["probe"])
    of_beam = Space(known["space"]), probe, (int(known["beam_shape"][0]), int(known["beam_shape"][1]))
    return Pairs(folder, pose, site, split, (mask.shape[0], mask.shape[1]), known["shard"], tissues, *of_beam)


def _read_whole(folder: Path, name: str) -> np.ndarray:
    """One of the small arrays that are written once, when the set is laid out."""
    path = folder / "pairs.zarr" / name
    try:
        return np.asarray(zarr.open_array(path, mode="r")[...])
    except (ValueError, RuntimeError) as error:
        raise ValueError(f"{path} is damaged ({error}); the set cannot be used without: remove {folder}") from error
