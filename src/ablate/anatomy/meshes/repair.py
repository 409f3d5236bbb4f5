"""Repair of real meshes: useless triangles are dropped, flat open ends are closed.

The tissue at a point is found by counting crossings, so winding is irrelevant and a mesh must be closed modulo 2:
every edge lies in an even number of triangles.
"""

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh
from mapbox_earcut import triangulate_float64
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from skimage.measure import points_in_poly

from ablate.anatomy.meshes.mesh_file import read_mesh

logger = logging.getLogger(__name__)

LARGEST_MM = 1.8e18  # coordinates that Embree takes: within +-1.844e18
NEEDLE = 1e-12  # a triangle of less than this, twice its area over its longest side squared, has no area
FLAT_MM = 2.5  # an open end may be uneven by this (two CT slices) ...
FLAT_FRACTION = 0.02  # ... or by this part of its width
_SHEET_AREA = 1.5  # a flat open piece of less than this, in areas of the caps on it, is a sheet and no flat vessel


def load_mesh(path: str | Path, mm_per_unit: float = 1.0) -> trimesh.Trimesh:
    """Read a mesh file of a format of `read_mesh`, join its pieces, and make it usable, in mm.

    `metadata["name"]` is the name of the file. Raises ValueError, which names the file, where it cannot be read and
    where `repair` does.
    """
    vertices, faces = read_mesh(Path(path))
    return repair(vertices * mm_per_unit, faces, str(path))


def repair(vertices: np.ndarray, faces: np.ndarray, name: str) -> trimesh.Trimesh:
    """Merge vertices (n, 3), mm, drop degenerate and duplicate triangles (m, 3), cap flat open ends.

    What was done is logged. `name` stands in messages; its last part becomes `metadata["name"]`. Raises ValueError when
    nothing is left, a vertex is missing or not finite, or a hole cannot be closed.
    """
    if fault := array_fault(vertices, faces):
        raise ValueError(f"{name}: {fault}")
    merged, faces = merge_vertices(vertices, faces)
    cornered = with_three_corners(faces)
    # all needles stay if dropping them would open edges
    kept = _fewest_odd_edges(cornered[have_area(merged, cornered)], cornered)
    # A surface that was exported twice must stay once; two copies of one triangle beside a closed surface must both go.
    _, first = np.unique(np.sort(kept, axis=1), axis=0, return_index=True)
    unique = _fewest_odd_edges(kept[np.sort(first)], _of_odd_count(kept))
    if len(unique) == 0:
        raise ValueError(f"{name}: all its {len(faces)} triangles are degenerate")
    solid, sheets_mm = _without_sheets(merged, unique, name)
    caps, widths_mm = cap_open_ends(merged, solid, name)
    # a triangle beside a body and its cap are copies: both go
    closed = _of_odd_count(np.concatenate([solid, caps])) if len(caps) else solid
    if len(closed) == 0:
        raise ValueError(f"{name}: its {len(faces)} triangles enclose nothing: they are flat open sheets")
    if sheets_mm:
        what = f"{len(sheets_mm)} flat open sheets of up to {max(sheets_mm):.1f} mm, which enclose nothing"
        logger.warning("%s: left out %s", Path(name).name, what)
    mesh = trimesh.Trimesh(merged, closed, process=False)
    mesh.metadata["name"] = Path(name).name
    if len(closed) != len(faces):
        logger.info(
            "%s: dropped %d degenerate and %d duplicate triangles, capped %d flat open ends of up to %.1f mm",
            Path(name).name, len(faces) - len(kept), len(kept) - len(unique), len(widths_mm), max(widths_mm, default=0),
        )  # fmt: skip
    return mesh


def array_fault(vertices: np.ndarray, faces: np.ndarray) -> str | None:
    """Why vertices (n, 3), mm, and faces (m, 3) are no triangles; None where they are."""
    if len(faces) == 0:
        return "holds no triangles"
    if faces.min() < 0 or faces.max() >= len(vertices):
        return f"has triangles with vertices that are not among its {len(vertices)}"
    if not np.abs(vertices).max() <= LARGEST_MM and not np.abs(vertices[faces]).max() <= LARGEST_MM:  # also for nan
        return f"has vertices that are not finite or beyond {LARGEST_MM:g} mm"
    return None


