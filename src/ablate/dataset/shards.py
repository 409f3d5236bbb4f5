"""Arrays of frames in the sharding of Zarr version 3, with a checksum for each frame and for each shard's index."""

from dataclasses import dataclass
from pathlib import Path

import google_crc32c
import numpy as np
import zarr
from numcodecs import Blosc
from zarr.codecs import BloscCodec, Crc32cCodec
from zarr.core.buffer import Buffer
from zarr.storage import MemoryStore

from ablate.storage import remove_partial, written_whole

_CHECKSUM_BYTES = 4
_ABSENT = 2**64 - 1


@dataclass(frozen=True)
class FrameFormat:
    """How the frames of one map are stored: NumPy's name of the dtype, Blosc's name of the shuffle."""

    dtype: str
    shuffle: str

    @property
    def itemsize(self) -> int:
        return np.dtype(self.dtype).itemsize


def frame_array(frames: int, shape: tuple[int, int], slots: int, how: FrameFormat) -> dict[str, object]:
    """Arguments of `create_array` for an array of frames (n, H, W), `slots` of them a shard."""
    return {
        "shape": (frames, *shape),
        "dtype": how.dtype,
        "chunks": (1, *shape),
        "shards": (slots, *shape),
        "compressors": [
            BloscCodec(cname="zstd", clevel=3, shuffle=how.shuffle, typesize=how.itemsize),
            Crc32cCodec(),
        ],
        "config": {"write_empty_chunks": True},  # a black frame is stored, so that an absent one is an error
    }


def write_shard(path: Path, stack: np.ndarray, slots: int, how: FrameFormat) -> None:
    """Write the first frames, (n, H, W) of `how.dtype`, of a shard that has room for `slots`: whole, or not at all.

    Only one process at a time may write a shard; what others left half-written is removed. On a full disk OSError is
    raised and nothing is left.
    """
    encoded: dict[str, Buffer] = {}
    zarr.create_array(MemoryStore(encoded), **frame_array(len(stack), stack.shape[1:], slots, how))[...] = stack
    path.parent.mkdir(parents=True, exist_ok=True)
    remove_partial(path)
    with written_whole(path) as partial:
        partial.write_bytes(encoded["c/0/0/0"].to_bytes())


def read_frame(path: Path, slot: int, slots: int, how: FrameFormat, shape: tuple[int, int]) -> np.ndarray:
    """Return one frame of a shard, (H, W) of `how.dtype`, without the cost of opening it through Zarr.

    A ValueError says what is wrong with the file.
    """
    with path.open("rb") as file:
        size = 16 * slots + _CHECKSUM_BYTES  # of the index: offset and length of each frame, uint64
        file.seek(max(path.stat().st_size - size, 0))
        offset, length = np.frombuffer(_verified(file.read(size)), "<u8").reshape(-1, 2)[slot]
        if _ABSENT in (offset, length):
            raise ValueError(f"frame {slot} of the shard is absent")
        file.seek(int(offset))
        encoded = _verified(file.read(int(length)))
    frame = np.empty(shape, how.dtype)
    try:
        Blosc().decode(encoded, frame)
    except RuntimeError as error:
        raise ValueError("it cannot be decoded") from error
    return frame


def _verified(data: bytes) -> bytes:
    """Return what stands before the CRC-32C of 4 bytes at the end of `data`."""
    content, checksum = data[:-_CHECKSUM_BYTES], data[-_CHECKSUM_BYTES:]
    if google_crc32c.value(content).to_bytes(_CHECKSUM_BYTES, "little") != checksum:
        raise ValueError("it does not match its checksum")
    return content


def absent_frames(path: Path, slots: int) -> np.ndarray:
    """Return which of a shard's slots hold no frame, (slots,) bool; Zarr reads zeros there."""
    # A shard ends with the offset and length of each frame, 2^64 - 1 where there is none, and a checksum of 4 bytes.
    index = np.fromfile(path, "<u8", 2 * slots, offset=path.stat().st_size - 16 * slots - 4)
    return np.asarray(index[::2] == _ABSENT)
