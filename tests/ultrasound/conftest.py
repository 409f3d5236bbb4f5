"""Scenes of boxes and spheres, whose images have closed forms."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
import trimesh

from ablate.anatomy import Scene, Structure, Tissue
from ablate.ultrasound import ConvexProbe, SimulatorSettings

torch.set_num_threads(1)

Box = Callable[..., Structure]


@pytest.fixture
def gel() -> Tissue:
    """Nothing at all: no scatterers, no loss."""
    return Tissue("gel", 1540, 1.5, 0.0, 0.0, 0.0, 0.0, roughness=0.0)


@pytest.fixture
def tissue() -> Tissue:
    """Uniform speckle without an echo at its surface with `gel`."""
    return Tissue("tissue", 1540, 1.5, 0.5, 0.6, 0.0, 1.0, roughness=0.0)


@pytest.fixture
def slab() -> Box:
    """A box that fills the fan sideways, between two depths."""

    def make(tissue: Tissue, near_mm: float, far_mm: float, wide_mm: float = 800.0) -> Structure:
        mesh = trimesh.creation.box((wide_mm, wide_mm, far_mm - near_mm))
        mesh.apply_translation((0, 0, (near_mm + far_mm) / 2))
        return Structure(mesh, tissue)

    return make


@pytest.fixture
def ball() -> Box:
    """A sphere of 20,480 triangles."""

    def make(tissue: Tissue, centre_mm: tuple[float, float, float], radius_mm: float) -> Structure:
        mesh = trimesh.creation.icosphere(5, radius_mm)
        mesh.apply_translation(centre_mm)
        return Structure(mesh, tissue)

    return make


@pytest.fixture
def probe() -> ConvexProbe:
    return ConvexProbe(frequency_mhz=3.0)


@pytest.fixture
def small() -> SimulatorSettings:
    """Cheap settings whose speckle is still finer than the pulse."""
    return SimulatorSettings(
        scanlines=64, axial_samples=1024, rays=8, layers=3, image_shape=(200, 277), axial_fwhm_mm=1.2,
        lateral_fwhm_mm=1.6, noise_floor_db=-300.0, tgc_db_cm_mhz=0.0,
    )  # fmt: skip


@pytest.fixture
def empty(gel: Tissue) -> Scene:
    return Scene((), gel, "empty")


@pytest.fixture
def ahead() -> np.ndarray:
    """The probe at the world's origin, looking along z."""
    return np.eye(4)
