"""What a simulated body is made of: tissues, structures and the scene that holds them."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable
from dataclasses import astuple, dataclass, fields
from functools import cached_property
from numbers import Real

import numpy as np
import trimesh

#: Lowest and highest value of each number of a tissue; generous, because stiff cases are meant to run.
TISSUE_RANGES: dict[str, tuple[float, float]] = {
    "speed_m_s": (1.0, 1e5),
    "impedance_mrayl": (1e-6, 1e4),
    "attenuation_db_cm_mhz": (0.0, 1e4),
    "scatterer_density": (0.0, 1.0),
    "scatterer_mean": (-1e3, 1e3),
    "scatterer_sd": (0.0, 1e3),
    "attenuation_power": (0.0, 4.0),
    "roughness": (0.0, 10.0),
    "thickness_mm": (0.0, 100.0),
    "specularity": (0.0, 1e6),
    "texture_contrast_db": (0.0, 40.0),
}

ANATOMY_VERSION = 2  # of the built-in anatomy, the tissue table and mesh repair: raised when a scene changes


@dataclass(frozen=True)
class Tissue:
    """Acoustic properties of one tissue.

    Attributes
    ----------
    name : str
    speed_m_s : float
        Speed of sound, m/s.
    impedance_mrayl : float
        Characteristic impedance, MRayl (10^6 kg m^-2 s^-1).
    attenuation_db_cm_mhz : float
        Amplitude attenuation, one way, dB/cm at 1 MHz.
    scatterer_density, scatterer_mean, scatterer_sd : float
        A lattice point scatters with probability `scatterer_density`; its amplitude is then normal with this
        mean and standard deviation, relative to the simulator's scatterer level (Burger et al. 2013, eq. 15).
    attenuation_power : float
        Exponent b of alpha f^b.
    roughness : float
        0 is a mirror; otherwise the normal is drawn from a power-cosine lobe of exponent 1 / roughness.
    thickness_mm : float
        Standard deviation of the depth over which the surface reflects, mm.
    specularity : float
        Exponent n of the echo's lobe max(0, cos)^n; larger is more mirror-like.
    texture_contrast_db : float
        Standard deviation of the slow variation of scatterer amplitude within the tissue, dB; 0 is uniform.
    texture_mm : tuple of 3 floats
        Correlation lengths of that variation along the world's x, y and z, mm.

    Raises
    ------
    ValueError
        When a value is not finite or outside its physical range; the message names tissue and field.
    """

    name: str
    speed_m_s: float = 1540.0
    impedance_mrayl: float = 1.63
    attenuation_db_cm_mhz: float = 0.5
    scatterer_density: float = 0.6
    scatterer_mean: float = 0.0
    scatterer_sd: float = 0.3
    attenuation_power: float = 1.0
    roughness: float = 0.02
    thickness_mm: float = 0.0
    specularity: float = 8.0
    texture_contrast_db: float = 0.0
    texture_mm: tuple[float, float, float] = (4.0, 4.0, 4.0)

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise ValueError(f"tissue name must be a non-empty string, not {self.name!r}")
        for field in fields(self):
            if field.name in TISSUE_RANGES:
                low, high = TISSUE_RANGES[field.name]
                _check_number(self.name, field.name, getattr(self, field.name), low, high)
        if not isinstance(self.texture_mm, Iterable) or len(lengths := tuple(self.texture_mm)) != 3:
            raise ValueError(f"tissue {self.name!r}: texture_mm must be 3 lengths, not {self.texture_mm!r}")
        object.__setattr__(self, "texture_mm", lengths)  # a list would not hash
        for length_mm in self.texture_mm:
            _check_number(self.name, "texture_mm", length_mm, 1e-3, 1e6)

    @property
    def scatter_power(self) -> float:
        """Variance of the scatterers, which the speckle's power follows: p (sd^2 + (1 - p) mean^2)."""
        p, m, s = self.scatterer_density, self.scatterer_mean, self.scatterer_sd
        return p * (s * s + (1 - p) * m * m)


def _check_number(tissue: str, field: str, value: object, low: float, high: float) -> None:
    """Raise ValueError unless `value` is a finite number in [low, high]."""
    number = float(value) if isinstance(value, Real) else math.nan
    if not low <= number <= high:  # false for nan
        raise ValueError(f"tissue {tissue!r}: {field} must be between {low:g} and {high:g}, not {value!r}")


def _check_tissue(what: str, value: object) -> None:
    if not isinstance(value, Tissue):
        raise TypeError(f"{what} must be a Tissue, not {value!r}; load_tissues() has the built-in ones by name")


@dataclass(frozen=True)
class Structure:
    """One closed surface and the tissue inside it; vertices in mm, winding irrelevant.

    Raises
    ------
    TypeError
        When the mesh is no `trimesh.Trimesh` (files of several parts load as a `trimesh.Scene`) or the tissue no
        `Tissue`.
    """

    mesh: trimesh.Trimesh
    tissue: Tissue

    def __post_init__(self) -> None:
        if not isinstance(self.mesh, trimesh.Trimesh):
            raise TypeError(f"structure: mesh must be a trimesh.Trimesh, not {type(self.mesh).__name__}")
        _check_tissue("structure: tissue", self.tissue)


@dataclass(frozen=True)
class Scene:
    """A body: where structures overlap, the later one owns the point; `background` fills the rest.

    Attributes
    ----------
    structures : tuple of Structure
        May be empty: the scene is then all background.
    background : Tissue
    name : str

    Raises
    ------
    TypeError
        When a structure or the background is something else.
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
        """For each structure the index of its tissue in `tissues`."""
        index = {tissue: i for i, tissue in enumerate(self.tissues)}
        return tuple(index[s.tissue] for s in self.structures)


def bounds_mm(meshes: Iterable[trimesh.Trimesh]) -> np.ndarray:
    """Lower and upper corner of the box around all meshes, (2, 3) float64, mm; zeros where there is none."""
    bounds = np.array([mesh.bounds for mesh in meshes])
    return np.stack([bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)]) if len(bounds) else np.zeros((2, 3))


def content_hash(scene: Scene) -> str:
    """SHA-256, hexadecimal, over what a scene is: vertices, faces, tissues and background; its name is left out.

    Vertices count as little-endian float32, so that the hash is the same in every process and does not hang on
    the last bits of a build.
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
