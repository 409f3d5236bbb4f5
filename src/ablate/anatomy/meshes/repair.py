"""Repair of real meshes: useless triangles are dropped, flat open ends are closed.

The tissue at a point is found by counting crossings, so winding is irrelevant and a mesh must be closed modulo 2:
every edge lies in an even number of triangles.
"""

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from ablate.anatomy.meshes.closing import cap_open_ends, odd_edges
from ablate.anatomy.meshes.vtk_files import VTK_SUFFIXES, read_vtk

logger = logging.getLogger(__name__)

LARGEST_MM = 1.8e18  # coordinates that Embree takes: within +-1.844e18
NEEDLE = 1e-12  # a triangle of less than this, twice its area over its longest side squared, has no area


@dataclass(frozen=True)
class MeshReport:
    """What was done to a mesh to make it usable."""

    name: str
    merged_vertices: int  # those at the same place as another one
    degenerate: int  # triangles dropped, because they have no area
    duplicate: int  # triangles dropped, because they are copies, or pairs that cancel
    capped_ends: int  # flat open ends closed
    widest_end_mm: float  # 0 where none was closed
    cap_triangles: int


def load_mesh(path: str | Path, mm_per_unit: float = 1.0) -> tuple[trimesh.Trimesh, MeshReport]:
    """Read a mesh file of any format that trimesh knows, or VTK's own, join its pieces, and make it usable, in mm.

    Materials and textures are not read.

    `metadata["name"]` is the name of the file. Raises ValueError, which names the file, where it cannot be read and
    where `repair` does.
    """
    path = Path(path)
    try:
        vertices, faces = read_vtk(path) if path.suffix.lower() in VTK_SUFFIXES else _read(path)
    except Exception as error:  # every reader raises its own
        raise ValueError(f"{path}: not readable as a mesh: {' '.join(str(error).split())}") from error
    if len(faces) == 0:
        raise ValueError(f"{path}: holds no triangles")
    return repair(vertices * mm_per_unit, faces, str(path))


def _read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) and triangles (m, 3) of a file that trimesh knows; none where it holds something else."""
    loaded = trimesh.load_mesh(path, process=False, skip_materials=True)
    if not isinstance(loaded, trimesh.Trimesh):
        return np.empty((0, 3)), np.empty((0, 3), np.int64)
    return np.asarray(loaded.vertices), np.asarray(loaded.faces)


def repair(vertices: np.ndarray, faces: np.ndarray, name: str) -> tuple[trimesh.Trimesh, MeshReport]:
    """Merge vertices (n, 3), mm, drop degenerate and duplicate triangles (m, 3), cap flat open ends.

    `name` stands in messages; its last part becomes `metadata["name"]`. Raises ValueError when nothing is left, a
    vertex is missing or not finite, or a hole cannot be closed.
    """
    if fault := array_fault(vertices, faces):
        raise ValueError(f"{name}: {fault}")
    merged, faces = merge_vertices(vertices, faces)
    cornered = with_three_corners(faces)
    # all needles stay if dropping them would open edges
    kept = _fewest_odd_edges(cornered[have_area(merged, cornered)], cornered)
    unique = _without_duplicates(kept)
    if len(unique) == 0:
        raise ValueError(f"{name}: all its {len(faces)} triangles are degenerate")
    caps, widths_mm = cap_open_ends(merged, unique, name)
    # a lone triangle and its cap are copies: both go
    closed = _of_odd_count(np.concatenate([unique, caps])) if len(caps) else unique
    if len(closed) == 0:
        raise ValueError(f"{name}: its {len(faces)} triangles enclose nothing")
    mesh = trimesh.Trimesh(merged, closed, process=False)
    mesh.metadata["name"] = Path(name).name
    report = MeshReport(
        Path(name).name,
        len(vertices) - len(merged),
        len(faces) - len(kept),
        len(kept) - len(unique),
        len(widths_mm),
        max(widths_mm, default=0.0),
        len(caps),
    )
    if report.degenerate or report.duplicate or report.capped_ends:
        logger.info(
            "%s: dropped %d degenerate and %d duplicate triangles, capped %d flat open ends of up to %.1f mm",
            report.name, report.degenerate, report.duplicate, report.capped_ends, report.widest_end_mm,
        )  # fmt: skip
    return mesh, report


def array_fault(vertices: np.ndarray, faces: np.ndarray) -> str | None:
    """Why vertices (n, 3), mm, and faces (m, 3) are no triangles; None where they are."""
    if len(faces) == 0:
        return "holds no triangles"
    if vertices.shape[1:] != (3,) or faces.shape[1:] != (3,):
        return f"has vertices of {vertices.shape[-1]} coordinates and faces of {faces.shape[-1]} corners, not 3 and 3"
    if faces.min() < 0 or faces.max() >= len(vertices):
        return f"has triangles with vertices that are not among its {len(vertices)}"
    if not _within_reach(vertices) and not _within_reach(vertices[np.unique(faces)]):
        return f"has vertices that are not finite or beyond {LARGEST_MM:g} mm"
    return None


def _within_reach(vertices: np.ndarray) -> bool:
    return bool(max(vertices.max(), -vertices.min()) <= LARGEST_MM)  # false for nan


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


def _without_duplicates(faces: np.ndarray) -> np.ndarray:
    """Each triangle once or, if that leaves fewer open edges, only those that occur an odd number of times, once.

    A surface that was exported twice must stay once. Two copies of one triangle beside a closed surface must both go.
    """
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return _fewest_odd_edges(faces[np.sort(first)], _of_odd_count(faces))


def _of_odd_count(faces: np.ndarray) -> np.ndarray:
    """Each triangle that occurs an odd number of times, once."""
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[np.sort(first[count % 2 == 1])]


def _fewest_odd_edges(*candidates: np.ndarray) -> np.ndarray:
    """The first of the sets of triangles that has the fewest open edges; empty ones come last."""
    return min(candidates, key=lambda faces: len(odd_edges(faces)) if len(faces) else np.inf)
