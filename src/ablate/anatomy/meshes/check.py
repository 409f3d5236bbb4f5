"""Checks of a scene before rays are cast: closed surfaces, its size, and walls that two structures share.

The tissue at a point is found by counting crossings, so a structure must be closed: a ray that enters through a hole
crosses nothing, and has the wrong tissue to its end.
"""

import logging
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ablate.anatomy.meshes import repair
from ablate.anatomy.scene import Scene, bounds_mm

logger = logging.getLogger(__name__)

TOLERANCE_MM = 1e-4  # between surfaces that lie on each other
_ASIDE_MM = 0.01  # from a surface, on its inner side: where a line begins that looks for another one
_POINTS = 256  # at which a surface is looked at
_FEWEST = 3  # of them: where surfaces cross, or a line meets an edge, there may be one
_FOLDED = 1 - 1e-6  # cosine between two triangles about their common edge: 0.1 degrees
_ASKEW = np.array([0.36, 0.48, 0.8])  # along no axis
GAP = 1e-5  # of a structure's largest extent: vertices nearer than this count as one, and no ray finds such a gap
#: Largest extent of a body: from a superficial gland to more than a whole adult. An abdomen whose metres are read as mm
#: is 0.3 mm large, one in micrometres 300 m. A factor of ten too small is not noticed: 34 mm may be an organ.
BODY_MM = (5.0, 2250.0)
_SHALLOW_MM = 10.0  # no transducer images less
_BODY_DEPTH_MM = 150.0  # the imaging depth for these extents: a scene may be scaled together with its probe
_FIRST = 256  # triangles, one of which nearly always has an area


def check_scene(scene: Scene, depth_mm: float) -> None:
    """Refuse structures whose image would be wrong; warn of walls that coincide, and of what is no size of a body.

    `depth_mm` is the imaging depth of the probe. Raises ValueError, naming the structure by index and tissue, when it
    has no triangles or none with an area, a triangle names a vertex that is not there, a vertex is not finite or beyond
    1.8e18 mm, or the surface is not closed. A UserWarning when the scene's largest extent is not that of a body
    (`BODY_MM`, for a depth of 150 mm; a probe for what lies near the skin, of 10 mm and more, may be put on a whole
    body all the same).
    """
    for number, structure in enumerate(scene.structures):
        vertices, faces = np.asarray(structure.mesh.vertices, np.float64), np.asarray(structure.mesh.faces)
        fault = repair.array_fault(vertices, faces) or _area_fault(vertices, faces) or _hole_fault(vertices, faces)
        if fault:
            raise ValueError(f"scene {scene.name!r}: structure {number} ({structure.tissue.name}) {fault}")
    if not scene.structures:
        return
    warn_of_overlaps(scene)
    size_mm, scale = largest_extent_mm(scene), depth_mm / _BODY_DEPTH_MM
    small = size_mm < BODY_MM[0] * scale and len(scene.structures) > 1  # a lone one may be a point target
    if small or size_mm > BODY_MM[1] * (max(scale, 1.0) if depth_mm >= _SHALLOW_MM else scale):
        warnings.warn(
            f"scene {scene.name!r}: its largest extent is {size_mm:.3g} mm and the probe images {depth_mm:.3g} mm "
            "deep; are the vertices in mm?",
            stacklevel=3,  # whoever builds the simulator
        )


def _area_fault(vertices: np.ndarray, faces: np.ndarray) -> str:
    if repair.have_area(vertices, faces[:_FIRST]).any() or repair.have_area(vertices, faces).any():
        return ""
    return f"has no triangle with an area ({len(faces)} without)"


def _hole_fault(vertices: np.ndarray, faces: np.ndarray) -> str:
    edges, width_mm = openings(vertices, faces)
    if not edges:
        return ""
    advice = "ablate.anatomy.meshes.repair drops doubled triangles and closes flat holes"
    return f"is not closed: {edges} open edges, the largest hole {width_mm:.3g} mm wide; {advice}"


