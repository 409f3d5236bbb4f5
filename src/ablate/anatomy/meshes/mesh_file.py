"""Files of meshes: every format that is read, and what reads it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from ablate.anatomy.meshes.gltf_file import read_gltf
from ablate.anatomy.meshes.obj_file import read_obj
from ablate.anatomy.meshes.off_file import read_off
from ablate.anatomy.meshes.ply_file import read_ply
from ablate.anatomy.meshes.stl_file import read_stl
from ablate.anatomy.meshes.vtk_files import read_vtk
from ablate.setting import naming, shown

_READERS: dict[str, Callable[[Path], tuple[np.ndarray, np.ndarray]]] = {
    ".obj": read_obj,
    ".stl": read_stl,
    ".ply": read_ply,
    ".off": read_off,
    ".glb": read_gltf,
    ".gltf": read_gltf,
    ".vtk": read_vtk,
    ".vtp": read_vtk,
}
MESH_SUFFIXES = tuple(_READERS)


def read_mesh(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) float64 and triangles (m, 3) int64 of a mesh file, all of them, in the unit of the file.

    Looks, points and lines are passed over; what else a format can hold and is not read is refused, and so is a file
    that holds another number of anything than it declares. Raises ValueError, which names the file.
    """
    with naming(f"{path}: not readable as a mesh: ", Exception):  # every reader raises its own
        if path.suffix.lower() not in _READERS:
            raise ValueError(f"{shown(path.suffix)}: allowed are {', '.join(MESH_SUFFIXES)}")
        return _READERS[path.suffix.lower()](path)
