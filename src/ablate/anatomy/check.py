"""What is wrong with a scene, told before rays meet it, at a cost that a scene of a million triangles can bear.

Owners are found by counting crossings, so a structure must enclose its inside: through a hole a ray enters without
crossing anything, and owns the wrong tissue to its end.
"""

from __future__ import annotations

import warnings

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ablate.anatomy.closing import odd_edges, simple_loops
from ablate.anatomy.meshes import array_fault, have_area, merge_vertices, with_three_corners
from ablate.anatomy.scene import Scene, Structure, bounds_mm

GAP = 1e-5  # of a structure's largest extent: vertices nearer than this count as one, and no ray finds such a gap
#: Largest extent of a body: a superficial gland, and more than a whole adult. Metres read as mm make an abdomen 0.3 mm
#: large, micrometres 300 m; a tenfold slip is only seen upwards, for 34 mm is a plausible organ.
BODY_MM = (5.0, 2250.0)
_BODY_DEPTH_MM = 150.0  # the imaging depth that goes with it: a scene scaled together with its probe is as good as any
_CHUNK = 256


def check_scene(scene: Scene, depth_mm: float) -> None:
    """Refuse structures that would be imaged wrongly; warn of a size that points to a wrong unit.

    Parameters
    ----------
    scene : Scene
    depth_mm : float
        How deep the probe images.

    Raises
    ------
    ValueError
        Naming the structure by index and tissue: when it has no triangles or none with an area, a triangle names a
        vertex that is not there, a vertex is not finite or beyond 1.8e18 mm, or the surface is not closed.

    Warns
    -----
    UserWarning
        When the scene's largest extent is not that of a body (`BODY_MM`, for a depth of 150 mm).
    """
    for number, structure in enumerate(scene.structures):
        problem = _problem(structure)
        if problem:
            raise ValueError(f"scene {scene.name!r}: structure {number} ({structure.tissue.name}) {problem}")
    if not scene.structures:
        return
    size_mm, scale = largest_extent_mm(scene), depth_mm / _BODY_DEPTH_MM
    small = size_mm < BODY_MM[0] * scale and len(scene.structures) > 1  # a lone one may be a point target
    if small or size_mm > BODY_MM[1] * scale:
        warnings.warn(
            f"scene {scene.name!r}: its largest extent is {size_mm:.3g} mm and the probe images {depth_mm:.3g} mm "
            "deep; are the vertices in mm?",
            stacklevel=3,  # whoever builds the simulator
        )


def largest_extent_mm(scene: Scene) -> float:
    """Of the bounding box around all structures; there must be one."""
    return float(np.ptp(bounds_mm(s.mesh for s in scene.structures), axis=0).max())


def _problem(structure: Structure) -> str | None:
    """What keeps a structure from being imaged rightly; None for nothing."""
    vertices = np.asarray(structure.mesh.vertices, np.float64)
    faces = np.asarray(structure.mesh.faces)
    if fault := array_fault(vertices, faces):
        return fault
    chunks = range(0, len(faces), _CHUNK)
    if not any(have_area(vertices, faces[start : start + _CHUNK]).any() for start in chunks):
        return f"has no triangle with an area ({len(faces)} without)"
    if _closed_by_hash(vertices, faces):
        return None
    edges, width_mm = openings(vertices, faces)
    if edges == 0:
        return None
    return (
        f"is not closed: {edges} open edges, the largest hole {width_mm:.3g} mm wide; "
        "ablate.anatomy.meshes.repair drops doubled triangles and closes flat holes"
    )


def _closed_by_hash(vertices: np.ndarray, faces: np.ndarray) -> bool:
    """Whether each edge lies in an even number of triangles, all different; never wrongly true in practice.

    The exclusive or of the hashes of all edges is zero when every edge occurs an even number of times, and else for
    one mesh in about 2^60 (Zobrist hashing), which needs no sorting of edges. An edge's hash is the squared
    difference of its vertices': it has no direction, and one from a vertex to itself counts nothing. A vertex's is
    one of its coordinates, so triangles may share vertices or repeat them.
    """
    a, b, c = _place_hash(vertices)[faces.T]
    total = np.uint64(0)
    for start, end in ((a, b), (b, c), (c, a)):
        difference = start - end
        total ^= np.bitwise_xor.reduce(difference * difference)
    triangles = np.sort(a * b * c)
    return total == 0 and not (triangles[1:] == triangles[:-1]).any()


def _place_hash(vertices: np.ndarray) -> np.ndarray:
    """A 64-bit hash of each vertex's coordinates, (n,) uint64; rounds of multiply and shift as in SplitMix64."""
    bits = (vertices + 0.0).view(np.uint64)  # -0 becomes 0
    mixed = np.full(len(bits), 0x9E3779B97F4A7C15, np.uint64)
    for column in bits.T:
        mixed = (mixed + column) * np.uint64(0xBF58476D1CE4E5B9)
        mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0x94D049BB133111EB)
        mixed ^= mixed >> np.uint64(31)
    return mixed


def openings(vertices: np.ndarray, faces: np.ndarray) -> tuple[int, float]:
    """Holes that a ray can pass through.

    A triangle that occurs twice counts once, as it does for a ray; vertices within `GAP` of the extent are one; a hole
    that is narrower, where a long edge meets several short ones, is none.

    Parameters
    ----------
    vertices : (n, 3) float, mm
    faces : (m, 3) int

    Returns
    -------
    edges : int
        On the rims of all holes; 0 for a closed surface.
    width_mm : float
        Greatest diameter of a hole.
    """
    vertices, faces = merge_vertices(vertices, faces)
    faces = np.unique(np.sort(faces, axis=1), axis=0)
    gap_mm = GAP * float(np.ptp(vertices, axis=0).max())
    near = cKDTree(vertices).query_pairs(gap_mm, output_type="ndarray")
    links = coo_array((np.ones(len(near), bool), near.T), shape=(len(vertices),) * 2)
    _, place = connected_components(links, directed=False)
    points = np.empty_like(vertices)
    points[place] = vertices
    loops = simple_loops(odd_edges(with_three_corners(place[faces])))
    spans = [_spans(points[loop]) for loop in loops]
    holes = [(len(loop), long) for loop, (long, wide) in zip(loops, spans, strict=True) if wide > 2 * gap_mm]
    return sum(edges for edges, _ in holes), max((long for _, long in holes), default=0.0)


def _spans(points: np.ndarray) -> tuple[float, float]:
    """Extent of points along their first and second principal axes."""
    offset = points - points.mean(axis=0)
    along = np.ptp(offset @ np.linalg.eigh(offset.T @ offset)[1], axis=0)
    return float(along[2]), float(along[1])