def largest_extent_mm(scene: Scene) -> float:
    """Largest side of the box around all structures, of which there must be at least one."""
    return float(np.ptp(bounds_mm(s.mesh for s in scene.structures), axis=0).max())


def openings(vertices: np.ndarray, faces: np.ndarray) -> tuple[int, float]:
    """Number of edges on the rims of all holes that a ray can pass through, and the largest diameter of a hole, mm.

    A triangle that occurs twice counts once, as it does for a ray. Vertices (n, 3) nearer than `GAP` count as one, and
    a hole that is narrower, where one long edge meets several short ones, does not count.
    """
    vertices, faces = repair.merge_vertices(vertices, faces)
    faces = np.sort(repair.with_three_corners(faces), axis=1)
    faces = faces[trimesh.grouping.unique_rows(faces)[0]]  # np.unique is many times slower
    if len(repair.odd_edges(faces)) == 0:  # closed as it is: no need to look for vertices that are near each other
        return 0, 0.0
    gap_mm = GAP * float(np.ptp(vertices, axis=0).max())
    near = cKDTree(vertices).query_pairs(gap_mm, output_type="ndarray")
    links = coo_array((np.ones(len(near), bool), near.T), shape=(len(vertices),) * 2)
    _, place = connected_components(links, directed=False)
    points = np.empty_like(vertices)
    points[place] = vertices
    loops = repair.simple_loops(repair.odd_edges(repair.with_three_corners(place[faces])))
    spans = [np.ptp(repair.principal_axes(points[loop])[0], axis=0) for loop in loops]
    holes = [(len(loop), long) for loop, (long, wide, _) in zip(loops, spans, strict=True) if wide > 2 * gap_mm]
    return sum(edges for edges, _ in holes), float(max((long for _, long in holes), default=0.0))


def shared_walls(meshes: Sequence[trimesh.Trimesh]) -> list[tuple[str, str, int]]:
    """Pairs of meshes whose surfaces lie on each other, and at how many of `_POINTS` random points of one of them.

    They do where they are nearer than `TOLERANCE_MM`, whatever their triangles are. Pairs have the order of the meshes.
    """
    sampled = [trimesh.sample.sample_surface(mesh, _POINTS, seed=0) for mesh in meshes]
    points = np.array([there for there, _ in sampled])
    normals = np.array([mesh.face_normals[faces] for mesh, (_, faces) in zip(meshes, sampled, strict=True)])
    bounds = np.array([mesh.bounds for mesh in meshes]).reshape(-1, 2, 3)
    lower, upper = bounds[:, 0] - _ASIDE_MM, bounds[:, 1] + _ASIDE_MM
    counts = np.zeros((len(meshes), len(meshes)), int)
    for j, other in enumerate(meshes):
        beside = np.flatnonzero(((lower <= upper[j]) & (upper >= lower[j])).all(axis=1))
        beside = beside[beside != j]
        which, point = np.nonzero(((points[beside] > lower[j]) & (points[beside] < upper[j])).all(axis=-1))
        if len(which):
            owner = beside[which]
            there, normal = points[owner, point], normals[owner, point]
            met, ray, _ = _rays(other).intersects_location(there - _ASIDE_MM * normal, normal, multiple_hits=False)
            on_it = np.linalg.norm(met - there[ray], axis=1) < TOLERANCE_MM
            counts[j] = np.bincount(owner[ray[on_it]], minlength=len(meshes))
        other._cache.clear()  # what trimesh computes of a mesh is six times as large, and would stay with it
    counts = np.triu(np.maximum(counts, counts.T))
    names = [str(mesh.metadata.get("name", f"structure {i}")) for i, mesh in enumerate(meshes)]
    return [(names[i], names[j], int(counts[i, j])) for i, j in np.argwhere(counts >= _FEWEST)]


