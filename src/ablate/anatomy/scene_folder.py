"""Scene folders: anybody's own anatomy as meshes beside a `scene.yaml`."""

import difflib
import json
import math
import os
from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import yaml

from ablate.anatomy.scene import Scene, Structure
from ablate.anatomy.site_grid import MOST_POSES, SiteGrid
from ablate.anatomy.tissue import Tissue, load_tissues
from ablate.validation import shown

MESH_SUFFIXES = (".obj", ".stl", ".ply", ".off", ".glb", ".gltf")
MOST_BYTES = 2**18  # of a scene.yaml: thousands of structures
UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
SCENE_KEYS = ("unit", "background", "structures", "tissues", "sites")
SITE_KEYS = ("axis", "front", "heights", "angles", "tilts", "rolls", "region")
TISSUE_KEYS = tuple(field.name for field in fields(Tissue) if field.name != "name")


@dataclass(frozen=True)
class SceneFolder:
    """A checked `scene.yaml`, before any mesh is read."""

    name: str
    mm_per_unit: float
    background: Tissue
    meshes: tuple[tuple[Path, Tissue], ...]  # of two meshes that overlap, the later one owns the place
    sites: SiteGrid | None


def validate_scene_folder(folder: str | Path) -> SceneFolder:
    """Check a scene folder without reading its meshes.

    Raises
    ------
    FileNotFoundError
        When the folder, its `scene.yaml` or a mesh is missing.
    ValueError
        When a key, a unit, a tissue or a value is not as it should be; names file, key and what is allowed.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileNotFoundError(f"scene.folder: {folder} is not a folder")
    path = folder / "scene.yaml"
    if not path.is_file():
        raise FileNotFoundError(f"{folder}: no scene.yaml in this folder")
    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"{path}: has {path.stat().st_size} bytes; allowed are at most {MOST_BYTES}")
    try:
        content = yaml.load(path.read_text(encoding="utf-8"), _Loader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # a number or a date may be a ValueError
        raise ValueError(f"{path}: not readable as YAML: {' '.join(str(error).split())}") from None
    content = _mapping(content, f"{path}", SCENE_KEYS)
    unit = content.get("unit", "mm")
    if not isinstance(unit, str) or unit not in UNITS_MM:
        raise ValueError(f"{path}: unit: {shown(unit)} is not one of {', '.join(UNITS_MM)}")
    tissues = _tissues(content.get("tissues") or {}, path)
    structures = content.get("structures") or []
    if not isinstance(structures, list):
        raise ValueError(f"{path}: structures: must be a list of {{mesh, tissue}}, not {shown(structures)}")
    meshes = []
    for i, entry in enumerate(structures):
        where = f"{path}: structures[{i}]"
        entry = _mapping(entry, where, ("mesh", "tissue"))
        meshes.append((_mesh_path(entry, folder, where), _tissue(entry.get("tissue"), tissues, f"{where}.tissue")))
    background = _tissue(content.get("background", "coupling_gel"), tissues, f"{path}: background")
    names = [mesh.name for mesh, _ in meshes]
    sites = _sites(content["sites"], f"{path}: sites", UNITS_MM[unit], names) if content.get("sites") else None
    return SceneFolder(folder.resolve().name, UNITS_MM[unit], background, tuple(meshes), sites)


def load_scene(folder: str | Path) -> Scene:
    """Read a scene folder: its meshes are repaired and closed, in mm.

    The scene has the name of the folder, and `mesh.metadata["name"]` is the name of the mesh's file.

    Raises
    ------
    FileNotFoundError, ValueError
        As `validate_scene_folder`, before any mesh is read; and ValueError from `load_mesh` for a mesh that is
        empty, not finite or cannot be closed, and when the unit makes the scene larger or smaller than any body.
    """
    # here, because the check of a folder needs no mesh library
    from ablate.anatomy.meshes.check import warn_of_shared_walls
    from ablate.anatomy.meshes.repair import load_mesh

    checked = validate_scene_folder(folder)
    structures = tuple(Structure(load_mesh(path, checked.mm_per_unit)[0], tissue) for path, tissue in checked.meshes)
    scene = Scene(structures, checked.background, checked.name)
    if structures:
        _check_unit(scene, checked.mm_per_unit, f"{Path(folder) / 'scene.yaml'}: unit")
    warn_of_shared_walls([structure.mesh for structure in structures])
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


def mesh_files(path: Path) -> tuple[Path, ...]:
    """The files that a mesh is read from: its own and, for glTF, those of the buffers that it names.

    Materials and textures are not read.

    Raises
    ------
    FileNotFoundError, ValueError
        When a glTF is not readable, or a buffer is no file in its folder.
    """
    if path.suffix.lower() not in (".gltf", ".glb"):
        return (path,)
    names = []
    try:
        content = path.read_bytes()
        if path.suffix.lower() == ".glb":  # magic, version, length; then length, type and content of the JSON chunk
            content = content[20 : 20 + int.from_bytes(content[12:16], "little")]
        for buffer in json.loads(content).get("buffers", []):
            uri = buffer.get("uri", "data:")
            if not uri.startswith("data:"):
                names.append(uri)
    except (ValueError, AttributeError, TypeError, RecursionError) as error:
        raise ValueError(f"{path}: not readable as glTF ({type(error).__name__})") from error
    found = [path.parent / name.strip() for name in names]
    for file in found:
        if not (os.path.isfile(file) and file.resolve().is_relative_to(path.parent.resolve())):  # noqa: PTH113
            raise FileNotFoundError(f"{path}: buffer {shown(str(file.name))} is no file in the folder of the mesh")
    return (path, *found)


class _Loader(yaml.SafeLoader):
    """YAML that refuses what goes wrong without a word.

    A key given twice would drop the first one; aliases can make a few hundred bytes stand for gigabytes.
    """

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            event = self.get_event()
            raise yaml.composer.ComposerError(None, None, "aliases (*) are not allowed", event.start_mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen = set()
        for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
            if key.value in seen:
                raise yaml.constructor.ConstructorError(None, None, f"{key.value!r} is given twice", key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


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


def _mapping(value: Any, where: str, allowed: tuple[str, ...]) -> Mapping[str, Any]:
    """The value, if it is a mapping whose keys are all allowed."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{where}: must be a mapping of {', '.join(allowed)}, not {shown(value)}")
    for key in value:
        if key not in allowed:
            hint = _closest(key, allowed)
            raise ValueError(f"{where}: unknown key {shown(key)}{hint}; allowed: {', '.join(allowed)}")
    return value


