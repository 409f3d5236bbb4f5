"""The `labels` of a scene.yaml, checked: files of volumes, the tissue of each label, and the body around them.

The world is RAS+ in mm: x to the patient's right, y to the front, z up, as NIfTI has it.
"""

import csv
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from ablate.anatomy.scene_values import file_named, mapping, number, one_of, refusal
from ablate.anatomy.tissue import Tissue
from ablate.extras import installing
from ablate.setting import naming, shown

SUFFIXES = (".nii", ".nii.gz", ".nrrd")
VOXEL_MM = (0.01, 6.0)  # shortest and longest side; CT has slices of up to 5 mm
MOST_VOXELS = 2**29  # 512 x 512 x 2048
_SQUARE = 1e-3  # largest cosine between two axes
_SLAB_VOXELS = 2**21
#: NRRD names its world, as left-posterior-superior or LPS; the factors take it to RAS+.
_SPACES = {"ras": (1, 1, 1), "lps": (-1, -1, 1), "las": (-1, 1, 1)}
LABELS_VERSION = 2  # of the surfaces that are made from labels: raised when they change
TABLE = "totalsegmentator"  # classes of its task `total`, version 2
LARGEST_LABEL = 65_535
MOST_STRUCTURES = 254  # they are counted in 8 bits, with the body


@dataclass(frozen=True)
class VolumeFile:
    """A volume whose header has been checked: rigid but for the sides of its voxels."""

    path: Path
    shape: tuple[int, int, int]
    affine: np.ndarray  # (4, 4) float64, voxel indices to world, mm; at the middle of each voxel

    @property
    def spacing_mm(self) -> tuple[float, float, float]:
        a, b, c = np.linalg.norm(self.affine[:3, :3], axis=0).tolist()
        return a, b, c


def check_volume(path: Path, where: str) -> VolumeFile:
    """Read and check the header of a file; `where` stands in messages.

    Raises ValueError when the file is not readable, or the package that reads it is missing; when it is not one volume
    of 3 axes with at most `MOST_VOXELS`; or its affine is missing, sheared or has voxels with sides beyond `VOXEL_MM`.
    """
    try:
        shape, affine = _nrrd_header(path) if path.suffix.lower() == ".nrrd" else _nifti_header(path)
    except ImportError as error:
        package = {"nrrd": "pynrrd"}.get(error.name or "", error.name)
        raise ValueError(f"{where}: {path} needs the package {package}: {installing('volumes')}") from None
    except Exception as error:  # every reader raises its own
        raise ValueError(f"{where}: {path}: not readable: {' '.join(str(error).split())}") from None
    if len(shape) != 3:
        raise ValueError(f"{where}: {path} has {len(shape)} axes, {shape}; allowed is one volume of 3")
    if min(shape) < 1 or math.prod(shape) > MOST_VOXELS:
        raise ValueError(f"{where}: {path} has {shape} voxels; allowed are 1 and more a side, {MOST_VOXELS} in all")
    if affine is None:
        allowed = "allowed is sform or qform of NIfTI, or space, space directions and space origin of NRRD"
        raise ValueError(f"{where}: {path} has no affine, so where its voxels lie is not known; {allowed}")
    if fault := _affine_fault(affine):
        raise ValueError(f"{where}: {path} {fault}")
    return VolumeFile(path, shape, affine)