def _rays(mesh: trimesh.Trimesh) -> Any:
    """A ray caster that the mesh does not keep: each holds a device of Embree, and a process with 1,000 crashes."""
    return type(mesh.ray)(mesh)


def overlaps(mesh: trimesh.Trimesh) -> int:
    """Of how many of `_POINTS` lines through a mesh a part lies in it twice, by its winding: in two pieces of it."""
    points, _ = trimesh.sample.sample_surface(mesh, _POINTS, seed=0)
    towards = np.broadcast_to(_ASKEW, points.shape)
    met, line, face = _rays(mesh).intersects_location(points - 2 * mesh.scale * _ASKEW, towards)
    order = np.lexsort((met @ _ASKEW, line))
    turns = np.where(mesh.face_normals[face[order]] @ _ASKEW < 0, 1, -1)
    by_line = np.split(turns, np.flatnonzero(np.diff(line[order])) + 1)
    return sum(bool((np.abs(np.cumsum(crossings)) > 1).any()) for crossings in by_line)


def folds(mesh: trimesh.Trimesh) -> int:
    """Number of pairs of triangles beside an edge that lie on each other, as of a concave polygon that is cut as a fan.

    A line through both crosses the surface twice at one place, which counts once.
    """
    origin, end = np.moveaxis(mesh.vertices[mesh.face_adjacency_edges], 1, 0)
    edge = trimesh.unitize(end - origin)
    ways = [mesh.vertices[corner] - origin for corner in mesh.face_adjacency_unshared.T]
    off_edge = np.array([way - (way * edge).sum(1, keepdims=True) * edge for way in ways])
    height_mm = np.linalg.norm(off_edge, axis=-1)
    alike = (off_edge[0] * off_edge[1]).sum(1) > _FOLDED * height_mm[0] * height_mm[1]
    return int((alike & (height_mm.min(0) > TOLERANCE_MM)).sum())


def _around(mesh: trimesh.Trimesh, others: Sequence[trimesh.Trimesh], bounds: np.ndarray) -> str:
    """The name of the first of closed meshes, with these bounds, that all of a mesh lies in; empty without one."""
    lower, upper = mesh.bounds
    for k in np.flatnonzero((bounds[:, 0] < lower).all(1) & (bounds[:, 1] > upper).all(1)).tolist():
        points, _ = trimesh.sample.sample_surface(mesh, _POINTS, seed=0)
        if _rays(others[k]).contains_points(points).all():
            return str(others[k].metadata.get("name", "a mesh"))
    return ""


def warn_of_overlaps(scene: Scene) -> None:
    """Log a warning, once a scene, for what is hidden, and for walls that make the tissue behind them wrong."""
    if scene.looked_at:
        return
    object.__setattr__(scene, "looked_at", True)
    meshes = [structure.mesh for structure in scene.structures]
    for first, second, count in shared_walls(meshes):
        where = f"share a wall (at {count} of {_POINTS} points)"
        logger.warning("%s and %s %s: the tissue behind it is wrong; let them overlap", first, second, where)
    bounds = np.array([mesh.bounds for mesh in meshes])
    for number, mesh in enumerate(meshes):
        name = mesh.metadata.get("name", "a mesh")
        if around := _around(mesh, meshes[number + 1 :], bounds[number + 1 :]):
            logger.warning("%s lies within %s, which comes after it and hides it; list it after that", name, around)
        if count := folds(mesh):
            why = f"{count} pairs of its triangles lie on each other, as where concave polygons are cut into triangles"
            logger.warning("%s: %s: the tissue behind them is wrong; export it with triangles", name, why)
        elif mesh.is_winding_consistent and overlaps(mesh) >= _FEWEST:  # or its winding tells nothing
            why = "pieces of it lie in each other, and there it is a cavity; one file for each piece joins them"
            logger.warning("%s: %s", name, why)
        mesh._cache.clear()
