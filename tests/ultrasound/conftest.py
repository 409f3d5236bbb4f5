"""Scenes of boxes and spheres, whose images have closed forms."""

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from ablate.anatomy import Scene, Structure, Tissue
from ablate.ultrasound import ConvexProbe, Simulator, SimulatorSettings

torch.set_num_threads(1)

Box = Callable[..., Structure]
Amplitudes = Callable[..., np.ndarray]


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
        lateral_fwhm_mm=1.6, noise_level_db=-300.0, tgc_db_cm_mhz=0.0,
    )  # fmt: skip


@pytest.fixture
def empty(gel: Tissue) -> Scene:
    return Scene((), gel, "empty")


@pytest.fixture
def ahead() -> np.ndarray:
    """The probe at the world's origin, looking along z."""
    return np.eye(4)


@pytest.fixture
def pencil() -> ConvexProbe:
    """Scanlines that are as good as parallel: all of them meet a flat slab at one angle."""
    return ConvexProbe(fov_deg=0.002, frequency_mhz=3.0)


@pytest.fixture
def apart() -> SimulatorSettings:
    """Scanlines that are not blurred into each other, with all rays along their axes."""
    return SimulatorSettings(
        scanlines=128, axial_samples=1024, rays=32, layers=1, image_shape=(8, 8), axial_fwhm_mm=1.2,
        lateral_fwhm_mm=1e-6, noise_level_db=-300.0, tgc_db_cm_mhz=0.0, aperture_mm=0.0, elevational_aperture_mm=0.0,
    )  # fmt: skip


@pytest.fixture
def amplitudes() -> Amplitudes:
    """Amplitude of the echoes between two depths, (path seeds, scanlines) float.

    The area under the envelope, over that under a Gaussian of unit peak: FWHM sqrt(pi / (4 ln 2)).
    """

    def measure(
        scene: Scene,
        probe: ConvexProbe,
        settings: SimulatorSettings,
        between_mm: tuple[float, float],
        pose: np.ndarray | None = None,
        path_seeds: Iterable[int] = (0,),
    ) -> np.ndarray:
        spacing = probe.depth_mm / settings.axial_samples
        first, last = (round(depth / spacing) for depth in between_mm)
        pulse_mm = settings.axial_fwhm_mm * np.sqrt(np.pi / (4 * np.log(2)))
        frames = (
            Simulator(scene, probe, replace(settings, path_seed=seed)).render(np.eye(4) if pose is None else pose)
            for seed in path_seeds
        )
        return np.array([f.envelope[first:last].sum(axis=0, dtype=float) for f in frames]) * spacing / pulse_mm

    return measure


@pytest.fixture
def depths() -> Callable[[ConvexProbe, SimulatorSettings], np.ndarray]:
    """Depths of the axial samples, mm: the middles of equal parts of the imaging depth."""
    return lambda probe, settings: (np.arange(settings.axial_samples) + 0.5) * probe.depth_mm / settings.axial_samples


@pytest.fixture
def one_line() -> SimulatorSettings:
    return SimulatorSettings(scanlines=1, layers=1, rays=64, aperture_mm=0.0, elevational_aperture_mm=0.0)
