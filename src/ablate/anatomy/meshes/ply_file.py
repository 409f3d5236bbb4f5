"""Polygon File Format (Stanford), in ASCII and binary."""

import re
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ablate.anatomy.meshes.polygons import triangles_of_polygons, triangles_of_strip
from ablate.setting import shown

#: Types of numbers, and their codes for the module struct.
_TYPES = {
    "char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d",
    "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f",
    "float64": "d", "int64": "q", "uint64": "Q", "float16": "e",
}  # fmt: skip
_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_CORNERS = ("vertex_indices", "vertex_index")
READ = ("vertex", "face", "tristrips")
PASSED_OVER = ("edge", "material", "camera")  # elements that enclose nothing


@dataclass(frozen=True)
class _Property:
    """A number of each row, or a list of numbers where it has a `count`."""

    name: str
    kind: str
    count: str = ""


@dataclass(frozen=True)
class _Element:
    name: str
    rows: int
    properties: list[_Property]


def read_ply(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) float64 and triangles (m, 3) int64 of faces of any number of corners and of strips of triangles.

    Raises ValueError where the rows that the header declares are not what the file holds, and for an element that is
    not known, which may hold a surface.
    """
    form, elements, body = _parts(path.read_bytes())
    if form == "ascii":  # each number as eight bytes, then read as a binary file
        words = body.split()
        body = np.fromiter(map(float, words), np.float64, len(words)).tobytes()
        elements = [_Element(e.name, e.rows, [_as_double(p) for p in e.properties]) for e in elements]
    place, order = 0, _ORDERS[form]
    vertices, triangles = np.zeros((0, 3)), [np.zeros((0, 3), np.int64)]
    for element in elements:
        offsets, counts, place = _places(body, place, order, element)
        if element.name == "vertex":
            if missing := [axis for axis in "xyz" if axis not in offsets]:
                raise ValueError(f"its vertices have no {missing[0]}")
            kinds = {p.name: p.kind for p in element.properties}
            vertices = np.stack([_values(body, offsets[axis], order + kinds[axis]) for axis in "xyz"], axis=1)
        elif element.name in READ:
            corners = _corner_list(element)
            lengths = counts[corners.name]
            size = struct.calcsize("=" + corners.kind)
            step = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
            numbers = _values(body, np.repeat(offsets[corners.name], lengths) + size * step, order + corners.kind)
            whole = numbers.astype(np.int64)
            if (whole != numbers).any():
                raise ValueError(f"element {element.name}: its corners are no whole numbers")
            if element.name == "face":
                triangles.append(triangles_of_polygons(whole, lengths))
            else:
                triangles.append(triangles_of_strip(np.insert(whole, np.cumsum(lengths), -1)))
    if rest := len(body[place:].strip()):
        raise ValueError(f"{rest} bytes follow the rows that its header declares")
    return vertices.astype(np.float64), np.concatenate(triangles)


def _parts(content: bytes) -> tuple[str, list[_Element], bytes]:
    """The format, the elements that have rows, and what follows the header."""
    head = re.match(rb"ply[ \t]*(\r\n|\r|\n)(.*?)(?<=[\r\n])end_header[ \t]*(?:\1|\r\n)", content, re.DOTALL)
    if head is None:
        raise ValueError("it does not begin with a header of PLY, from `ply` to `end_header`")
    form, elements = "", dict[str, _Element]()
    for line in head[2].decode("latin-1").splitlines():
        match line.split():
            case ["format", name, "1.0"] if name in _ORDERS:
                form = name
            case ["element", name, rows] if name not in elements and re.fullmatch(r"\d{1,18}", rows):
                elements[name] = _Element(name, int(rows), [])
            case ["property", kind, name] if elements and kind in _TYPES:
                list(elements.values())[-1].properties.append(_Property(name, _TYPES[kind]))
            case ["property", "list", count, kind, name] if elements and kind in _TYPES and count in _TYPES:
                list(elements.values())[-1].properties.append(_Property(name, _TYPES[kind], _TYPES[count]))
            case ["format" | "element" | "property", *_]:
                raise ValueError(f"header: {shown(line)} is no format, element or property of PLY 1.0")
    if not form:
        raise ValueError(f"its header names no format; allowed are {', '.join(_ORDERS)}")
    for name in elements:
        if elements[name].rows and name not in (*READ, *PASSED_OVER):
            known = f"read are {', '.join(READ)}, passed over {', '.join(PASSED_OVER)}"
            raise ValueError(f"element {shown(name)} is not read; {known}")
    return form, [element for element in elements.values() if element.rows], content[head.end() :]


def _as_double(one: _Property) -> _Property:
    return _Property(one.name, "d", one.count and "d")


def _corner_list(element: _Element) -> _Property:
    """The list of corners: the one with its usual name, or the only one."""
    lists = [one for one in element.properties if one.count]
    named = [one for one in lists if one.name in _CORNERS] or lists
    if len(named) != 1:
        names = ", ".join(one.name for one in lists) or "no list"
        raise ValueError(f"element {element.name} has {shown(names)}; its corners are a list {' or '.join(_CORNERS)}")
    return named[0]


def _places(
    body: bytes, start: int, order: str, element: _Element
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], int]:
    """Where each property of each row begins (of a list, its first number), the lengths of lists, and the end.

    A ValueError where the rows are not all there.
    """
    short = f"element {element.name}: its header declares {element.rows} rows"
    if not element.properties or element.rows > len(body) - start:
        raise ValueError(f"{short}, and {len(body) - start} bytes are left for them")
    if any(one.count for one in element.properties):
        return _walk(body, start, order, element, short)
    sizes = [struct.calcsize("=" + one.kind) for one in element.properties]
    rows = start + sum(sizes) * np.arange(element.rows + 1)
    if rows[-1] > len(body):
        raise ValueError(f"{short}, and it ends in row {1 + (len(body) - start) // sum(sizes)}")
    befores = np.cumsum([0, *sizes])
    offsets = {one.name: rows[:-1] + before for one, before in zip(element.properties, befores, strict=False)}
    return offsets, {}, int(rows[-1])


def _walk(
    body: bytes, start: int, order: str, element: _Element, short: str
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], int]:
    """As `_places`, one row after the other, because lists may have different lengths."""
    steps = [
        (one.name, struct.calcsize("=" + one.kind), struct.Struct(order + one.count) if one.count else None)
        for one in element.properties
    ]
    offsets: dict[str, list[int]] = {one.name: [] for one in element.properties}
    counts: dict[str, list[int]] = {one.name: [] for one in element.properties if one.count}
    place = start
    for row in range(element.rows):
        for name, size, count in steps:
            length = 1
            if count:
                if place + count.size > len(body):
                    raise ValueError(f"{short}, and it ends in row {row + 1}")
                number = count.unpack_from(body, place)[0]
                place += count.size
                if not 0 <= number <= len(body) or (length := int(number)) != number:
                    raise ValueError(f"{short}, and row {row + 1} has a list of {number:g} numbers")
                counts[name].append(length)
            offsets[name].append(place)
            place += length * size
        if place > len(body):
            raise ValueError(f"{short}, and it ends in row {row + 1}")
    arrays = [{name: np.array(values, np.int64) for name, values in lists.items()} for lists in (offsets, counts)]
    return arrays[0], arrays[1], place


def _values(body: bytes, offsets: np.ndarray, kind: str) -> np.ndarray:
    """Numbers (n,) at places (n,) of a file."""
    code = np.dtype(kind)
    anywhere = np.ndarray(max(len(body) - code.itemsize + 1, 0), code, body, strides=(1,))
    return anywhere[offsets]
