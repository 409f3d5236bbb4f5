"""Scene folders: anybody's own anatomy, as meshes or a volume of labels beside a `scene.yaml`."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ablate.anatomy import scene_values as values
from ablate.anatomy.meshes.gltf_document import buffer_files, gltf_document
from ablate.anatomy.meshes.mesh_file import MESH_SUFFIXES
from ablate.anatomy.meshes.vtk_files import NEEDS_VTK, VTK_SUFFIXES, space_of_vtp
from ablate.anatomy.scene import Scene, Structure
from ablate.anatomy.site_grid import SiteGrid
from ablate.anatomy.tissue import Tissue, load_tissues
from ablate.anatomy.volumes.label_map import LabelMap, checked_labels
from ablate.anatomy.volumes.volume_file import SUFFIXES
from ablate.setting import naming, shown

logger = logging.getLogger(__name__)
UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
SCENE_KEYS = ("unit", "background", "labels", "structures", "tissues", "sites")
SITE_KEYS = ("axis", "front", "heights", "angles", "tilts", "rolls", "region")
TISSUE_KEYS = tuple(field.name for field in fields(Tissue) if field.name != "name")

MASKS = "segmentations"  # the folder of TotalSegmentator's masks, beside their image
_SHOWN = 3  # names of files in a line


@dataclass(frozen=True)
class SceneFolder:
    """A checked `scene.yaml`, before any mesh or voxel is read."""

    name: str
    mm_per_unit: float
    background: Tissue
    meshes: tuple[tuple[Path, Tissue], ...]  # of two meshes that overlap, the later one owns the place
    sites: SiteGrid | None
    labels: LabelMap | None = None  # its structures come before the meshes

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file beside the `scene.yaml` that the scene is made from."""
        meshes = tuple(file for mesh, _ in self.meshes for file in mesh_files(mesh))
        return (*meshes, *(self.labels.files if self.labels else ()))


