"""A scene.yaml proposed for a folder of meshes or volumes that has none: tissues from names, the rest from sizes."""

import json
import os
import re
from importlib.resources import files
from pathlib import Path

import numpy as np
import trimesh
from jinja2 import Template

from ablate.anatomy.meshes.check import BODY_MM
from ablate.anatomy.meshes.repair import load_mesh
from ablate.anatomy.scene import bounds_mm
from ablate.anatomy.scene_folder import MASKS, MESH_SUFFIXES, UNITS_MM, mesh_files, mesh_space
from ablate.anatomy.scene_values import file_named
from ablate.anatomy.tissue_names import place_of_tissue, tissue_of_name
from ablate.anatomy.volumes.labels_proposal import proposed_labels
from ablate.anatomy.volumes.volume_file import SUFFIXES

#: Other formats of meshes and volumes: named, as they are not read.
_OTHERS = (
    ".3mf", ".amf", ".blend", ".ctm", ".dae", ".fbx", ".iges", ".igs", ".msh", ".step", ".stp", ".usdz", ".vtu", ".wrl",
    ".x3d", ".am", ".dcm", ".gipl", ".hdr", ".ima", ".img", ".mgh", ".mgz", ".mha", ".mhd", ".mnc", ".nhdr", ".vti",
)  # fmt: skip


