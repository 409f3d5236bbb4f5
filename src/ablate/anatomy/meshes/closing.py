"""Closing flat open ends, so that every edge lies in an even number of triangles."""

import numpy as np
from mapbox_earcut import triangulate_float64
from skimage.measure import points_in_poly

FLAT_MM = 2.5  # an open end may be uneven by this (two CT slices) ...
FLAT_FRACTION = 0.02  # ... or by this part of its width


def odd_edges(faces: np.ndarray) -> np.ndarray:
    """Edges that an odd number of triangles (m, 3) share, as sorted vertex pairs (k, 2); none in a closed mesh.

    Every vertex has an even number of these edges.
    """
    if len(faces) == 0:
        return np.empty((0, 2), np.int64)
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64), axis=1)
    span = int(faces.max()) + 1
    keys, counts = np.unique(edges[:, 0] * span + edges[:, 1], return_counts=True)
    keys = keys[counts % 2 == 1]
    return np.stack([keys // span, keys % span], axis=1)


def cap_open_ends(vertices: np.ndarray, faces: np.ndarray, name: str) -> tuple[np.ndarray, tuple[float, ...]]:
    """Triangles (k, 3) that close every flat open end of faces (m, 3) with vertices (n, 3), and the ends' widths, mm.

    Together with the faces they are closed modulo 2. Where one end lies inside another on the same plane, the space
    between the two is filled. Raises ValueError with `name` and size of the largest hole that is not flat.
    """
    loops = simple_loops(odd_edges(faces))
    if not loops:
        return np.empty((0, 3), np.int64), ()
    laid = [principal_axes(vertices[loop]) for loop in loops]
    widths = tuple(float(np.ptp(along[:, 0])) for along, _ in laid)
    uneven = [float(np.abs(along[:, 2]).max()) for along, _ in laid]
    ends = zip(widths, uneven, strict=True)
    if torn := [(width, rise) for width, rise in ends if rise > max(FLAT_MM, FLAT_FRACTION * width)]:
        width, rise = max(torn)
        raise ValueError(f"{name}: cannot be closed: a hole of {width:.1f} mm is not flat (uneven by {rise:.1f} mm)")
    planes = [axes for _, axes in laid]
    caps = []
    for group in _nested(vertices, loops, widths, planes):
        rings = [loops[i] for i in group]
        corners, stops = np.concatenate(rings), np.cumsum([len(ring) for ring in rings])
        flat = vertices[corners] @ planes[group[0]][:2].T
        caps.append(corners[triangulate_float64(flat, stops.astype(np.uint32)).reshape(-1, 3)])
    # Vertices on a straight line, and rings that cross themselves when laid flat, leave edges open: fans close them.
    left = simple_loops(odd_edges(np.concatenate([faces, *caps])))
    fans = [np.column_stack([np.full(len(ring) - 2, ring[0]), ring[1:-1], ring[2:]]) for ring in left]
    return np.concatenate([*caps, *fans]), widths


def simple_loops(edges: np.ndarray) -> list[np.ndarray]:
    """Split edges (k, 2), of which every vertex has an even number, into loops that pass each vertex (n,) once."""
    neighbours: dict[int, list[int]] = {}
    for a, b in edges.tolist():
        neighbours.setdefault(a, []).append(b)
        neighbours.setdefault(b, []).append(a)
    loops = []
    for start in neighbours:
        while neighbours[start]:
            walk, place = [start], {start: 0}
            while True:
                here = walk[-1]
                step = neighbours[here].pop()
                neighbours[step].remove(here)
                if step in place:  # a simple loop has closed: cut it off and walk on from where it began
                    loop = walk[place[step] :]
                    loops.append(np.array(loop))
                    for vertex in loop[1:]:
                        del place[vertex]
                    walk = walk[: place[step] + 1]
                    if len(walk) == 1:
                        break
                else:
                    place[step] = len(walk)
                    walk.append(step)
    return loops


def principal_axes(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) about their middle along their principal axes, the longest first; and those axes as rows (3, 3)."""
    offset = points - points.mean(axis=0)
    axes = np.linalg.eigh(offset.T @ offset)[1].T[::-1]
    return offset @ axes.T, axes


def _nested(
    vertices: np.ndarray, loops: list[np.ndarray], widths: tuple[float, ...], planes: list[np.ndarray]
) -> list[list[int]]:
    """Groups of one outer loop and the loops directly inside it, on the same plane."""
    order = sorted(range(len(loops)), key=lambda i: -widths[i])
    parents: dict[int, list[int]] = {}
    for rank, inner in enumerate(order):
        point = vertices[loops[inner]]
        parents[inner] = [
            outer
            for outer in order[:rank]
            if abs(planes[outer][2] @ (point[0] - vertices[loops[outer]].mean(axis=0))) <= FLAT_MM
            and points_in_poly(point[:1] @ planes[outer][:2].T, vertices[loops[outer]] @ planes[outer][:2].T)[0]
        ]
    groups = {i: [i] for i in order if len(parents[i]) % 2 == 0}
    for inner, around in parents.items():
        if len(around) % 2 == 1:
            groups[max(around, key=lambda i: len(parents[i]))].append(inner)
    return list(groups.values())
