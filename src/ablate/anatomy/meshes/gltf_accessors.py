"""Arrays of a glTF file: accessors on views of buffers, sparse ones, and integers that stand for fractions."""

from collections.abc import Callable, Collection
from typing import Any

import numpy as np

from ablate.anatomy.meshes.gltf_document import Document
from ablate.setting import shown

_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC3": 3}
Buffers = Callable[[int], bytes]


def positions(document: Document, index: Any, buffers: Buffers) -> np.ndarray:
    """Vertices (n, 3) float64 of an accessor; integers are fractions of the largest one where it says so."""
    entry = document.entry("accessors", index)
    values = _accessor(document, index, buffers, "VEC3", _TYPES)
    if values.dtype.kind == "f" or not entry.get("normalized", False):
        return values.astype(np.float64)
    return np.maximum(values / np.iinfo(values.dtype).max, -1.0)


def corners(document: Document, index: Any, buffers: Buffers) -> np.ndarray:
    """Whole numbers (n,) int64 of an accessor of indices."""
    return _accessor(document, index, buffers, "SCALAR", (5121, 5123, 5125)).ravel().astype(np.int64)


def _accessor(document: Document, index: Any, buffers: Buffers, shape: str, kinds: Collection[int]) -> np.ndarray:
    """Numbers (n, width) as they are stored, with those of a sparse accessor in their places."""
    entry, where = document.entry("accessors", index), f"accessors {index}"
    if entry["type"] != shape or entry["componentType"] not in kinds:
        kind = f"{shown(entry['type'])} of componentType {shown(entry['componentType'])}"
        raise ValueError(f"{where} is {kind}; allowed is {shape} of {', '.join(map(str, kinds))}")
    dtype, count, width, sparse = _TYPES[entry["componentType"]], entry["count"], _WIDTHS[shape], entry.get("sparse")
    if "bufferView" in entry:
        values = _rows(document, entry, buffers, dtype, (count, width), where)
    elif sparse and 0 <= count <= 1000 * sparse["count"]:  # the others are 0
        values = np.zeros((count, width), dtype)
    else:
        raise ValueError(f"{where} holds no data")
    if sparse:
        kind = sparse["indices"]["componentType"]
        if kind not in (5121, 5123, 5125):
            raise ValueError(f"{where}: sparse indices have componentType {shown(kind)}; allowed are 5121, 5123, 5125")
        places = _rows(document, sparse["indices"], buffers, _TYPES[kind], (sparse["count"], 1), where)[:, 0]
        if (places >= count).any():
            raise ValueError(f"{where}: a sparse index is not below {count}")
        values = values.copy()
        values[places] = _rows(document, sparse["values"], buffers, dtype, (sparse["count"], width), where)
    return values


def _rows(
    document: Document, entry: dict[str, Any], buffers: Buffers, dtype: str, shape: tuple[int, int], where: str
) -> np.ndarray:
    """An array of a shape in a view; a ValueError where view or buffer are too short for it."""
    view = document.entry("bufferViews", entry["bufferView"])
    content, item = buffers(view["buffer"]), np.dtype(dtype).itemsize
    begin, length, offset = view.get("byteOffset", 0), view["byteLength"], entry.get("byteOffset", 0)
    stride = view.get("byteStride", shape[1] * item)
    size = (shape[0] - 1) * stride + shape[1] * item
    if (
        min(begin, length, offset, shape[0] - 1, stride - 1) < 0
        or offset + size > length
        or begin + length > len(content)
    ):
        needs = f"{shape[0]} rows from byte {offset} on, {stride} bytes each"
        raise ValueError(f"{where} declares {needs}, more than its view of {length} bytes or its buffer holds")
    return np.ndarray(shape, dtype, content, begin + offset, (stride, item))