def validate_scene_folder(folder: str | Path) -> SceneFolder:
    """Check a scene folder without reading its meshes, and of volumes only their headers.

    Raises FileNotFoundError when the folder, its `scene.yaml`, a mesh or a volume is missing. Raises ValueError, which
    names file, key and what is allowed, when a key, a unit, a tissue, a value or a volume is not as it should be.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileNotFoundError(f"scene.folder: {folder} is not a folder")
    path = folder / "scene.yaml"
    if not path.is_file():
        raise FileNotFoundError(f"scene.folder: {folder} has no scene.yaml; task=describe proposes one")
    content = values.mapping(values.read_yaml(path), f"{path}", SCENE_KEYS)
    mm_per_unit = UNITS_MM[values.one_of(content.get("unit", "mm"), UNITS_MM, f"{path}: unit")]
    tissues = _tissues(content.get("tissues") or {}, path)
    structures = content.get("structures") or []
    if not isinstance(structures, list):
        raise values.refusal(f"{path}: structures", structures, "lists of {mesh, tissue}")
    meshes = []
    for i, entry in enumerate(structures):
        where = f"{path}: structures[{i}]"
        entry = values.mapping(entry, where, ("mesh", "tissue"))
        mesh = values.file_named(entry.get("mesh"), MESH_SUFFIXES, folder, f"{where}.mesh")
        if mesh.suffix.lower() in VTK_SUFFIXES and find_spec("vtkmodules") is None:
            raise ValueError(f"{where}.mesh: {NEEDS_VTK}")
        if mesh.stat().st_size == 0:
            raise ValueError(f"{where}.mesh: {mesh} is empty")
        mesh_files(mesh)
        meshes.append((mesh, tissues[values.one_of(entry.get("tissue"), tissues, f"{where}.tissue")]))
    background = tissues[values.one_of(content.get("background", "coupling_gel"), tissues, f"{path}: background")]
    labels = checked_labels(content["labels"], folder, tissues, f"{path}: labels") if content.get("labels") else None
    in_space = {"RAS": "labels are"} if labels else {}
    in_space |= {space: f"{mesh.name} is" for mesh, _ in meshes if (space := mesh_space(mesh))}
    if len(in_space) > 1:  # as 3D Slicer marks meshes
        raise ValueError(f"{path}: {in_space['LPS']} in LPS, but {in_space['RAS']} in RAS; export all as RAS")
    labelled = labels.structures if labels else ()
    used = {background.name, *(tissue.name for _, tissue in (*meshes, *labelled))}
    for name in sorted({str(name) for name in content.get("tissues") or ()} - used):
        if near := [other for other in used if other.casefold() == name.casefold()]:
            raise ValueError(f"{path}: tissues.{name}: nothing here is made of it; did you mean {near[0]}?")
    names = {name: name for name in (*(name for name, _ in labelled), *(mesh.name for mesh, _ in meshes))}
    names |= {f"label {label.number}": label.name for label in labels.labels if label.tissue} if labels else {}
    sites = _sites(content["sites"], f"{path}: sites", mm_per_unit, names) if content.get("sites") else None
    return SceneFolder(folder.resolve().name, mm_per_unit, background, tuple(meshes), sites, labels)


def said_of_unnamed(folder: Path, checked: SceneFolder) -> str:
    """A sentence on the meshes and volumes that its scene.yaml does not name; empty where there is none.

    They are those beside it, beside a file that it names, and masks as TotalSegmentator places them.
    """
    named = {file.resolve() for file in checked.files}
    places = {folder, folder / MASKS, *(file.parent for file in checked.files)}
    beside = {path for place in places if place.is_dir() for path in place.iterdir()}
    others = sorted(
        path.relative_to(folder).as_posix()
        for path in beside
        if path.name.lower().endswith((*MESH_SUFFIXES, *SUFFIXES))
        and not path.name.startswith(".")
        and path.resolve() not in named
    )
    more = f" and {len(others) - _SHOWN} more" if len(others) > _SHOWN else ""
    return f"{folder}: not in scene.yaml, so left out: {', '.join(others[:_SHOWN])}{more}" if others else ""


@cache
def _warn_once(text: str) -> None:
    """A study reads its scene when it simulates, and when it times networks."""
    logger.warning("%s", text)


def load_scene(folder: str | Path, cache_dir: Path | None = None) -> Scene:
    """Read a scene folder: its meshes are repaired and closed, in mm; labels become surfaces, in mm of their affine.

    The scene has the name of the folder, and `mesh.metadata["name"]` is the name of the mesh's file or of the label.
    Surfaces made from labels are kept in `cache_dir`, where it is given.

    Raises
    ------
    FileNotFoundError, ValueError
        As `validate_scene_folder`, before any mesh is read; and ValueError from `load_mesh` for a mesh that is
        empty, not finite or cannot be closed, from `labelled_structures`, and when the unit makes the meshes larger
        or smaller than any body.
    """
    # here, because the check of a folder needs no mesh library
    from ablate.anatomy.meshes.check import warn_of_overlaps
    from ablate.anatomy.meshes.repair import load_mesh

    checked = validate_scene_folder(folder)
    if unnamed := said_of_unnamed(Path(folder), checked):
        _warn_once(unnamed)
    path = Path(folder) / "scene.yaml"
    structures = tuple(Structure(load_mesh(mesh, checked.mm_per_unit), tissue) for mesh, tissue in checked.meshes)
    scene = Scene(structures, checked.background, checked.name)
    if structures:
        _check_unit(scene, checked.mm_per_unit, f"{path}: unit")
    if checked.labels:
        from ablate.anatomy.volumes.ends import end_walls
        from ablate.anatomy.volumes.labelled_structures import labelled_structures

        labelled = labelled_structures(checked.labels, f"{path}: labels", cache_dir)
        walls, guessed = end_walls(labelled, checked.labels.volume), checked.labels.guessed
        structures = (*labelled, *structures)
        scene = Scene(structures, checked.background, checked.name, guessed=guessed, end_walls=walls)
    warn_of_overlaps(scene)
    return scene


def load_sites(folder: str | Path) -> SiteGrid:
    """Read the probe sites of a scene folder, in mm and degrees.

    Raises
    ------
    FileNotFoundError, ValueError
        As `validate_scene_folder`; and ValueError when the file has no `sites`.
    """
    sites = validate_scene_folder(folder).sites
    if sites is None:
        raise ValueError(f"{Path(folder) / 'scene.yaml'}: sites: missing; allowed keys are {', '.join(SITE_KEYS)}")
    return sites


def mesh_space(path: Path) -> str:
    """The space that 3D Slicer wrote a mesh in, LPS or RAS, where the file says so: at its beginning, or in a .vtp."""
    if path.suffix.lower() == ".vtp":
        return space_of_vtp(path)
    with path.open("rb") as stream:
        head = stream.read(512)
    return next((space for space in ("LPS", "RAS") if f"SPACE={space}".encode() in head), "")


def mesh_files(path: Path) -> tuple[Path, ...]:
    """The files that a mesh is read from: its own and, for glTF, those of the buffers that it names.

    Materials and textures are not read. A FileNotFoundError or ValueError when a glTF is not readable, or a buffer is
    no file.
    """
    if path.suffix.lower() not in (".gltf", ".glb"):
        return (path,)
    with naming(f"{path}: not readable as glTF: ", (ValueError, AttributeError, TypeError, RecursionError)):
        buffers = [file for file in buffer_files(gltf_document(path)) if file is not None]
    for buffer in buffers:
        if not buffer.is_file():
            raise FileNotFoundError(f"{path}: buffer {shown(buffer.name)} is no file in the folder of the mesh")
        values.check_within(path.parent, buffer, f"{path}: buffer")
    return (path, *buffers)


def _check_unit(scene: Scene, mm_per_unit: float, where: str) -> None:
    """Raise ValueError when a scene's largest extent is not that of a body."""
    from ablate.anatomy.meshes.check import BODY_MM, largest_extent_mm

    (lower, upper), extent_mm = BODY_MM, largest_extent_mm(scene)
    if lower <= extent_mm <= upper:
        return
    sizes_mm = {name: extent_mm / mm_per_unit * factor for name, factor in UNITS_MM.items()}
    unit = next(name for name, factor in UNITS_MM.items() if factor == mm_per_unit)
    better = [f"{name} would make it {size:.3g} mm" for name, size in sizes_mm.items() if lower <= size <= upper]
    raise ValueError(
        f"{where}: {unit} makes the scene's largest extent {extent_mm:.3g} mm; bodies have {lower:g} to {upper:g} mm"
        + (f"; {' and '.join(better)}" if better else "")
    )


