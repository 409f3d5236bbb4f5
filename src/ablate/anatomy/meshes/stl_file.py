"""STL, in binary and in ASCII."""

import re
from pathlib import Path

import numpy as np

from ablate.anatomy.meshes.text import mesh_text, rows_of_three
from ablate.setting import shown

_HEAD, _TRIANGLE = 84, np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
#: A letter for each kind of line, so that the order of lines is one word, which a regular expression can check.
_CODES = {
    "solid": "s", "facet": "f", "outer": "o", "vertex": "v", "endloop": "l", "endfacet": "d", "endsolid": "e"
}  # fmt: skip
_FACET = "fovvvld"
_TORN_FACET = "f(?:o(?:v(?:v(?:vl?)?)?)?)?"  # its first lines


def read_stl(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Corners (3n, 3) float64 of all triangles, and the triangles (n, 3) int64, of one solid or several.

    Raises ValueError where a binary file is not as long as its header declares, and where an ASCII one is not made of
    whole triangles and whole solids.
    """
    content = path.read_bytes()
    declared = int.from_bytes(content[80:_HEAD], "little")
    if len(content) == _HEAD + declared * _TRIANGLE.itemsize:
        corners = np.frombuffer(content, _TRIANGLE, offset=_HEAD)["corners"].reshape(-1, 3).astype(np.float64)
    elif b"solid" in content[:_HEAD].lower() and b"\0" not in content:
        corners = _ascii_corners(mesh_text(path))
    else:
        length = f"its header declares {declared} triangles, that is {_HEAD + declared * _TRIANGLE.itemsize} bytes"
        raise ValueError(f"{length}, but it has {len(content)}; nor is it an ASCII STL")
    return corners, np.arange(len(corners)).reshape(-1, 3)


def _ascii_corners(text: str) -> np.ndarray:
    lines = [stripped for line in text.split("\n") if (stripped := line.strip())]
    codes = "".join(map(_code, lines))
    whole_solids = re.compile(f"(?:s(?:{_FACET})*e)*").match(codes)
    end = whole_solids.end() if whole_solids else 0
    rest = re.compile(f"s?((?:{_FACET})*)(?:{_TORN_FACET})?").match(codes, end)
    if rest and end < len(codes):
        place = f"after {len(rest[1]) // len(_FACET)} whole triangles of solid {codes.count('e', 0, end) + 1}"
        next_line = f"there is {shown(lines[rest.end()])}" if rest.end() < len(lines) else "the file ends"
        raise ValueError(f"{place}, and before its endsolid, {next_line}")
    words: list[str] = []
    for line, code in zip(lines, codes, strict=True):
        if code == "v":
            _, *numbers = line.split()
            words += numbers
            if len(numbers) != 3:
                raise ValueError(f"{shown(line)}: a vertex has three coordinates")
    return rows_of_three(words)


def _code(line: str) -> str:
    """A letter for what a line is; some write `end solid` for `endsolid`."""
    words = line.lower().split(None, 2)
    return _CODES.get(words[0], "?") if words[0] != "end" else _CODES.get("".join(words[:2]), "?")
