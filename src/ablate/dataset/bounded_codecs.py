"""The codecs of pairs, which look at what a chunk declares before they unpack it.

Zarr unpacks as much as a chunk says, which in 160 kB may be 2 GB. After this module is imported it decodes with these.
"""

import math
from typing import Any

import zarr
from zarr.codecs import BloscCodec, ZstdCodec
from zarr.registry import register_codec

_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


class BoundedBlosc(BloscCodec):
    """Blosc, of chunks that are as long as their array says."""

    async def _decode_single(self, chunk_bytes: Any, chunk_spec: Any) -> Any:
        start = chunk_bytes.as_numpy_array()[:16].tobytes()
        _check(int.from_bytes(start[4:8], "little"), chunk_spec)
        return await super()._decode_single(chunk_bytes, chunk_spec)


class BoundedZstd(ZstdCodec):
    """Zstandard, of chunks that are as long as their array says."""

    async def _decode_single(self, chunk_bytes: Any, chunk_spec: Any) -> Any:
        _check(_zstd_length(chunk_bytes.as_numpy_array()[:18].tobytes()), chunk_spec)
        return await super()._decode_single(chunk_bytes, chunk_spec)


def _zstd_length(start: bytes) -> int:
    """The length that the header of a frame declares, -1 for none: RFC 8878, section 3.1.1.1."""
    if start[:4] != _ZSTD_MAGIC or len(start) < 6:
        return -1
    descriptor = start[4]
    is_single = descriptor >> 5 & 1
    digits = (is_single, 2, 4, 8)[descriptor >> 6]
    place = 5 + (1 - is_single) + (0, 1, 2, 4)[descriptor & 3]  # behind the window and the dictionary
    length = int.from_bytes(start[place : place + digits], "little") if digits else -1
    return length + 256 if digits == 2 else length


def _check(declared: int, chunk_spec: Any) -> None:
    expected = math.prod(chunk_spec.shape) * chunk_spec.dtype.to_native_dtype().itemsize
    if declared != expected:
        raise ValueError(f"a chunk declares {declared:,} bytes; its array has {expected:,} in each")


for _name, _codec in {"blosc": BoundedBlosc, "zstd": BoundedZstd}.items():
    _path = f"{__name__}.{_codec.__name__}"
    register_codec(_name, _codec, qualname=_path)
    zarr.config.set({f"codecs.{_name}": _path})
