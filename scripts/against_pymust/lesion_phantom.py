"""Uniform scatterers in a part of a fan, with round lesions: as points for PyMUST and as a scene for ablate."""

from dataclasses import dataclass

import numpy as np
import trimesh
from pymust_array import Scatterers

from ablate.anatomy import Scene, Structure, Tissue

_BEYOND_MM, _BEYOND_DEG = 3.0, 2.0  # how far the scatterers reach beyond the fan that is shown


@dataclass(frozen=True)
class Lesion:
    """A disc in the image plane; `contrast_db` is its scatterers' power against the rest, -inf that of a cyst."""

    name: str
    angle_deg: float
    depth_mm: float
    radius_mm: float
    contrast_db: float


@dataclass(frozen=True)
class Phantom:
    """What is imaged, and the polar grid it is imaged on.

    Attributes
    ----------
    near_mm, far_mm : float
        Depths between which there are scatterers and an image.
    fov_deg : float
    lesions : tuple of Lesion
    per_mm2 : float
        Point scatterers in PyMUST.
    face_mm : float
        Radius of the probe's face, whose centre of curvature is the grid's.
    samples, lines : int
        Of the grid; samples are counted from the face on.
    """

    near_mm: float
    far_mm: float
    fov_deg: float
    lesions: tuple[Lesion, ...]
    per_mm2: float
    face_mm: float = 40.0
    samples: int = 720
    lines: int = 193  # odd: one of them is the axis

    @property
    def depths_mm(self) -> np.ndarray:
        """Of the samples that are shown, (n,) float64."""
        depths = (np.arange(self.samples) + 0.5) * (self.far_mm / self.samples)
        return depths[depths >= self.near_mm]

    @property
    def angles_rad(self) -> np.ndarray:
        """Of the lines, (lines,) float64."""
        half = np.radians(self.fov_deg) / 2
        return np.linspace(-half, half, self.lines)

    @property
    def grid_mm(self) -> tuple[np.ndarray, np.ndarray]:
        """x and z of the samples that are shown, (n, lines) float64 each."""
        r = self.face_mm + self.depths_mm[:, None]
        return r * np.sin(self.angles_rad), r * np.cos(self.angles_rad) - self.face_mm

    def centre_mm(self, lesion: Lesion) -> tuple[float, float]:
        """x and z of a lesion's centre."""
        angle, r = np.radians(lesion.angle_deg), self.face_mm + lesion.depth_mm
        return float(r * np.sin(angle)), float(r * np.cos(angle) - self.face_mm)

    def distance_mm(self, lesion: Lesion, x_mm: np.ndarray, z_mm: np.ndarray) -> np.ndarray:
        """Distance of points from a lesion's centre."""
        x, z = self.centre_mm(lesion)
        return np.hypot(x_mm - x, z_mm - z)

    def clear(self, margin_mm: float) -> np.ndarray:
        """Samples at least `margin_mm` outside every lesion and inside the fan's border, (n, lines) bool."""
        depth = self.depths_mm[:, None]
        r = self.face_mm + depth
        clear = (depth > self.near_mm + margin_mm) & (depth < self.far_mm - margin_mm)
        clear = clear & (r * (np.radians(self.fov_deg) / 2 - np.abs(self.angles_rad)) > margin_mm)
        for lesion in self.lesions:
            clear &= self.distance_mm(lesion, *self.grid_mm) > lesion.radius_mm + margin_mm
        return clear


def scatterers(phantom: Phantom, seed: int) -> Scatterers:
    """Points at uniform random places; their strength is 1, in a lesion its contrast."""
    generator = np.random.default_rng(seed)
    half = np.radians(phantom.fov_deg / 2 + _BEYOND_DEG)
    inner, outer = phantom.face_mm + phantom.near_mm - _BEYOND_MM, phantom.face_mm + phantom.far_mm + _BEYOND_MM
    count = generator.poisson(phantom.per_mm2 * half * (outer**2 - inner**2))
    r, angle = np.sqrt(generator.uniform(inner**2, outer**2, count)), generator.uniform(-half, half, count)
    x, z = r * np.sin(angle), r * np.cos(angle) - phantom.face_mm
    strength = np.ones(count)
    for lesion in phantom.lesions:
        strength[phantom.distance_mm(lesion, x, z) < lesion.radius_mm] = 10 ** (lesion.contrast_db / 20)
    echoing = strength > 0
    return Scatterers(x[echoing], z[echoing], strength[echoing])


def scene(phantom: Phantom) -> Scene:
    """The lesions as balls cut in their middle; one speed, one impedance and no loss, as in PyMUST."""
    structures = []
    for lesion in phantom.lesions:
        ball = trimesh.creation.icosphere(5, lesion.radius_mm)
        x, z = phantom.centre_mm(lesion)
        ball.apply_translation((x, 0.0, z))
        structures.append(Structure(ball, _tissue(lesion.name, lesion.contrast_db)))
    return Scene(tuple(structures), _tissue("background", 0.0), "lesions")


def _tissue(name: str, level_db: float) -> Tissue:
    return Tissue(
        name, attenuation_db_cm_mhz=0.0, scatterer_density=1.0, scatterer_sd=10 ** (level_db / 20), roughness=0.0
    )
