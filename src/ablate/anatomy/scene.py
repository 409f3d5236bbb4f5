"""A scene: closed surfaces, the tissue in each, and the tissue around them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import astuple, dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ablate.anatomy.tissue import Tissue

if TYPE_CHECKING:
    import trimesh

ANATOMY_VERSION = 2  # of the built-in anatomy, the tissue table and mesh repair: raised when a scene changes


def _check_tissue(what: str, value: object) -> None:
    if not isinstance(value, Tissue):
        raise TypeError(f"{what} must be a Tissue, not {value!r}; load_tissues() has the built-in ones by name")


@dataclass(frozen=True)
class Structure:
    """One closed surface and the tissue inside it; vertices in mm, winding irrelevant.

    Raises
    ------
    TypeError
        When the mesh is no `trimesh.Trimesh` (trimesh loads files of several parts as a `trimesh.Scene`) or the
        tissue is no `Tissue`.
    """

    mesh: trimesh.Trimesh
    tissue: Tissue

    def __post_init__(self) -> None:
        import trimesh  # only here: whoever needs no mesh does not load the mesh library

        if not isinstance(self.mesh, trimesh.Trimesh):
            raise TypeError(f"structure: mesh must be a trimesh.Trimesh, not {type(self.mesh).__name__}")
        _check_tissue("structure: tissue", self.tissue)


@dataclass(frozen=True)
class Scene:
    """Structures in a background: where structures overlap, the later one owns the point.

    Without structures the scene is all background.

    Raises
    ------
    TypeError
        When a structure is no `Structure` or the background is no `Tissue`.
    """

    structures: tuple[Structure, ...]
    background: Tissue
    name: str

    def __post_init__(self) -> None:
        listed = isinstance(self.structures, (tuple, list))
        if not listed or not all(isinstance(structure, Structure) for structure in self.structures):
            raise TypeError("scene: structures must be a tuple of Structure")
        object.__setattr__(self, "structures", tuple(self.structures))
        _check_tissue("scene: background", self.background)

    @cached_property
    def tissues(self) -> tuple[Tissue, ...]:
        """Background first, then by first use; `Frame.segmentation` is an index into this plus one."""
        return tuple(dict.fromkeys((self.background, *(s.tissue for s in self.structures))))

    @cached_property
    def structure_tissues(self) -> tuple[int, ...]:
        """Index in `tissues` of the tissue of each structure."""
        index = {tissue: i for i, tissue in enumerate(self.tissues)}
        return tuple(index[s.tissue] for s in self.structures)


def bounds_mm(meshes: Iterable[trimesh.Trimesh]) -> np.ndarray:
    """Lower and upper corner of the box around all meshes, (2, 3) float64, mm; zeros where there is none."""
    bounds = np.array([mesh.bounds for mesh in meshes])
    return np.stack([bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)]) if len(bounds) else np.zeros((2, 3))


def content_hash(scene: Scene) -> str:
    """SHA-256, hexadecimal, of a scene's vertices, faces, tissues and background, but not of its name.

    Vertices are rounded to little-endian float32, so that last bits of float64 do not change the hash.
    """
    digest = hashlib.sha256()
    digest.update(repr(astuple(scene.background)).encode())
    for structure in scene.structures:
        digest.update(repr(astuple(structure.tissue)).encode())
        vertices = np.ascontiguousarray(structure.mesh.vertices, dtype="<f4")
        faces = np.ascontiguousarray(structure.mesh.faces, dtype="<i8")
        digest.update(f"{vertices.shape}{faces.shape}".encode())
        digest.update(vertices.tobytes())
        digest.update(faces.tobytes())
    return digest.hexdigest()
