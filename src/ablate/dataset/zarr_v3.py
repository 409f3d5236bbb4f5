"""Zarr stores opened for reading only where nothing in them can run code: version 3, and the codecs that are written.

Filters of version 2 can unpickle what a stranger stored; what is opened here is refused before anything is decoded.
"""

import math
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import zarr
from zarr.abc.codec import Codec
from zarr.codecs import BytesCodec, Crc32cCodec, ShardingCodec
from zarr.errors import NodeNotFoundError

from ablate.dataset.bounded_codecs import BoundedBlosc, BoundedZstd
from ablate.storage import check_unpacked

# Of several threads Zarr starts some later, which without memory may never return (CPython 140746).
zarr.config.set({"threading.max_workers": 1, "async.timeout": 300})

_READ = (BytesCodec, ShardingCodec, BoundedBlosc, BoundedZstd, Crc32cCodec)


def open_group(path: Path) -> zarr.Group:
    """Open a group; a ValueError where it is none of Zarr version 3."""
    try:
        return zarr.open_group(path, mode="r", zarr_format=3)
    except NodeNotFoundError as error:
        raise ValueError(f"{path}: is no group of Zarr version 3, and nothing else is read") from error


def open_array(path: Path) -> zarr.Array:
    """Open an array; a ValueError where it is none of Zarr version 3, or a codec is none that `create_pairs` writes."""
    try:
        array = zarr.open_array(path, mode="r", zarr_format=3)
    except NodeNotFoundError as error:
        raise ValueError(f"{path}: is no array of Zarr version 3, and nothing else is read") from error
    for codec in _with_inner(array.metadata.codecs):
        if type(codec) not in _READ:
            allowed = ", ".join(kind.__name__ for kind in _READ)
            raise ValueError(f"{path}: is stored with {type(codec).__name__}; allowed are {allowed}")
    check_unpacked(path, math.prod(array.chunks) * array.dtype.itemsize)  # one is unpacked whole
    return array


def open_frames(path: Path, shape: tuple[int, int, int], dtype: str) -> zarr.Array:
    """Open an array of so many frames, each a chunk; a ValueError where it is not what its data set declares."""
    array = open_array(path)
    if (array.shape, array.chunks, array.dtype) != (shape, (1, *shape[1:]), np.dtype(dtype)):
        found = f"{array.dtype} of {array.shape} in chunks of {array.chunks}"
        raise ValueError(f"{path}: is {found}; its data set has {dtype} of {shape} in chunks of {(1, *shape[1:])}")
    return array


def read_whole(path: Path) -> np.ndarray:
    """Read one of the small arrays that are written once; a ValueError where it is damaged."""
    array = open_array(path)
    check_unpacked(path, array.nbytes)
    try:
        return np.asarray(array[...])
    except (ValueError, RuntimeError) as error:
        folder = path.parents[1]
        raise ValueError(f"{path} is damaged ({error}); the set cannot be used without: remove {folder}") from error


def _with_inner(codecs: Iterable[Codec]) -> Iterator[Codec]:
    """The codecs, and those within shards."""
    for codec in codecs:
        yield codec
        if isinstance(codec, ShardingCodec):
            yield from _with_inner((*codec.codecs, *codec.index_codecs))