def _tissues(content: Any, path: Path) -> dict[str, Tissue]:
    """The built-in table with the file's own tissues added or changed, each from the one that it is `like`."""
    tissues = load_tissues()
    if not isinstance(content, Mapping):
        raise values.refusal(f"{path}: tissues", content, "mappings of names to their values")
    for name, entry in content.items():
        where = f"{path}: tissues.{name}"
        changes = dict(values.mapping(entry or {}, where, ("like", *TISSUE_KEYS)))
        begun = tissues.get(name)
        if "like" in changes:
            begun = tissues[values.one_of(changes.pop("like"), tissues, f"{where}.like")]
        with naming(f"{path}: tissues: "):
            tissues[name] = replace(begun, name=name, **changes) if begun else Tissue(name, **changes)
    return tissues


def _sites(content: Any, where: str, mm_per_unit: float, structures: Mapping[str, str]) -> SiteGrid:
    """The probe sites; `structures` are the names of structures by what they may be called here."""
    lists: dict[str, Any] = {}
    for key, value in values.mapping(content, where, SITE_KEYS).items():
        key_where = f"{where}.{key}"
        if key == "region":
            names = value if isinstance(value, list) else [value]
            lists[key] = tuple(structures[values.one_of(name, structures, key_where)] for name in names)
        elif key in ("axis", "front"):
            lists[key] = values.numbers(value, key_where, 3)
        elif key == "heights":
            lists["heights_mm"] = tuple(mm_per_unit * height for height in values.series(value, key_where))
        else:
            lists[f"{key}_deg"] = values.series(value, key_where)
    with naming(f"{where}: "):
        return SiteGrid(**lists)
