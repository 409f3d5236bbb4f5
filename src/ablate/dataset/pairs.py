"""Pairs on disk: one Zarr v3 group, what it holds, and how its frames are read, in beam space or as images.

Simulated frames are stored in beam space, and images are scan-converted from them; pairs made elsewhere are images.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ablate.dataset.encoding import ATTENUATION_SCALE, decode_attenuation
from ablate.dataset.split import Part
from ablate.dataset.zarr_v3 import open_frames, read_whole
from ablate.networks.spec import GRAIN, OF_POSITION, OF_SURFACES, Space
from ablate.setting import shown
from ablate.ultrasound import Probe, compensated_attenuation, compensated_beam, position_maps

if TYPE_CHECKING:
    import zarr

    from ablate.ultrasound import ScanConverter, SimulatorSettings

#: Part of every data set's identity: raise it when the same frames are stored otherwise.
PAIRS_VERSION = 6
# Each map's type for NumPy and shuffle for Blosc: labels repeat as whole bytes, other values pack better by place.
FORMATS = {
    "segmentation": ("uint8", "noshuffle"),
    "attenuation": ("uint16", "shuffle"),
    "interfaces": ("uint8", "noshuffle"),
    "illumination": ("uint8", "noshuffle"),
    "compound": ("uint16", "shuffle"),
    "target": ("uint8", "bitshuffle"),
    "low": ("uint8", "bitshuffle"),
    "resimulation": ("uint8", "bitshuffle"),
}
#: What is not stored but made from a stored map when it is read, by the name of that map.
DERIVED = {"compensated": "attenuation"}
#: What makes a data set, or what is missing of it.
MEND = "`python -m ablate task=simulate` with the same settings"


class DamagedShardError(ValueError):
    """A shard is not as it was written; the message names it and what mends it, `what` the shard alone."""

    def __init__(self, what: str) -> None:
        super().__init__(f"{what}; {MEND} finds and makes again what is damaged")
        self.what = what


@dataclass(frozen=True)
class Pairs:
    """A data set on disk.

    Attributes
    ----------
    folder : Path
        Holds `pairs.zarr`, `about.json` (what the set was made from), pictures and lock files.
    poses : (n, 4, 4) float64
        Probe to world, mm, of each frame.
    sites : (n,) int32
        Frames of one site see almost the same anatomy.
    split : (n,) uint8 of `Part`
    shape : (H, W)
        Of the images.
    shard : int
        Frames in a shard.
    tissues : names
        Behind the values 1, 2, ... of `segmentation`.
    space : Space
        Of the stored arrays.
    probe : Probe or None
        None where the geometry of the fan is not known; then there are images alone.
    beam_shape : (rows, scanlines)
        Of frames in beam space.
    simulator : SimulatorSettings or None
        What the frames were simulated with, for `compensated` and `grain`; None where it is not known.
    seed : int
        Of the scatterers.
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
    simulator: SimulatorSettings | None = None
    seed: int = 0

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
        return frozenset(name for name in FORMATS if (self._array_folder(name) / "zarr.json").exists())

    def frames(self, part: Part) -> np.ndarray:
        """Indices of the frames of one part, increasing."""
        return np.flatnonzero(self.split == Part(part))

    def frames_of_shard(self, shard: int) -> np.ndarray:
        return np.arange(shard * self.shard, min(len(self), (shard + 1) * self.shard))

    def missing_in_shard(self, shard: int, maps: frozenset[str]) -> frozenset[str]:
        """Which of `maps` this shard lacks; re-simulation is only for validation and test frames."""
        trains = (self.split[self.frames_of_shard(shard)] == Part.train).all()
        wanted = maps - {"resimulation"} if trains else maps
        return frozenset(name for name in wanted if not self.shard_file(name, shard).exists())

    def missing(self, maps: frozenset[str]) -> tuple[int, ...]:
        """Shards of which at least one wanted array is not yet on disk."""
        return tuple(shard for shard in range(self.shards) if self.missing_in_shard(shard, maps))

    def shard_file(self, name: str, shard: int) -> Path:
        """The file of some frames of a map."""
        return self._array_folder(name) / "c" / str(shard) / "0" / "0"

    def _array_folder(self, name: str) -> Path:
        return self.folder / "pairs.zarr" / name

    def stored(self, name: str, frames: int | Sequence[int] | np.ndarray, space: Space = Space.image) -> np.ndarray:
        """Frames of one map in the type in which it is stored.

        Those of one shard are read at once. `compensated` is `compensated_attenuation` in steps of 1/65535.

        Parameters
        ----------
        name : str
            Of the map: a key of `FORMATS` or of `DERIVED`.
        frames : int or (k,) int
            Numbers of frames.
        space : Space
            In which the frames are wanted.

        Returns
        -------
        (H, W) or (k, H, W) uint8, of attenuation and compound uint16
            In beam space (rows, scanlines) or (k, rows, scanlines).

        Raises
        ------
        DamagedShardError
            When a frame is not as it was written.
        FileNotFoundError
            When a frame has not been made.
        IndexError
            When there is no frame of a number.
        """
        numbers = self._checked(np.atleast_1d(np.asarray(frames)), frames)
        source = DERIVED.get(name, name)
        stack = np.empty((len(numbers), *self.shape_in(space)), FORMATS[source][0])
        shards = numbers // self.shard
        for shard in np.unique(shards):
            in_shard = shards == shard
            wanted = numbers[in_shard]
            read = self._of_shard(source, shard, slice(wanted.min(), wanted.max() + 1))[wanted - wanted.min()]
            stack[in_shard] = read if space == self.space else [self._converted(name, frame) for frame in read]
        if name in DERIVED:
            stack = self._compensated(stack, space)
        return stack if np.ndim(frames) else stack[0]

    def _checked(self, numbers: np.ndarray, given: object) -> np.ndarray:
        """Numbers of frames as int64; an IndexError where one is none."""
        if not numbers.size:
            return numbers.astype(np.int64)
        if numbers.dtype.kind not in "iu" or numbers.min() < 0 or numbers.max() >= len(self):
            raise IndexError(f"{self.folder}: frames={shown(given)}: allowed are their numbers, 0 to {len(self) - 1}")
        return numbers.astype(np.int64)

    def _converted(self, name: str, frame: np.ndarray) -> np.ndarray:
        """One stored frame in the other space: the nearest label, other values by bilinear interpolation."""
        converter = self.converter
        to_image = self.space is Space.beam
        if name == "segmentation":
            return converter.labels_to_image(frame) if to_image else converter.labels_to_beam(frame)
        converted = converter.to_image(frame) if to_image else converter.to_beam(frame)
        return converted if converted.dtype == frame.dtype else np.rint(converted).astype(frame.dtype)

    def _compensated(self, stack: np.ndarray, space: Space) -> np.ndarray:
        if self.probe is None or self.simulator is None:
            raise ValueError(f"{self.folder}: compensated attenuation needs the probe and the TGC of the simulation")
        compensate = compensated_attenuation if space == Space.image else compensated_beam
        shares = compensate(decode_attenuation(stack), self.probe, self.simulator.time_gain)
        return np.rint(shares * ATTENUATION_SCALE).astype(np.uint16)

    def _of_shard(self, name: str, shard: int, frames: slice) -> np.ndarray:
        """A range of frames, all of one shard, as stored."""
        file = self.shard_file(name, shard)
        if not file.exists():  # Zarr would read zeros
            raise FileNotFoundError(f"{file}: not made yet; {MEND} makes it")
        if name not in self._arrays:
            shape = len(self), *self.stored_shape
            self._arrays[name] = open_frames(self._array_folder(name), shape, FORMATS[name][0])
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
        """Frames of one map as values; it raises what `stored` does.

        Parameters
        ----------
        name : str
            Of the map: a key of `FORMATS` or of `DERIVED`, or `depth`, `lateral` or `grain`.
        frames : (k,) int
            Numbers of frames.
        space : Space
            In which the frames are wanted.

        Returns
        -------
        (k, H, W) or, in beam space, (k, rows, scanlines)
            Labels and grey levels are uint8. Maps of attenuation and of surfaces are float32 in [0, 1], and those of
            position, `depth` and `lateral`, float32 in [-1, 1]. Grain, of beam space alone, is
            (k, rows, scanlines, 2) complex64.
        """
        if name == GRAIN:
            return np.stack([self._grain(frame) for frame in self._checked(np.asarray(frames), frames)])
        if name in OF_POSITION:
            return np.broadcast_to(self.positions(space)[name], (len(frames), *self.shape_in(space))).copy()
        stored = self.stored(name, frames, space)
        if stored.dtype == np.uint16:
            return decode_attenuation(stored)
        return stored / np.float32(255) if name in OF_SURFACES else stored

    def _grain(self, frame: int) -> np.ndarray:
        """The lattice of scatterers that a frame's pose sees; it takes less time than reading it would."""
        from ablate.ultrasound import grain  # here, because it is compiled

        if self.simulator is None:
            raise ValueError(f"{self.folder}: grain needs the probe and the settings of the simulation")
        return grain(self.poses[frame], self._geometry, self.simulator, self.seed)

    def positions(self, space: Space = Space.image) -> dict[str, np.ndarray]:
        """The maps of position, by name."""
        return position_maps(self._geometry, self.shape if Space(space) is Space.image else None, self.beam_shape)

    def mask(self, space: Space = Space.image) -> np.ndarray:
        """The fan, (H, W) bool; in beam space it is everything."""
        if Space(space) is Space.beam:
            return np.ones(self.beam_shape, bool)
        return read_whole(self._array_folder("mask"))
