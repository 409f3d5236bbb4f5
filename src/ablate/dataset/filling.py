"""Making the shards of a data set, by any number of processes that know nothing of each other."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import zarr
from filelock import FileLock, Timeout

from ablate.dataset.pairs import FORMATS, DamagedShardError, Pairs, encode_attenuation
from ablate.dataset.shards import create_array, write_shard

Renderer = Callable[[np.ndarray, frozenset[str]], Mapping[str, np.ndarray]]


def fill_pairs(pairs: Pairs, maps: frozenset[str], render: Renderer) -> Iterator[int]:
    """Make the shards that are missing and that nobody else is making; yield the frames made after each.

    A shard is written whole under another name and renamed into place, with a checksum for each frame, so a kill
    loses at most the one in flight. Shards that another process holds are skipped; where file locks do not reach
    from one machine to the other, a shard may be made twice, with the same content.

    Parameters
    ----------
    pairs : Pairs
    maps : frozenset of str, out of `FORMATS`
    render : callable (frames (k,) int64, wanted maps) -> {name: (k, H, W) array}
        uint8, but `attenuation` float in [0, 1]; a map may be left out of frames that have none by zeros.

    Raises
    ------
    OSError
        When a shard cannot be written, as on a full disk; those before it stay.
    """
    _create_maps(pairs, maps)
    for shard in pairs.missing(maps):
        with _claimed(pairs, shard) as mine:
            names = pairs.missing_in_shard(shard, maps) if mine else None
            if not names:
                continue
            frames = pairs.frames_of_shard(shard)
            made = render(frames, names)
            for name in sorted(names):
                _write(pairs, name, shard, made[name])
            yield len(frames)


def unclaimed(pairs: Pairs, maps: frozenset[str]) -> tuple[int, ...]:
    """Shards that are missing and that nobody is making at the moment."""
    free = []
    for shard in pairs.missing(maps):
        with _claimed(pairs, shard) as mine:
            if mine:
                free.append(shard)
    return tuple(free)


def remove_damaged(
    pairs: Pairs, maps: frozenset[str], progress: Callable[[int], object] | None = None
) -> tuple[str, ...]:
    """Compare every shard with its checksums and remove what does not match, so that it counts as missing.

    Parameters
    ----------
    pairs : Pairs
    maps : frozenset of str
    progress : callable (shards checked since the last call), optional

    Returns
    -------
    tuple of str
        What was wrong with each shard that was removed.
    """
    found = []
    for name in sorted(maps):
        for shard in range(pairs.shards):
            if pairs.shard_file(name, shard).exists():
                found.append(_remove_if_damaged(pairs, name, shard))
                if progress is not None:
                    progress(1)
    return tuple(why for why in found if why)


def _remove_if_damaged(pairs: Pairs, name: str, shard: int) -> str | None:
    try:
        pairs.check(name, shard)
    except DamagedShardError:
        with _lock(pairs, shard):  # another process may have made it anew meanwhile
            try:
                pairs.check(name, shard)
            except DamagedShardError as error:
                pairs.shard_file(name, shard).unlink()
                return error.what
    return None


def _write(pairs: Pairs, name: str, shard: int, stack: np.ndarray) -> None:
    file = pairs.shard_file(name, shard)
    frames = map(encode_attenuation, stack) if name == "attenuation" else stack
    try:
        write_shard(file, frames, pairs.shard, FORMATS[name])
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
            create_array(group, name, (len(pairs), *pairs.shape), pairs.shard, FORMATS[name])


def _lock(pairs: Pairs, shard: int) -> FileLock:
    path: Path = pairs.folder / f".shard{shard}.lock"
    return FileLock(path)


@contextmanager
def _claimed(pairs: Pairs, shard: int) -> Iterator[bool]:
    """Whether this process may make the shard, for as long as the context lasts."""
    lock = _lock(pairs, shard)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        yield False
        return
    try:
        yield True
    finally:
        lock.release()
