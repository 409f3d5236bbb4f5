"""What the structures of a scene are called, and the scene whose labels are its structures."""

import re
from dataclasses import replace
from pathlib import Path

from ablate.anatomy.meshes.mesh_file import MESH_SUFFIXES
from ablate.anatomy.scene import Scene, Structure


def structure_names(scene: Scene) -> list[str]:
    """What each structure is called: as its mesh's file, its label or its mask, without the ending; else as its tissue.

    A label that its volume gives no name is called after its tissue, too: `liver (label 2)`.
    """
    names = []
    for structure in scene.structures:
        name = str(structure.mesh.metadata.get("name") or structure.tissue.name)
        if Path(name).suffix.lower() in MESH_SUFFIXES:
            name = Path(name).stem
        is_numbered = re.fullmatch(r"label \d+", name)
        names.append(f"{structure.tissue.name} ({name})" if is_numbered else name)
    return names


def with_structures_as_tissues(scene: Scene) -> Scene:
    """The scene with a tissue for each name of a structure, which is called as it: its labels are structures.

    Structures of one name and one tissue stay one label.
    """
    named = zip(scene.structures, structure_names(scene), strict=True)
    structures = tuple(Structure(one.mesh, replace(one.tissue, name=name)) for one, name in named)
    return replace(scene, structures=structures)
