"""Fill a data set with shards; several processes can do so at the same time."""

import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from filelock import FileLock, Timeout
from tqdm import tqdm
from zarr.codecs import BloscCodec, Crc32cCodec
from zarr.storage import MemoryStore

from ablate.dataset.encoding import encode_attenuation
from ablate.dataset.pairs import FORMATS, DamagedShardError, Pairs
from ablate.networks.spec import OF_SURFACES
from ablate.storage import remove_partial, written_whole

_WAIT_S = 1.0
_LINES = 10  # about how many are written where there is no terminal
#: Makes the wanted maps of some frames.
MakeFrames = Callable[[np.ndarray, frozenset[str]], Mapping[str, np.ndarray]]


def fill_pairs(pairs: Pairs, maps: frozenset[str], make: MakeFrames) -> Iterator[int]:
    """Make the shards that are missing and that nobody else is making; yield the frames made after each.

    A shard is written whole under another name and renamed into place, with a checksum for each frame, so a kill
    loses at most the one in flight. Shards that another process holds are skipped; where file locks do not reach
    from one machine to the other, a shard may be made twice, with the same content.

    `make` is called with the numbers of k frames and the names of the wanted maps, out of `FORMATS`. It returns arrays
    (k, *pairs.stored_shape) by name: `attenuation` and maps of surfaces float in [0, 1], or attenuation uint16 as it is
    stored, the others uint8; frames that have no such map are zeros. An OSError when a shard cannot be written, as on a
    full disk; those before it stay.
    """
    with FileLock(pairs.folder / ".create.lock"):
        for half_written in pairs.folder.glob("pairs.zarr/*/*.partial"):
            half_written.unlink()
        group = zarr.open_group(pairs.folder / "pairs.zarr", mode="a", zarr_format=3)
        for name in sorted(maps - pairs.maps):
            group.create_array(name, **frame_array(name, len(pairs), pairs.stored_shape, pairs.shard))
    for shard in pairs.missing(maps):
        with _claimed(pairs, shard) as claimed:
            names = pairs.missing_in_shard(shard, maps) if claimed else frozenset()
            if names:
                frames = pairs.frames_of_shard(shard)
                stacks = make(frames, names)
                for name in sorted(names):
                    _write(pairs, name, shard, stacks[name])
                yield len(frames)


def fill_all(pairs: Pairs, maps: frozenset[str], what: str, fill: Callable[[], Iterator[int]]) -> int:
    """Fill a data set until nothing is missing; what other processes make meanwhile is waited for.

    Parameters
    ----------
    pairs : Pairs
        The data set.
    maps : frozenset of str
        Those that are wanted.
    what : str
        Stands at a bar that grows by the frames; where there is no terminal, a line is written about every tenth.
    fill : callable
        Makes what is missing, as `fill_pairs` does, and yields numbers of frames.

    Returns
    -------
    int
        How many frames `fill` made.
    """
    todo = sum(len(pairs.frames_of_shard(shard)) for shard in pairs.missing(maps))
    made = 0
    with tqdm(total=todo, unit="frame", desc=what, mininterval=1.0, disable=None) as bar:
        while pairs.missing(maps):
            before = made
            for frames in fill():
                bar.update(frames)
                made += frames
                todo = max(todo, made)  # where a shard was found damaged meanwhile
                if bar.disable and made * _LINES // todo > (made - frames) * _LINES // todo:
                    tqdm.write(f"{what}: {made} of {todo} frames", file=sys.stderr)
            if made == before:
                time.sleep(_WAIT_S)
    return made


def frame_array(name: str, frames: int, shape: tuple[int, int], slots: int) -> dict[str, object]:
    """Arguments of `create_array` for the frames of a map.

    Parameters
    ----------
    name : str
        Of the map, a key of `FORMATS`.
    frames : int
        How many there are.
    shape : (H, W)
        Of a frame.
    slots : int
        Frames in a shard.
    """
    dtype, shuffle = FORMATS[name]
    packed = BloscCodec(cname="zstd", clevel=3, shuffle=shuffle, typesize=np.dtype(dtype).itemsize)
    return {
        "shape": (frames, *shape),
        "dtype": dtype,
        "chunks": (1, *shape),
        "shards": (slots, *shape),
        "compressors": [packed, Crc32cCodec()],
        "config": {"write_empty_chunks": True},  # a black frame is stored too, with its checksum
    }


def write_shard(path: Path, name: str, stack: np.ndarray, slots: int) -> None:
    """Write a shard whole, or not at all; what others left half-written is removed.

    Only one process at a time may write a shard.

    Parameters
    ----------
    path : Path
        Of the shard.
    name : str
        Of the map, a key of `FORMATS`.
    stack : (n, H, W)
        The first frames of the shard, in the type in which they are stored.
    slots : int
        Frames for which the shard has room.

    Raises
    ------
    OSError
        When it cannot be written, as on a full disk; nothing is left then.
    """
    encoded: dict[str, Any] = {}
    zarr.create_array(MemoryStore(encoded), **frame_array(name, len(stack), stack.shape[1:], slots))[...] = stack
    path.parent.mkdir(parents=True, exist_ok=True)
    remove_partial(path)
    with written_whole(path) as partial:
        partial.write_bytes(encoded["c/0/0/0"].to_bytes())


def unclaimed(pairs: Pairs, maps: frozenset[str]) -> int:
    """How many shards are missing that nobody is making at the moment."""
    count = 0
    for shard in pairs.missing(maps):
        with _claimed(pairs, shard) as claimed:
            count += claimed
    return count


def remove_damaged(pairs: Pairs, maps: frozenset[str]) -> tuple[str, ...]:
    """Remove the shards that are damaged, so that they count as missing; return what was wrong with each.

    A shard that another process is making is left to it.
    """
    errors = []
    for shard in tqdm(range(pairs.shards), unit="shard", desc="check", mininterval=1.0, leave=False, disable=None):
        with _claimed(pairs, shard) as claimed:
            for name in sorted(maps) if claimed else ():
                try:
                    with suppress(FileNotFoundError):
                        pairs.stored(name, pairs.frames_of_shard(shard), pairs.space)
                except DamagedShardError as error:
                    pairs.shard_file(name, shard).unlink()
                    errors.append(error.what)
    return tuple(errors)


def _write(pairs: Pairs, name: str, shard: int, stack: np.ndarray) -> None:
    file = pairs.shard_file(name, shard)
    if FORMATS[name][0] == "uint16" and stack.dtype != np.uint16:
        stack = np.stack([encode_attenuation(frame) for frame in stack])
    elif name in OF_SURFACES:
        stack = np.rint(stack * 255)
    try:
        write_shard(file, name, stack.astype(FORMATS[name][0], copy=False), pairs.shard)
    except OSError as error:
        numbers = pairs.frames_of_shard(shard)
        what = f"'{name}' of frames {numbers[0]} to {numbers[-1]} was not written, the shards before it are"
        raise OSError(error.errno, f"{error.strerror}; {what}", str(file)) from error


@contextmanager
def _claimed(pairs: Pairs, shard: int) -> Iterator[bool]:
    """Whether this process may make the shard, for as long as the context lasts."""
    lock = FileLock(pairs.folder / f".shard{shard}.lock")
    with suppress(Timeout):
        lock.acquire(timeout=0)
    try:
        yield lock.is_locked
    finally:
        lock.release()
