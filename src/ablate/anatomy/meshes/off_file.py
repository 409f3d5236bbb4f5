"""Object File Format, as of Geomview."""

import re
from pathlib import Path

import numpy as np

from ablate.anatomy.meshes.polygons import triangles_of_polygons
from ablate.anatomy.meshes.text import mesh_text, rows_of_three
from ablate.setting import shown


def read_off(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) float64 and triangles (m, 3) int64; colours, normals and textures are passed over.

    Raises ValueError where the header declares another number of vertices, faces or corners than there are, and for a
    kind of OFF whose vertices are not three coordinates.
    """
    lines = [words for line in mesh_text(path).split("\n") if (words := line.partition("#")[0].split())]
    head = re.fullmatch(r"(?:ST)?C?N?OFF(\d*)", lines[0][0]) if lines else None
    if head is None:
        first = shown(" ".join(lines[0])) if lines else "nothing"
        raise ValueError(f"it begins with {first}; allowed are OFF, COFF, NOFF, STOFF and what these make together")
    counts = [*head.groups(), *lines[0][1:]] if head[1] else lines[0][1:]
    lines = lines[1:]
    if not counts and lines:
        counts, lines = lines[0], lines[1:]
    if len(counts) not in (2, 3) or not all(re.fullmatch(r"\d{1,18}", count) for count in counts):
        raise ValueError(f"{shown(' '.join(counts))}: allowed are the numbers of vertices, faces and edges")
    vertices, faces = int(counts[0]), int(counts[1])
    if vertices + faces != len(lines):
        declared = f"{vertices} vertices and {faces} faces"
        raise ValueError(f"its header declares {declared}, a line each, but {len(lines)} lines are there")
    for words in lines[:vertices]:
        if len(words) < 3:
            raise ValueError(f"{shown(' '.join(words))}: a vertex has three coordinates")
    lengths = np.array([int(words[0]) for words in lines[vertices:]], np.int64)
    corners: list[str] = []
    for words, length in zip(lines[vertices:], lengths.tolist(), strict=True):
        if not 0 <= length < len(words):
            raise ValueError(f"{shown(' '.join(words))}: a face declares {length} corners")
        corners += words[1 : length + 1]
    coordinates = rows_of_three([word for words in lines[:vertices] for word in words[:3]])
    return coordinates, triangles_of_polygons(np.fromiter(map(int, corners), np.int64, len(corners)), lengths)