def _closest(name: object, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(name[:100], list(known), n=3) if isinstance(name, str) else ()
    return f" (did you mean {' or '.join(close)}?)" if close else ""


def _tissue(name: Any, tissues: Mapping[str, Tissue], where: str) -> Tissue:
    if not isinstance(name, str) or name not in tissues:
        raise ValueError(f"{where}: unknown tissue {shown(name)}{_closest(name, tissues)}; known: {', '.join(tissues)}")
    return tissues[name]


def _tissues(content: Any, path: Path) -> dict[str, Tissue]:
    """The built-in table with the file's own tissues added or changed."""
    tissues = load_tissues()
    if not isinstance(content, Mapping):
        raise ValueError(f"{path}: tissues: must be a mapping of names, not {shown(content)}")
    for name, values in content.items():
        changes: dict[str, Any] = {}
        for key, value in _mapping(values or {}, f"{path}: tissues.{name}", TISSUE_KEYS).items():
            here = f"{path}: tissues.{name}.{key}"
            changes[key] = _numbers(value, here, 3) if key == "texture_mm" else _number(value, here)
        try:
            tissues[name] = replace(tissues[name], **changes) if name in tissues else Tissue(name, **changes)
        except ValueError as error:
            raise ValueError(f"{path}: tissues: {error}") from None
    return tissues


def _mesh_path(entry: Mapping[str, Any], folder: Path, where: str) -> Path:
    name = entry.get("mesh")
    if not isinstance(name, str) or not name:
        raise ValueError(f"{where}.mesh: must be a file name, not {shown(name)}")
    path = folder / name
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise ValueError(f"{where}.mesh: {shown(name)} is not one of {', '.join(MESH_SUFFIXES)}")
    if not os.path.isfile(path):  # noqa: PTH113, it is False for a name that is too long
        raise FileNotFoundError(f"{where}.mesh: no file {shown(name)} in {folder}")
    if path.stat().st_size == 0:
        raise ValueError(f"{where}.mesh: {path} is empty")
    mesh_files(path)
    return path


def _sites(content: Any, where: str, mm_per_unit: float, meshes: list[str]) -> SiteGrid:
    content = _mapping(content, where, SITE_KEYS)
    values: dict[str, Any] = {}
    for key, value in content.items():
        here = f"{where}.{key}"
        if key == "region":
            values[key] = _region(value, meshes, here)
        elif key in ("axis", "front"):
            values[key] = _numbers(value, here, 3)
        elif key == "heights":
            values["heights_mm"] = tuple(mm_per_unit * height for height in _series(value, here))
        else:
            values[f"{key}_deg"] = _series(value, here)
    try:
        return SiteGrid(**values)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None


def _region(value: Any, meshes: list[str], where: str) -> tuple[str, ...]:
    """A list of mesh file names of the scene."""
    names = value if isinstance(value, list) else [value]
    for name in names:
        if name not in meshes:
            raise ValueError(f"{where}: no mesh {shown(name)}{_closest(name, meshes)}; known: {', '.join(meshes)}")
    return tuple(names)


def _series(value: Any, where: str) -> tuple[float, ...]:
    """A list of numbers, one number, or {range: [first, last], count: n}."""
    if isinstance(value, Mapping):
        value = _mapping(value, where, ("range", "count"))
        first, last = _numbers(value.get("range"), f"{where}.range", 2)
        count = value.get("count")
        if not isinstance(count, int) or isinstance(count, bool) or not 1 <= count <= MOST_POSES:
            raise ValueError(f"{where}.count: must be a whole number from 1 to {MOST_POSES}, not {shown(count)}")
        step = (last - first) / max(count - 1, 1)
        return tuple(first + i * step for i in range(count))
    return _numbers(value if isinstance(value, list) else [value], where)


def _numbers(value: Any, where: str, count: int | None = None) -> tuple[float, ...]:
    if not isinstance(value, (list, tuple)) or (count is not None and len(value) != count):
        expected = "numbers" if count is None else f"{count} numbers"
        raise ValueError(f"{where}: must be a list of {expected}, not {shown(value)}")
    return tuple(_number(item, where) for item in value)


def _number(value: Any, where: str) -> float:
    try:
        if not isinstance(value, bool) and isinstance(value, (int, float)) and math.isfinite(number := float(value)):
            return number
    except OverflowError:
        pass
    raise ValueError(f"{where}: must be a finite number, not {shown(value)}")