def slabs(volume: VolumeFile) -> Iterator[tuple[slice, np.ndarray]]:
    """Parts of a volume along its last axis, in order: which part, and its values, (x, y, part).

    Raises ValueError when the file cannot be read to its end.
    """
    step = max(1, _SLAB_VOXELS // math.prod(volume.shape[:2]))
    with naming(f"{volume.path}: not readable to its end: ", Exception):  # every reader raises its own
        if volume.path.suffix.lower() == ".nrrd":  # which is read whole, NIfTI in parts
            import nrrd

            values = nrrd.read(str(volume.path), index_order="F")[0]
        else:
            import nibabel

            values = nibabel.load(volume.path, keep_file_open=True).dataobj  # type: ignore[attr-defined]
        for start in range(0, volume.shape[2], step):
            part = slice(start, min(start + step, volume.shape[2]))
            yield part, np.asanyarray(values[:, :, part]).reshape(*volume.shape[:2], -1)


def _nifti_header(path: Path) -> tuple[tuple[int, ...], np.ndarray | None]:
    import nibabel

    image: Any = nibabel.load(path)
    unit = image.header.get_xyzt_units()[0]
    if unit not in ("mm", "unknown"):
        raise ValueError(f"its unit is {unit}; allowed is mm")
    is_known = image.header["sform_code"] > 0 or image.header["qform_code"] > 0
    shape = image.shape[:3] if set(image.shape[3:]) == {1} else image.shape  # a series of one volume
    return tuple(shape), np.asarray(image.affine, np.float64) if is_known else None


def _nrrd_header(path: Path) -> tuple[tuple[int, ...], np.ndarray | None]:
    import nrrd

    header = nrrd.read_header(str(path))
    if "data file" in header or "datafile" in header:
        raise ValueError("its voxels are in another file; allowed is one file with both")
    for unit in header.get("space units", []):
        if unit.lower() not in ("mm", "millimeter", "millimeters", "", "unknown", "???"):
            raise ValueError(f"its unit is {shown(unit)}; allowed is mm")
    shape = tuple(int(n) for n in header["sizes"])
    if len(shape) != 3 or not {"space", "space directions", "space origin"} <= header.keys():
        return shape, None
    space = str(header["space"]).lower()
    initials = "".join(word[:1] for word in space.split("-")) if "-" in space else space
    if initials not in _SPACES:
        raise ValueError(f"its space is {shown(space)}; allowed are {', '.join(_SPACES).upper()}")
    affine = np.eye(4)
    affine[:3, :3] = np.asarray(header["space directions"], np.float64).T
    affine[:3, 3] = header["space origin"]
    return shape, np.diag([*_SPACES[initials], 1.0]) @ affine


def _affine_fault(affine: np.ndarray) -> str | None:
    """Why an affine (4, 4) cannot be used; None where it can."""
    axes = affine[:3, :3]
    if not np.isfinite(affine).all():
        return "has an affine that is not finite"
    sides = np.linalg.norm(axes, axis=0)
    if not (sides.min() >= VOXEL_MM[0] and sides.max() <= VOXEL_MM[1]):
        size = " x ".join(f"{side:.4g}" for side in sides)
        return f"has voxels of {size} mm; allowed are sides of {VOXEL_MM[0]:g} to {VOXEL_MM[1]:g} mm"
    cosines = np.triu((axes / sides).T @ (axes / sides), 1)
    i, j = np.unravel_index(np.argmax(np.abs(cosines)), (3, 3))
    if abs(cosines[i, j]) > _SQUARE:
        angle = math.degrees(math.acos(np.clip(cosines[i, j], -1, 1)))
        return f"is sheared: its axes {i} and {j} meet at {angle:.1f} degrees; allowed are right angles"
    return None


@dataclass(frozen=True)
class Label:
    """A label of the volume; without a tissue it is left out."""

    number: int
    name: str
    tissue: Tissue | None


@dataclass(frozen=True)
class Body:
    """What is above a threshold in an image on the grid of the labels, with all that it encloses."""

    image: VolumeFile
    above: float
    tissue: Tissue


@dataclass(frozen=True)
class LabelMap:
    """A volume of labels, its structures in their order: of two that touch, the later one's wall is the visible one."""

    volume: VolumeFile
    labels: tuple[Label, ...]
    complete: bool  # whether each label must be in the volume
    body: Body | None

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that the structures are made from."""
        return (self.volume.path, *((self.body.image.path,) if self.body else ()))

    @property
    def structures(self) -> tuple[tuple[str, Tissue], ...]:
        """Name and tissue of all that may become a structure, the body first."""
        body = (("body", self.body.tissue),) if self.body else ()
        return (*body, *((label.name, label.tissue) for label in self.labels if label.tissue))


def checked_labels(content: Any, folder: Path, tissues: Mapping[str, Tissue], where: str) -> LabelMap:
    """Check `{file, tissues, body}`, and the headers of the files that it names.

    Parameters
    ----------
    content : object
        What stands in the `scene.yaml`.
    folder : Path
        Where it lies.
    tissues : mapping of str to Tissue
        Those that may be named.
    where : str
        The key, for messages.

    Raises
    ------
    FileNotFoundError or ValueError
        When a file is missing or cannot be used, or a key or value is not as it should be.
    """
    content = mapping(content, where, ("file", "tissues", "body"))
    volume = check_volume(file_named(content.get("file"), SUFFIXES, folder, f"{where}.file"), f"{where}.file")
    named = content.get("tissues")
    if named == TABLE:
        labels = tuple(Label(n, name, tissues[one_of(t, tissues, where)]) for n, name, t in _table())
    else:
        labels = _labels(named, tissues, f"{where}.tissues")
    body = None
    if content.get("body"):
        own, key = mapping(content["body"], f"{where}.body", ("file", "above", "tissue")), f"{where}.body"
        image = check_volume(file_named(own.get("file"), SUFFIXES, folder, f"{key}.file"), f"{key}.file")
        if image.shape != volume.shape or not np.allclose(image.affine, volume.affine, atol=1e-3):
            raise ValueError(f"{key}.file: {image.path} has not the shape and the affine of {volume.path}")
        tissue = tissues[one_of(own.get("tissue", "soft_tissue"), tissues, f"{key}.tissue")]
        body = Body(image, number(own.get("above"), f"{key}.above"), tissue)
    if body is None and not any(label.tissue for label in labels):
        raise ValueError(f"{where}.tissues: every label is null; allowed is at least one with a tissue, or a body")
    return LabelMap(volume, labels, named != TABLE, body)


def _labels(named: Any, tissues: Mapping[str, Tissue], where: str) -> tuple[Label, ...]:
    if not isinstance(named, Mapping) or not named:
        raise refusal(where, named, f"{TABLE}, or mappings of labels to tissues")
    labels = []
    for label, name in named.items():
        if not isinstance(label, int) or isinstance(label, bool) or not 1 <= label <= LARGEST_LABEL:
            raise refusal(f"{where}: label", label, f"whole numbers from 1 to {LARGEST_LABEL}")
        tissue = None if name is None else tissues[one_of(name, tissues, f"{where}.{label}")]
        labels.append(Label(label, f"label {label}", tissue))
    if sum(label.tissue is not None for label in labels) > MOST_STRUCTURES:
        raise ValueError(f"{where}: {len(labels)} labels; allowed are at most {MOST_STRUCTURES}")
    return tuple(labels)


def _table() -> list[tuple[int, str, str]]:
    """Label, name and tissue of each class of `TABLE`."""
    with files("ablate.anatomy.volumes").joinpath(f"{TABLE}.csv").open(encoding="utf-8") as stream:
        return [(int(row["label"]), row["name"], row["tissue"]) for row in csv.DictReader(stream)]
