"""Files of volumes: where their voxels lie in the world, and their content in slabs.

The world is RAS+ in mm: x to the patient's right, y to the front, z up, as NIfTI has it.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ablate.validation import shown

SUFFIXES = (".nii", ".nii.gz", ".nrrd")
VOXEL_MM = (0.01, 6.0)  # shortest and longest side; CT has slices of up to 5 mm
_SQUARE = 1e-3  # largest cosine between two axes
_SLAB_VOXELS = 2**21
#: NRRD names its world, as left-posterior-superior or LPS; the factors take it to RAS+.
_SPACES = {"ras": (1, 1, 1), "lps": (-1, -1, 1), "las": (-1, 1, 1)}


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

    Raises
    ------
    ValueError
        When the file is not readable, or the package that reads it is missing; when it is not one volume of 3 axes,
        or its affine is missing, sheared or has voxels whose sides are not within `VOXEL_MM`.
    """
    try:
        shape, affine = _nrrd_header(path) if path.suffix.lower() == ".nrrd" else _nifti_header(path)
    except ImportError as error:
        package = {"nrrd": "pynrrd"}.get(error.name or "", error.name)
        raise ValueError(f"{where}: {path} needs the package {package}, of the extra `volumes`") from None
    except Exception as error:  # every reader raises its own
        raise ValueError(f"{where}: {path}: not readable: {' '.join(str(error).split())}") from None
    if len(shape) != 3:
        raise ValueError(f"{where}: {path} has {len(shape)} axes, {shape}; allowed is one volume of 3")
    if affine is None:
        allowed = "allowed is sform or qform of NIfTI, or space, space directions and space origin of NRRD"
        raise ValueError(f"{where}: {path} has no affine, so where its voxels lie is not known; {allowed}")
    if fault := _affine_fault(affine):
        raise ValueError(f"{where}: {path} {fault}")
    return VolumeFile(path, shape, affine)


def slabs(volume: VolumeFile) -> Iterator[tuple[slice, np.ndarray]]:
    """Parts of a volume along its last axis, in order: which part, and its values, (x, y, part).

    Raises
    ------
    ValueError
        When the file cannot be read to its end.
    """
    step = max(1, _SLAB_VOXELS // math.prod(volume.shape[:2]))
    try:
        values = _values(volume.path)
        for start in range(0, volume.shape[2], step):
            part = slice(start, min(start + step, volume.shape[2]))
            yield part, np.asanyarray(values[:, :, part])
    except Exception as error:  # every reader raises its own
        raise ValueError(f"{volume.path}: not readable to its end: {' '.join(str(error).split())}") from None


def _values(path: Path) -> Any:
    """What gives the values of a part when it is sliced; NIfTI is read in parts, NRRD whole."""
    if path.suffix.lower() == ".nrrd":
        import nrrd

        return nrrd.read(str(path), index_order="F")[0]
    import nibabel

    return nibabel.load(path, keep_file_open=True).dataobj  # type: ignore[attr-defined]


def _nifti_header(path: Path) -> tuple[tuple[int, ...], np.ndarray | None]:
    import nibabel

    image: Any = nibabel.load(path)
    unit = image.header.get_xyzt_units()[0]
    if unit not in ("mm", "unknown"):
        raise ValueError(f"its unit is {unit}; allowed is mm")
    is_known = image.header["sform_code"] > 0 or image.header["qform_code"] > 0
    return tuple(image.shape), np.asarray(image.affine, np.float64) if is_known else None


def _nrrd_header(path: Path) -> tuple[tuple[int, ...], np.ndarray | None]:
    import nrrd

    header = nrrd.read_header(str(path))
    if "data file" in header or "datafile" in header:
        raise ValueError("its voxels are in another file; allowed is one file with both")
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