def proposed_scene(folder: Path) -> str:
    """A scene.yaml as text, whose comments say what was guessed and why; what cannot be used is in comments, too.

    A FileNotFoundError says that the folder is missing or has neither a mesh nor a volume, and a ValueError why nothing
    in it can be used.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"scene.folder: {folder} is not a folder")
    meshes, volumes = _candidates(folder)
    if not meshes and not volumes:
        allowed = ", ".join((*MESH_SUFFIXES, *SUFFIXES))
        raise FileNotFoundError(f"scene.folder: {folder} has no scene.yaml, no mesh and no volume; {allowed}")
    left_out: dict[str, str] = {}
    labels = proposed_labels(volumes, folder, left_out) if volumes else None
    loaded = _meshes(meshes, folder, "RAS" if labels else "", left_out)
    unit = _unit(loaded, bool(labels), left_out)
    left_out |= _not_looked_at(folder)
    lines = [_one_line(name, reason, folder) for name, reason in left_out.items()]
    if not loaded and not labels:
        more = f" (and {len(lines) - 3} more files)" if len(lines) > 3 else ""
        raise ValueError(f"scene.folder: {folder}: nothing in it can be used: {'; '.join(lines[:3])}{more}")
    bounds = bounds_mm(loaded.values())
    extent = float(np.ptp(bounds, axis=0).max())
    tissues = {name: tissue_of_name(Path(name).stem) for name in loaded}
    order = sorted(loaded, key=lambda n: (place_of_tissue(tissues[n][0]), -np.prod(loaded[n].extents)))
    structures = [(_quoted(name), *tissues[name]) for name in order]
    lower, upper = np.array(labels["z_mm"]) / UNITS_MM[unit] if labels else bounds[:, 2]
    heights = {"lower": lower + 0.2 * (upper - lower), "upper": upper - 0.2 * (upper - lower)}
    about = {"unit": unit, "extent": extent, "extent_mm": extent * UNITS_MM[unit], "unusable": lines}
    about["in_ras"] = bool(labels) or any(mesh_space(folder / name) == "RAS" for name in loaded)
    template = Template(files("ablate.anatomy").joinpath("scene.yaml.jinja").read_text("utf-8"))
    return template.render(structures=structures, labels=labels, quoted=_quoted, **about, **heights)


def _candidates(folder: Path) -> tuple[list[str], list[str]]:
    """The names of what may be meshes and volumes, by their endings."""
    names = sorted(path.name for path in folder.iterdir())
    meshes = [name for name in names if Path(name).suffix.lower() in MESH_SUFFIXES]
    if (folder / MASKS).is_dir():
        names += sorted(f"{MASKS}/{path.name}" for path in (folder / MASKS).iterdir())
    return meshes, [name for name in names if name.lower().endswith(SUFFIXES)]


def _not_looked_at(folder: Path) -> dict[str, str]:
    """Why what else may hold a structure is not used: by the first file of each other format, and by inner folder."""
    read, paths, why = (*MESH_SUFFIXES, *SUFFIXES), sorted(folder.iterdir()), dict[str, str]()
    for suffix in _OTHERS:
        names = [path.name for path in paths if path.name.lower().endswith(suffix) and not path.name.startswith(".")]
        if names:
            more = f" (and {len(names) - 1} more)" if len(names) > 1 else ""
            why[names[0]] = f"{suffix}{more} is not read; allowed are {', '.join(read)}"
    for inner in paths:
        if inner.is_dir() and inner.name != MASKS and os.access(inner, os.R_OK):
            names = sorted(path.name for path in inner.iterdir() if path.name.lower().endswith(read))
            if names:
                why[inner.name] = f"of folders within this one nothing is taken; {inner.name}/{names[0]} may be named"
    return why


def _meshes(names: list[str], folder: Path, space: str, left_out: dict[str, str]) -> dict[str, trimesh.Trimesh]:
    """The meshes that can be used, by name; all in one space where 3D Slicer wrote theirs, that of labels if any."""
    meshes, spaces = dict[str, trimesh.Trimesh](), dict[str, str]()
    for name in names:
        try:
            path = file_named(name, MESH_SUFFIXES, folder, "scene.folder")
            mesh_files(path)
            meshes[name], spaces[name] = load_mesh(path), mesh_space(path)
        except (ValueError, OSError) as error:
            left_out[name] = str(error)
    known = [one for one in spaces.values() if one]
    space = space or max(("RAS", "LPS"), key=known.count)
    for name, own in spaces.items():
        if own not in ("", space):
            left_out[name] = f"it is in {own}, but others are in {space}; export all as RAS"
    return {name: mesh for name, mesh in meshes.items() if name not in left_out}


def _unit(meshes: dict[str, trimesh.Trimesh], beside_labels: bool, left_out: dict[str, str]) -> str:
    """The unit of meshes: the largest that makes them no larger than a body, preferring mm; beside labels, theirs.

    Where none makes them a body, the largest mesh goes, out of `meshes` and into `left_out`.
    """
    while meshes:
        extent = float(np.ptp(bounds_mm(meshes.values()), axis=0).max())
        bodies = {unit: extent * factor for unit, factor in UNITS_MM.items() if extent * factor <= BODY_MM[1]}
        for least in (10 * BODY_MM[0], BODY_MM[0]):
            fits = [unit for unit, size in bodies.items() if size >= least]
            if beside_labels and bodies.get("mm", 0) >= BODY_MM[0]:
                return "mm"
            if fits:
                return fits[0]
        largest = max(meshes, key=lambda name: float(meshes[name].extents.max()))
        sizes = f"bodies have {BODY_MM[0]:g} to {BODY_MM[1]:g} mm"
        left_out[largest] = f"in none of {', '.join(UNITS_MM)} is its scene, of {extent:.3g}, a body; {sizes}"
        del meshes[largest]
    return "mm"


def _one_line(name: str, reason: str, folder: Path) -> str:
    """What stands behind `left out`: the file, and why, as YAML lets it stand in a comment."""
    reason = reason.removeprefix("scene.folder: ").replace(f"{folder / name}", name)
    text = reason if reason.startswith(name) else f"{name}: {reason}"
    return "".join(letter if letter.isprintable() else "?" for letter in " ".join(text.split()))


def _quoted(name: str) -> str:
    """A file's name as YAML reads it."""
    return name if re.fullmatch(r"[A-Za-z][\w.-]*", name, re.ASCII) else json.dumps(name, ensure_ascii=False)
