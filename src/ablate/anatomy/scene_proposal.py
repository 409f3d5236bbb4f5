"""A scene.yaml proposed for a folder of meshes or volumes that has none: tissues from names, the rest from sizes."""

import csv
import json
import re
from functools import cache
from importlib.resources import files
from pathlib import Path

import numpy as np
import trimesh
from jinja2 import Template

from ablate.anatomy.meshes.check import BODY_MM
from ablate.anatomy.meshes.repair import load_mesh
from ablate.anatomy.scene import bounds_mm
from ablate.anatomy.scene_folder import MESH_SUFFIXES, UNITS_MM
from ablate.anatomy.tissue import TissueKind, load_tissues
from ablate.anatomy.volumes.labels_proposal import proposed_labels
from ablate.anatomy.volumes.volume_file import SUFFIXES

_UNKNOWN = "soft_tissue"
_MISLEADING = {"skin", "lung"}  # a closed skin is the whole body, and the lung of the table is a fetus's
#: What is filled with something hard or empty cuts into what is soft, so it comes later.
_ORDER = (TissueKind.soft, TissueKind.fluid, TissueKind.gas, TissueKind.bone)


def proposed_scene(folder: Path) -> str:
    """A scene.yaml as text, whose comments say what was guessed and why; what cannot be used is in comments, too.

    A FileNotFoundError says that the folder is missing or has neither a mesh nor a volume, and a ValueError why nothing
    in it can be used.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"scene.folder: {folder} is not a folder")
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in MESH_SUFFIXES)
    volumes = sorted(path for path in folder.iterdir() if path.name.lower().endswith(SUFFIXES))
    if not paths and not volumes:
        allowed = ", ".join((*MESH_SUFFIXES, *SUFFIXES))
        raise FileNotFoundError(f"scene.folder: {folder} has no scene.yaml, no mesh and no volume; {allowed}")
    meshes: dict[str, trimesh.Trimesh] = {}
    unusable: dict[str, str] = {}
    try:
        labels = proposed_labels(volumes, tissue_of_name) if volumes else None
    except ValueError as error:
        labels, unusable["volumes"] = None, str(error).removeprefix("scene.folder: ")
    for path in paths:
        try:
            meshes[path.name] = load_mesh(path)
        except ValueError as error:
            unusable[path.name] = str(error)
    if not meshes and not labels:
        raise ValueError(f"scene.folder: {next(iter(unusable.values()))}")
    bounds = bounds_mm(meshes.values()) if meshes else np.zeros((2, 3))
    extent = float(np.ptp(bounds, axis=0).max())
    # the largest unit that makes the scene no larger than a body, preferring mm; beside labels, theirs
    fits = [unit for unit, factor in UNITS_MM.items() if 10 * BODY_MM[0] <= extent * factor <= BODY_MM[1]]
    unit = fits[0] if fits and not labels else "mm"
    tissues, table = {name: tissue_of_name(Path(name).stem) for name in meshes}, load_tissues()
    order = sorted(meshes, key=lambda n: (_ORDER.index(table[tissues[n][0]].kind), -np.prod(meshes[n].extents)))
    structures = [(_quoted(name), *tissues[name]) for name in order]
    lower, upper = np.array(labels["z_mm"]) / UNITS_MM[unit] if labels else bounds[:, 2]
    heights = {"lower": lower + 0.2 * (upper - lower), "upper": upper - 0.2 * (upper - lower)}
    about = {"unit": unit, "extent": extent, "extent_mm": extent * UNITS_MM[unit], "unusable": unusable.values()}
    template = Template(files("ablate.anatomy").joinpath("scene.yaml.jinja").read_text("utf-8"))
    return template.render(structures=structures, labels=labels, quoted=_quoted, **about, **heights)


def _quoted(name: str) -> str:
    """A file's name as YAML reads it."""
    return name if re.fullmatch(r"[A-Za-z][\w.-]*", name, re.ASCII) else json.dumps(name, ensure_ascii=False)


def tissue_of_name(name: str) -> tuple[str, str]:
    """The tissue that the name of a structure points to, and why."""
    stem = re.sub(r"[^a-z]+", "_", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()).strip("_")
    known = load_tissues().keys() - _MISLEADING
    if stem in known:
        return stem, "its name is that of a tissue"
    # beginnings of words, the first that fits decides
    for pattern, tissue in _names():
        if match := re.search(rf"(?:^|_)(?:{pattern})", stem):
            return tissue, f"its name has {match.group().strip('_')}"
    if longest := max((tissue for tissue in known if tissue in stem), key=len, default=None):
        return longest, f"its name has {longest}"
    return _UNKNOWN, "its name says nothing"


@cache
def _names() -> list[tuple[str, str]]:
    """Beginnings of words in the names of files, as a regular expression, and the tissue that each points to."""
    with files("ablate.anatomy").joinpath("names.csv").open(encoding="utf-8") as stream:
        return [(row["beginnings"], row["tissue"]) for row in csv.DictReader(stream)]
