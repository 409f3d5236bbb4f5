"""Wavefront OBJ."""

import logging
import re
from pathlib import Path

import numpy as np

from ablate.anatomy.meshes.polygons import triangles_of_polygons
from ablate.anatomy.meshes.text import mesh_text, rows_of_three
from ablate.setting import shown

logger = logging.getLogger(__name__)

#: What encloses nothing: looks, names, points, lines. Curves, surfaces and other files are not among them.
_NOT_SOLID = "vt vn vp vw g o s mg usemtl mtllib usemap maplib bevel c_interp d_interp lod shadow_obj trace_obj p l"
PASSED_OVER = frozenset(_NOT_SOLID.split())


def read_obj(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) float64 and triangles (m, 3) int64 of the lines v and f; polygons are cut into triangles.

    Raises ValueError for a line of another kind that could hold a surface, a face that names vertex 0 or one before
    the first, and where a comment of MeshLab declares more vertices or faces than there are.
    """
    text = mesh_text(path)
    solid = re.sub("#.*", "", text)  # a comment that ends with the path of a folder, `C:\\scans\\`, is not continued
    coordinates: list[str] = []
    corners: list[int] = []
    lengths: list[int] = []
    for line in solid.replace("\\\n", " ").split("\n"):
        words = line.split()
        if not words:
            continue
        if words[0] == "v":
            if len(words) not in (4, 7, 8) and not (len(words) == 5 and float(words[4]) == 1):
                allowed = "three numbers, with a weight of 1 or with three or four of a colour"
                raise ValueError(f"{shown(line)}: allowed are {allowed}")
            coordinates += words[1:4]
        elif words[0] in ("f", "fo"):
            if len(words) < 4:
                raise ValueError(f"{shown(line)}: a face has at least three corners")
            corners += _corners(words[1:], len(coordinates) // 3, line)
            lengths.append(len(words) - 1)
        elif words[0] not in PASSED_OVER:
            raise ValueError(f"{shown(line)}: {shown(words[0])} is not read; export polygons, the lines v and f")
    if corners and max(corners) < len(coordinates) // 3 - 1:
        logger.warning("%s: no face names its last vertices; does the file end early?", path.name)
    for kind, arrived in {"Vertices": len(coordinates) // 3, "Faces": len(lengths)}.items():
        declared = sum(map(int, re.findall(rf"^# ?{kind}: (\d+)$", text, re.MULTILINE)))
        if arrived < declared:
            raise ValueError(f"a comment in it declares {declared} {kind.lower()}, {arrived} are there")
    return rows_of_three(coordinates), triangles_of_polygons(np.array(corners, np.int64), np.array(lengths, np.int64))


def _corners(words: list[str], before: int, line: str) -> list[int]:
    """Vertices of a face, counted from 0; negative numbers count back from the `before` vertices above it."""
    numbers = [int(word.partition("/")[0]) for word in words]
    if 0 in numbers:
        raise ValueError(f"{shown(line)}: a face names vertex 0; an OBJ counts from 1")
    if min(numbers) < -before:
        raise ValueError(f"{shown(line)}: a face counts back beyond the {before} vertices above it")
    return [number - 1 if number > 0 else number + before for number in numbers]