def merge_vertices(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) that faces use, those at the same place once; and the faces (m, 3) renumbered."""
    used = np.unique(faces)
    order = np.lexsort(vertices[used].T)
    ordered = vertices[used][order]
    starts = np.r_[True, (np.diff(ordered, axis=0) != 0).any(axis=1)]
    number = np.empty(len(vertices), np.int64)
    number[used[order]] = np.cumsum(starts) - 1
    return ordered[starts], number[faces]


def with_three_corners(faces: np.ndarray) -> np.ndarray:
    """The faces (m, 3) that name no vertex twice."""
    a, b, c = faces.T
    return faces[(a != b) & (b != c) & (c != a)]


def have_area(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Whether triangles are more than needles, (m,) bool."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    twice_area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest = np.maximum(np.linalg.norm(b - a, axis=1), np.linalg.norm(c - a, axis=1))
    return twice_area > NEEDLE * longest**2


def _of_odd_count(faces: np.ndarray) -> np.ndarray:
    """Each triangle that occurs an odd number of times, once."""
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[np.sort(first[count % 2 == 1])]


def _fewest_odd_edges(*candidates: np.ndarray) -> np.ndarray:
    """The first of the sets of triangles that has the fewest open edges; empty ones come last."""
    return min(candidates, key=lambda faces: len(odd_edges(faces)) if len(faces) else np.inf)


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


def _without_sheets(vertices: np.ndarray, faces: np.ndarray, name: str) -> tuple[np.ndarray, list[float]]:
    """The faces (m, 3) without the open pieces that are as flat as a cap on them, and the widths of these pieces, mm.

    A piece is what hangs together by vertices. Closed by a cap, such a sheet would lie on it.
    """
    rims = odd_edges(faces)
    if len(rims) == 0:
        return faces, []
    ends = faces[:, :2].ravel(), faces[:, 1:].ravel()
    links = coo_array((np.ones(2 * len(faces), bool), ends), shape=(len(vertices),) * 2)
    piece = connected_components(links, directed=False)[1]
    order = np.argsort(piece[faces[:, 0]], kind="stable")
    ordered = piece[faces[order, 0]]
    stays, widths = np.ones(len(faces), bool), []
    for number in np.unique(piece[rims[:, 0]]):
        triangles = order[slice(*np.searchsorted(ordered, (number, number + 1)))]
        long, wide, thick = np.ptp(principal_axes(vertices[np.unique(faces[triangles])])[0], axis=0)
        if thick <= FLAT_FRACTION * wide:
            caps = cap_open_ends(vertices, faces[triangles], name)[0]
            if _area(vertices, faces[triangles]) < _SHEET_AREA * _area(vertices, caps):
                stays[triangles] = False
                widths.append(float(long))
    return faces[stays], widths


def _area(vertices: np.ndarray, faces: np.ndarray) -> float:
    return float(trimesh.triangles.area(vertices[faces]).sum())


def cap_open_ends(vertices: np.ndarray, faces: np.ndarray, name: str) -> tuple[np.ndarray, tuple[float, ...]]:
    """Triangles (k, 3) that close every flat open end of faces (m, 3) with vertices (n, 3), and the ends' widths, mm.

    Together with the faces they are closed modulo 2. Where one end lies inside another on the same plane, the space
    between the two is filled. Raises ValueError with `name` and size of the largest hole that is not flat.
    """
    loops = simple_loops(odd_edges(faces))
    if not loops:
        return np.empty((0, 3), np.int64), ()
    offsets, planes = zip(*(principal_axes(vertices[loop]) for loop in loops), strict=True)
    widths = tuple(float(np.ptp(offset[:, 0])) for offset in offsets)
    rises = (float(np.abs(offset[:, 2]).max()) for offset in offsets)
    ends = zip(widths, rises, strict=True)
    if uneven := [(width, rise) for width, rise in ends if rise > max(FLAT_MM, FLAT_FRACTION * width)]:
        width, rise = max(uneven)
        raise ValueError(f"{name}: cannot be closed: a hole of {width:.1f} mm is not flat (uneven by {rise:.1f} mm)")
    caps = []
    for group in _nested(vertices, loops, widths, planes):
        rings = [loops[i] for i in group]
        corners, stops = np.concatenate(rings), np.cumsum([len(ring) for ring in rings])
        flat = vertices[corners] @ planes[group[0]][:2].T
        caps.append(corners[triangulate_float64(flat, stops.astype(np.uint32)).reshape(-1, 3)])
    # Vertices on a straight line, and rings that cross themselves when laid flat, leave edges open: fans close them.
    open_rings = simple_loops(odd_edges(np.concatenate([faces, *caps])))
    fans = [np.column_stack([np.full(len(ring) - 2, ring[0]), ring[1:-1], ring[2:]]) for ring in open_rings]
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
    vertices: np.ndarray, loops: list[np.ndarray], widths: Sequence[float], planes: Sequence[np.ndarray]
) -> list[list[int]]:
    """Groups of one outer loop and the loops directly inside it, on the same plane.

    A loop lies in the narrowest of those around it. Planes a little apart make "on the same plane" no equivalence: the
    loops around a loop's own outer one may be too far from it.
    """
    depth: dict[int, int] = {}
    groups: dict[int, list[int]] = {}
    for inner in sorted(range(len(loops)), key=lambda i: -widths[i]):
        points = vertices[loops[inner]]
        around = [
            outer
            for outer in depth
            if abs(planes[outer][2] @ (points[0] - vertices[loops[outer]].mean(axis=0))) <= FLAT_MM
            and points_in_poly(points @ planes[outer][:2].T, vertices[loops[outer]] @ planes[outer][:2].T).mean() > 0.5
        ]
        depth[inner] = 1 + depth[around[-1]] if around else 0
        if depth[inner] % 2:
            groups[around[-1]].append(inner)
        else:
            groups[inner] = [inner]
    return list(groups.values())
