"""Closing flat open ends, so that every edge lies in an even number of triangles."""

from __future__ import annotations

import numpy as np

FLAT_MM = 2.5  # an open end may be this uneven (two CT slices) ...
FLAT_FRACTION = 0.02  # ... or this part of its width


def odd_edges(faces: np.ndarray) -> np.ndarray:
    """Edges in an odd number of triangles.

    Parameters
    ----------
    faces : (m, 3) int

    Returns
    -------
    (k, 2) int
        Sorted vertex pairs; empty for a mesh that is closed modulo 2. As a graph, every vertex has an even number
        of them.
    """
    if len(faces) == 0:
        return np.empty((0, 2), np.int64)
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64), axis=1)
    span = int(faces.max()) + 1
    keys, counts = np.unique(edges[:, 0] * span + edges[:, 1], return_counts=True)
    keys = keys[counts % 2 == 1]
    return np.stack([keys // span, keys % span], axis=1)


def cap_open_ends(vertices: np.ndarray, faces: np.ndarray, name: str) -> tuple[np.ndarray, tuple[float, ...]]:
    """Triangles that close every flat open end; ends inside one another on a plane become a ring.

    Parameters
    ----------
    vertices : (n, 3) float, mm
    faces : (m, 3) int
    name : str
        For messages.

    Returns
    -------
    caps : (k, 3) int
        On the vertices given; with `faces` they are closed modulo 2.
    widths_mm : tuple of float
        Of the loops closed.

    Raises
    ------
    ValueError
        Naming the mesh and the size of its largest hole that is not flat.
    """
    loops = simple_loops(odd_edges(faces))
    if not loops:
        return np.empty((0, 3), np.int64), ()
    widths, uneven, planes = zip(*(_flatness(vertices[loop]) for loop in loops), strict=True)
    worst = max(
        (
            (width, rise)
            for width, rise in zip(widths, uneven, strict=True)
            if rise > max(FLAT_MM, FLAT_FRACTION * width)
        ),
        default=None,
    )
    if worst is not None:
        raise ValueError(
            f"{name}: cannot be closed: a hole of {worst[0]:.1f} mm is not flat (uneven by {worst[1]:.1f} mm)"
        )
    caps = []
    for group in _nested(vertices, loops, widths, planes):
        plane = planes[group[0]]
        flat = vertices @ plane[:2].T
        ring = loops[group[0]]
        for hole in group[1:]:
            ring = _bridged(flat, ring, loops[hole])
        caps.append(_clip_ears(flat, ring))
    return np.concatenate(caps), widths


def simple_loops(edges: np.ndarray) -> list[np.ndarray]:
    """Split edges, an even number at every vertex, into simple loops of vertices.

    Parameters
    ----------
    edges : (k, 2) int

    Returns
    -------
    list of (n,) int
    """
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


def _flatness(points: np.ndarray) -> tuple[float, float, np.ndarray]:
    """Width and greatest distance from the best plane, mm, and the plane's axes, normal last (3, 3)."""
    offset = points - points.mean(axis=0)
    axes = np.linalg.eigh(offset.T @ offset)[1].T[::-1]
    along = offset @ axes.T
    return float(np.ptp(along[:, 0])), float(np.abs(along[:, 2]).max()), axes


def _nested(
    vertices: np.ndarray,
    loops: list[np.ndarray],
    widths: tuple[float, ...],
    planes: tuple[np.ndarray, ...],
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
            and _contains(vertices[loops[outer]] @ planes[outer][:2].T, point[0] @ planes[outer][:2].T)
        ]
    groups: dict[int, list[int]] = {i: [i] for i in order if len(parents[i]) % 2 == 0}
    for inner, around in parents.items():
        if len(around) % 2 == 1:
            groups[max(around, key=lambda i: len(parents[i]))].append(inner)
    return list(groups.values())


def _contains(polygon: np.ndarray, point: np.ndarray) -> bool:
    """Whether a point is inside a polygon, by crossings."""
    a, b = polygon, np.roll(polygon, -1, axis=0)
    spans = (a[:, 1] > point[1]) != (b[:, 1] > point[1])
    a, b = a[spans], b[spans]
    x = a[:, 0] + (point[1] - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
    return bool((x > point[0]).sum() % 2)


def _area(polygon: np.ndarray) -> float:
    following = np.roll(polygon, -1, axis=0)
    return 0.5 * float(np.sum(polygon[:, 0] * following[:, 1] - following[:, 0] * polygon[:, 1]))


def _bridged(flat: np.ndarray, ring: np.ndarray, hole: np.ndarray) -> np.ndarray:
    """The ring and a hole in it as one loop, joined both ways along the shortest bridge between them."""
    if _area(flat[ring]) * _area(flat[hole]) > 0:
        hole = hole[::-1]
    distance = np.linalg.norm(flat[ring][:, None] - flat[hole][None], axis=2)
    i, j = np.unravel_index(int(distance.argmin()), distance.shape)
    around = np.roll(hole, -int(j))
    return np.concatenate([ring[: i + 1], around, around[:1], ring[i:]])


def _clip_ears(flat: np.ndarray, loop: np.ndarray) -> np.ndarray:
    """Triangles of a simple polygon, (len(loop) - 2, 3), by clipping ears.

    Where the loop crosses itself when laid flat no ear may be empty; then the sharpest convex corner is clipped,
    which still closes the loop.
    """
    ring = loop if _area(flat[loop]) > 0 else loop[::-1]
    triangles = np.empty((len(ring) - 2, 3), np.int64)
    for count in range(len(triangles)):
        triangles[count], ring = _one_ear(flat, ring)
    return triangles


def _one_ear(flat: np.ndarray, ring: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    points = flat[ring]
    before, after = np.roll(points, 1, axis=0), np.roll(points, -1, axis=0)
    turn = _cross(points - before, after - points)
    reach = np.linalg.norm(points - before, axis=1) * np.linalg.norm(after - points, axis=1)
    roundness = turn / np.maximum(reach * np.linalg.norm(after - before, axis=1), 1e-12)
    candidates = np.argsort(-roundness)
    best = int(candidates[0])
    for i in candidates[turn[candidates] > 0]:
        a, b, c = before[i], points[i], after[i]
        inside = (_cross(b - a, points - a) > 0) & (_cross(c - b, points - b) > 0) & (_cross(a - c, points - c) > 0)
        if not inside.any():
            best = int(i)
            break
    ear = ring[[best - 1, best, (best + 1) % len(ring)]]
    return ear, np.delete(ring, best)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
