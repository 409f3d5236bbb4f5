"""Files of volumes: where their voxels lie in the world, and their values, read to the end of the file.

The world is RAS+ in mm: x to the patient's right, y to the front, z up, as NIfTI has it.
"""

import bz2
import gzip
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ablate.extras import installing
from ablate.setting import shown
from ablate.storage import check_unpacked

SUFFIXES = (".nii", ".nii.gz", ".nrrd")
VOXEL_MM = (0.01, 6.0)  # shortest and longest side; CT has slices of up to 5 mm
MOST_VOXELS = 2**29  # 512 x 512 x 2048
_SQUARE = 1e-3  # largest cosine between two axes
_SLAB_VOXELS = 2**21
_CHUNK = 2**20  # bytes
_LARGEST_VALUE = 8  # bytes
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

    def is_on_grid_of(self, other: "VolumeFile") -> bool:
        """Whether both have the same voxels, to 1 um."""
        return self.shape == other.shape and np.allclose(self.affine, other.affine, atol=1e-3)


def check_volume(path: Path, where: str) -> VolumeFile:
    """Read and check the header of a file; `where` stands in messages.

    Raises ValueError when the file is not readable, or the package that reads it is missing; when it is not one volume
    of 3 axes with at most `MOST_VOXELS` real numbers; or its affine is missing, sheared or has voxels with sides beyond
    `VOXEL_MM`.
    """
    try:
        shape, affine, values = _nrrd_header(path) if _is_nrrd(path) else _nifti_header(path)
    except ImportError as error:
        package = {"nrrd": "pynrrd"}.get(error.name or "", error.name)
        raise ValueError(f"{where}: {path} needs the package {package}: {installing('volumes')}") from None
    except Exception as error:  # every reader raises its own
        raise ValueError(f"{where}: {path}: not readable: {_in_words(error)}") from None
    if values:
        raise ValueError(f"{where}: {path} holds {values}; allowed is one real number a voxel")
    if len(shape) != 3:
        layers = "; 3D Slicer writes segments that overlap so" if path.name.lower().endswith(".seg.nrrd") else ""
        raise ValueError(f"{where}: {path} has {len(shape)} axes, {shape}; allowed is one volume of 3{layers}")
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

    Raises ValueError when the file ends early or late, or a compressed file has not its checksum, which may be known
    only after the last part.
    """
    step = max(1, _SLAB_VOXELS // math.prod(volume.shape[:2]))
    parts = [slice(start, min(start + step, volume.shape[2])) for start in range(0, volume.shape[2], step)]
    try:
        for part, values in (_nrrd_slabs if _is_nrrd(volume.path) else _nifti_slabs)(volume.path, parts):
            yield part, values.reshape(*volume.shape[:2], -1)
    except Exception as error:  # every reader raises its own
        raise ValueError(f"{volume.path}: not readable to its end: {_in_words(error)}") from error


def _is_nrrd(path: Path) -> bool:
    return path.suffix.lower() == ".nrrd"


def _in_words(error: Exception) -> str:
    """What an exception of a reader says, in one line; its kind where it says nothing but a number or a key."""
    text = " ".join(str(error).split())
    return text if " " in text else f"{type(error).__name__} {text}".rstrip()


def _nifti_slabs(path: Path, parts: list[slice]) -> Iterator[tuple[slice, np.ndarray]]:
    import nibabel

    kind: Any = type(nibabel.load(path))  # NIfTI 1 or 2
    opened: Any = gzip.open if path.suffix.lower() == ".gz" else open
    with opened(path, "rb") as stream:
        values = kind.from_stream(stream).dataobj
        for part in parts:
            yield part, np.asanyarray(values[:, :, part])
        while stream.read(_CHUNK):  # the checksum of gzip stands at its end
            pass
        end = values.offset + math.prod(values.shape) * values.dtype.itemsize
        if (beyond := stream.tell() - end) > 0:
            raise ValueError(f"{beyond} bytes lie behind the last voxel that its header declares")


def _nrrd_slabs(path: Path, parts: list[slice]) -> Iterator[tuple[slice, np.ndarray]]:
    import nrrd

    header = nrrd.read_header(str(path))
    opened: Any = {"g": gzip.open, "b": bz2.open}.get(str(header["encoding"])[:1])
    if opened:  # pynrrd unpacks all there is, and does not see that the checksum is cut off
        most, unpacked = math.prod(int(n) for n in header["sizes"]) * _LARGEST_VALUE, 0
        with path.open("rb") as stream:
            while stream.readline().strip():
                pass
            for _ in range(header.get("line skip", header.get("lineskip", 0))):
                stream.readline()
            with opened(stream) as whole:
                while chunk := whole.read(_CHUNK):
                    unpacked += len(chunk)
                    check_unpacked(path, unpacked, most)
    values, _ = nrrd.read(str(path), index_order="F")
    for part in parts:
        yield part, values[:, :, part]


def _nifti_header(path: Path) -> tuple[tuple[int, ...], np.ndarray | None, str]:
    """Shape, affine, and what its values are where they are not real numbers."""
    import nibabel

    _check_extensions(path)
    image: Any = nibabel.load(path)
    unit = image.header.get_xyzt_units()[0]
    if unit not in ("mm", "unknown"):
        raise ValueError(f"its unit is {unit}; allowed is mm")
    is_known = image.header["sform_code"] > 0 or image.header["qform_code"] > 0
    shape = image.shape[:3] if set(image.shape[3:]) == {1} else image.shape  # a series of one volume
    kind = image.get_data_dtype()
    values = {"c": "complex numbers", "V": f"colours ({', '.join(kind.names or ())})"}.get(kind.kind, "")
    return tuple(shape), np.asarray(image.affine, np.float64) if is_known else None, values


def _check_extensions(path: Path) -> None:
    """Refuse a header that declares more text between itself and the voxels than may be unpacked; it is read whole."""
    from nibabel import Nifti1Header, Nifti2Header

    opened: Any = gzip.open if path.suffix.lower() == ".gz" else open
    with opened(path, "rb") as stream:
        start = stream.read(Nifti2Header.sizeof_hdr)
    for kind in (Nifti1Header, Nifti2Header):
        if kind.may_contain_header(start):
            check_unpacked(path, int(kind(start[: kind.sizeof_hdr], check=False)["vox_offset"]))


def _nrrd_header(path: Path) -> tuple[tuple[int, ...], np.ndarray | None, str]:
    """Shape, affine, and what its values are where they are not real numbers."""
    import nrrd

    header = nrrd.read_header(str(path))
    if "data file" in header or "datafile" in header:
        raise ValueError("its voxels are in another file; allowed is one file with both")
    for unit in header.get("space units", []):
        if unit.lower() not in ("mm", "millimeter", "millimeters", "", "unknown", "???"):
            raise ValueError(f"its unit is {shown(unit)}; allowed is mm")
    values = "blocks of bytes" if header["type"] == "block" else ""
    shape = tuple(int(n) for n in header["sizes"])
    if len(shape) != 3 or not {"space", "space directions", "space origin"} <= header.keys():
        return shape, None, values
    space = str(header["space"]).lower()
    initials = "".join(word[:1] for word in space.split("-")) if "-" in space else space
    if initials not in _SPACES:
        raise ValueError(f"its space is {shown(space)}; allowed are {', '.join(_SPACES).upper()}")
    affine = np.eye(4)
    affine[:3, :3] = np.asarray(header["space directions"], np.float64).T
    affine[:3, 3] = header["space origin"]
    return shape, np.diag([*_SPACES[initials], 1.0]) @ affine, values


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
