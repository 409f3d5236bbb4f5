"""Fill a data set with shards; several processes can do so at the same time."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from filelock import FileLock, Timeout
from zarr.codecs import BloscCodec, Crc32cCodec
from zarr.storage import MemoryStore

from ablate.dataset.map_formats import FORMATS, FrameFormat, encode_attenuation
from ablate.dataset.pairs import DamagedShardError, Pairs
from ablate.storage import remove_partial, written_whole

#: Makes the wanted maps of some frames.
MakeFrames = Callable[[np.ndarray, frozenset[str]], Mapping[str, np.ndarray]]


def fill_pairs(pairs: Pairs, maps: frozenset[str], make: MakeFrames) -> Iterator[int]:
    """Make the shards that are missing and that nobody else is making; yield the frames made after each.

    A shard is written whole under another name and renamed into place, with a checksum for each frame, so a kill
    loses at most the one in flight. Shards that another process holds are skipped; where file locks do not reach
    from one machine to the other, a shard may be made twice, with the same content.

    `make` is called with the numbers of k frames and the names of the wanted maps, out of `FORMATS`. It returns arrays
    (k, H, W) by name: `attenuation` float in [0, 1], the others uint8; frames that have no such map are zeros.

    Raises
    ------
    OSError
        When a shard cannot be written, as on a full disk; those before it stay.
    """
    _create_maps(pairs, maps)
    for shard in pairs.missing(maps):
        with _claimed(pairs, shard) as mine:
            if mine and (names := pairs.missing_in_shard(shard, maps)):
                frames = pairs.frames_of_shard(shard)
                made = make(frames, names)
                for name in sorted(names):
                    _write(pairs, name, shard, made[name])
                yield len(frames)


def frame_array(frames: int, shape: tuple[int, int], slots: int, how: FrameFormat) -> dict[str, object]:
    """Arguments of `create_array` for an array of frames (n, H, W), `slots` of them a shard."""
    return {
        "shape": (frames, *shape),
        "dtype": how.dtype,
        "chunks": (1, *shape),
        "shards": (slots, *shape),
        "compressors": [
            BloscCodec(cname="zstd", clevel=3, shuffle=how.shuffle, typesize=np.dtype(how.dtype).itemsize),
            Crc32cCodec(),
        ],
        "config": {"write_empty_chunks": True},  # a black frame is stored too, with its checksum
    }


def write_shard(path: Path, stack: np.ndarray, slots: int, how: FrameFormat) -> None:
    """Write the first frames, (n, H, W) of `how.dtype`, of a shard that has room for `slots`: whole, or not at all.

    Only one process at a time may write a shard; what others left half-written is removed. On a full disk OSError is
    raised and nothing is left.
    """
    encoded: dict[str, Any] = {}
    zarr.create_array(MemoryStore(encoded), **frame_array(len(stack), stack.shape[1:], slots, how))[...] = stack
    path.parent.mkdir(parents=True, exist_ok=True)
    remove_partial(path)
    with written_whole(path) as partial:
        partial.write_bytes(encoded["c/0/0/0"].to_bytes())


def unclaimed(pairs: Pairs, maps: frozenset[str]) -> tuple[int, ...]:
    """Shards that are missing and that nobody is making at the moment."""
    free = []
    for shard in pairs.missing(maps):
        with _claimed(pairs, shard) as mine:
            if mine:
                free.append(shard)
    return tuple(free)


def remove_damaged(
    pairs: Pairs, maps: frozenset[str], progress: Callable[[int], object] = lambda _: None
) -> tuple[str, ...]:
    """Remove the shards that are damaged, so that they count as missing; return what was wrong with each."""
    found = []
    for name in sorted(maps):
        for shard in range(pairs.shards):
            file = pairs.shard_file(name, shard)
            if not file.exists():
                continue
            if _damage(pairs, name, shard):
                with _lock(pairs, shard):
                    if why := _damage(pairs, name, shard):  # another process may have made it anew meanwhile
                        file.unlink()
                        found.append(why)
            progress(1)
    return tuple(found)


def _damage(pairs: Pairs, name: str, shard: int) -> str | None:
    try:
        pairs.check(name, shard)
    except DamagedShardError as error:
        return error.what
    return None


def _write(pairs: Pairs, name: str, shard: int, stack: np.ndarray) -> None:
    file = pairs.shard_file(name, shard)
    if name == "attenuation":
        stack = np.stack([encode_attenuation(frame) for frame in stack])
    try:
        write_shard(file, stack.astype(FORMATS[name].dtype, copy=False), pairs.shard, FORMATS[name])
    except OSError as error:
        numbers = pairs.frames_of_shard(shard)
        what = f"'{name}' of frames {numbers[0]} to {numbers[-1]} was not written, the shards before it are"
        raise OSError(error.errno, f"{error.strerror}; {what}", str(file)) from error


def _create_maps(pairs: Pairs, maps: frozenset[str]) -> None:
    unknown = maps - FORMATS.keys()
    if unknown:
        raise ValueError(f"unknown maps {sorted(unknown)}; allowed: {', '.join(FORMATS)}")
    with FileLock(pairs.folder / ".create.lock"):
        for left in pairs.folder.glob("pairs.zarr/*/*.partial"):
            left.unlink()
        group = zarr.open_group(pairs.folder / "pairs.zarr", mode="a")
        for name in sorted(m for m in maps if m not in group):
            group.create_array(name, **frame_array(len(pairs), pairs.shape, pairs.shard, FORMATS[name]))


def _lock(pairs: Pairs, shard: int) -> FileLock:
    return FileLock(pairs.folder / f".shard{shard}.lock")


@contextmanager
def _claimed(pairs: Pairs, shard: int) -> Iterator[bool]:
    """Whether this process may make the shard, for as long as the context lasts."""
    lock = _lock(pairs, shard)
    with suppress(Timeout):
        lock.acquire(timeout=0)
    try:
        yield lock.is_locked
    finally:
        lock.release()
