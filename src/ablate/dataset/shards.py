"""Shard files: the frames of one map, each with a checksum, written whole and read one at a time.

The format is the sharding of Zarr version 3, and zarr opens the arrays: encoded frames one after the other, each
followed by its CRC-32C, then an index with the offset and length of each, uint64, then a CRC-32C of the index.
The files are read and written without zarr, because a frame is then ready in half the time (`make bench-dataset`),
threads may read side by side, and what a kill or a full disk leaves behind is decided here.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO
from uuid import uuid4

import google_crc32c
import numpy as np
import zarr
from numcodecs import Blosc
from zarr.codecs import BloscCodec, Crc32cCodec

_COMPRESSOR, _LEVEL = "zstd", 3
_SHUFFLES = {"noshuffle": Blosc.NOSHUFFLE, "shuffle": Blosc.SHUFFLE, "bitshuffle": Blosc.BITSHUFFLE}
_CHECKSUM_BYTES = 4
_SLOT_BYTES = 16
_ABSENT = 2**64 - 1


@dataclass(frozen=True)
class FrameFormat:
    """How the frames of one map are stored: NumPy's name of the dtype, Blosc's name of the shuffle."""

    dtype: str
    shuffle: str

    @property
    def itemsize(self) -> int:
        return np.dtype(self.dtype).itemsize


def create_array(group: zarr.Group, name: str, shape: tuple[int, int, int], slots: int, how: FrameFormat) -> None:
    """Lay out an array of frames (n, H, W), `slots` of them a shard; only its metadata is written."""
    group.create_array(
        name,
        shape=shape,
        dtype=how.dtype,
        chunks=(1, *shape[1:]),
        shards=(slots, *shape[1:]),
        compressors=[
            BloscCodec(cname=_COMPRESSOR, clevel=_LEVEL, shuffle=how.shuffle, typesize=how.itemsize),
            Crc32cCodec(),
        ],
    )


def write_shard(path: Path, frames: Iterable[np.ndarray], slots: int, how: FrameFormat) -> None:
    """Write the first frames of a shard that has room for `slots`: whole, or not at all.

    Of several processes, one at a time may write a shard; what others left half-written is removed.

    Raises
    ------
    OSError
        When the file cannot be written, as on a full disk; nothing of it is left.
    """
    codec = Blosc(cname=_COMPRESSOR, clevel=_LEVEL, shuffle=_SHUFFLES[how.shuffle])
    parts = [_sealed(codec.encode(np.ascontiguousarray(frame, how.dtype))) for frame in frames]
    index = np.full((slots, 2), _ABSENT, "<u8")
    lengths = np.array([len(part) for part in parts])
    index[: len(parts)] = np.stack([np.cumsum(lengths) - lengths, lengths], axis=1)
    path.parent.mkdir(parents=True, exist_ok=True)
    for left in path.parent.glob("*.partial"):
        left.unlink(missing_ok=True)
    partial = path.with_name(f"{path.name}.{uuid4().hex}.partial")
    try:
        with partial.open("xb") as file:
            file.write(b"".join([*parts, _sealed(index.tobytes())]))
            file.flush()
            os.fsync(file.fileno())  # some file systems notice only here that the disk is full
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def read_frame(path: Path, slot: int, slots: int, how: FrameFormat, shape: tuple[int, int]) -> np.ndarray:
    """Frame number `slot` of a shard that has room for `slots`.

    Returns
    -------
    (H, W) array of `how.dtype`

    Raises
    ------
    FileNotFoundError
        When the shard has not been written.
    ValueError
        When the file is not as it was written.
    """
    with path.open("rb") as file:
        encoded = _encoded(file, _index(file, slots), slot)
    frame = np.empty(shape, how.dtype)
    try:
        Blosc().decode(encoded, frame)
    except RuntimeError as error:
        raise ValueError(f"frame {slot} of the shard cannot be decoded") from error
    return frame


def check_shard(path: Path, used: int, slots: int) -> None:
    """Compare the first `used` frames of a shard and its index with their checksums; nothing is decoded.

    Raises
    ------
    FileNotFoundError, ValueError
        As `read_frame`.
    """
    with path.open("rb") as file:
        index = _index(file, slots)
        for slot in range(used):
            _encoded(file, index, slot)


def _index(file: BinaryIO, slots: int) -> np.ndarray:
    """Offset and length of every frame, (slots, 2) uint64."""
    size = slots * _SLOT_BYTES + _CHECKSUM_BYTES
    if os.fstat(file.fileno()).st_size < size:
        raise ValueError("the file is shorter than its index")
    file.seek(-size, os.SEEK_END)
    return np.frombuffer(_opened(file.read(size), "index"), "<u8").reshape(slots, 2)


def _encoded(file: BinaryIO, index: np.ndarray, slot: int) -> bytes:
    offset, length = (int(v) for v in index[slot])
    if _ABSENT in (offset, length):
        raise ValueError(f"frame {slot} of the shard is absent")
    file.seek(offset)
    return _opened(file.read(length), f"frame {slot} of the shard")


def _sealed(content: bytes) -> bytes:
    return content + google_crc32c.value(content).to_bytes(_CHECKSUM_BYTES, "little")


def _opened(data: bytes, what: str) -> bytes:
    content = data[:-_CHECKSUM_BYTES]
    if len(data) < _CHECKSUM_BYTES or _sealed(content) != data:
        raise ValueError(f"{what} does not match its checksum")
    return content
