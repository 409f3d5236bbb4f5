"""Scenes of boxes, rendered in both precisions, and what must hold of every such pair of frames."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import trimesh

from ablate.anatomy import Scene, Structure, Tissue
from ablate.studies.stability.checks import FLOAT32, Check, finite, off
from ablate.ultrasound import ConvexProbe, Frame, Precision, Simulator, SimulatorSettings
from ablate.ultrasound.point_spread import axial_kernel, lateral_kernels
from ablate.ultrasound.probe import sample_depths_mm

AHEAD = np.eye(4)
GEL = Tissue("gel", 1540, 1.5, 0.0, 0.0, 0.0, 0.0, roughness=0.0)
SOFT = Tissue("soft tissue", 1540, 1.63, 0.5, 0.6, 0.0, 1.0, roughness=0.0)
#: A frame of all that there is, in a tenth of a second.
SMALL = SimulatorSettings(
    scanlines=64, axial_samples=1024, rays=8, layers=3, image_shape=(200, 277), axial_fwhm_mm=1.2, lateral_fwhm_mm=1.6
)
#: One scanline along its axis.
ONE_LINE = SimulatorSettings(
    scanlines=1, axial_samples=1024, rays=8, layers=1, image_shape=(64, 89), axial_fwhm_mm=1.2,
    noise_floor_db=-300.0, tgc_db_cm_mhz=0.0, aperture_mm=0.0, elevational_aperture_mm=0.0,
)  # fmt: skip


def slab(tissue: Tissue, near_mm: float, far_mm: float, wide_mm: float = 300.0) -> Structure:
    """A box about the probe's axis, between two depths."""
    mesh = trimesh.creation.box((wide_mm, wide_mm, far_mm - near_mm))
    mesh.apply_translation((0, 0, (near_mm + far_mm) / 2))
    return Structure(mesh, tissue)


def moved(x_mm: float = 0.0, y_mm: float = 0.0, z_mm: float = 0.0, tilt_deg: float = 0.0) -> np.ndarray:
    """A pose at a place, turned about the probe's y."""
    angle = np.radians(tilt_deg)
    pose = np.eye(4)
    pose[0, 0], pose[0, 2], pose[2, 0], pose[2, 2] = np.cos(angle), np.sin(angle), -np.sin(angle), np.cos(angle)
    pose[:3, 3] = x_mm, y_mm, z_mm
    return pose


def both(
    scene: Scene,
    settings: SimulatorSettings,
    device: str,
    probe: ConvexProbe | None = None,
    pose: np.ndarray = AHEAD,
    seed: int = 0,
) -> dict[str, Frame]:
    """A frame in float32 and in float64, by the name of the precision."""
    return {
        precision.value: Simulator(scene, probe, replace(settings, precision=precision, device=device)).render(
            pose, seed
        )
        for precision in Precision
    }


def usual(frames: dict[str, Frame], settings: SimulatorSettings, probe: ConvexProbe | None = None) -> Iterator[Check]:
    """What must hold of any frame: finite, and float32 as near to float64 as its roundings allow."""
    single, double = frames["float32"], frames["float64"]
    for dtype, frame in frames.items():
        yield finite(dtype, frame.envelope, frame.attenuation, what="samples and pixels")
        outside = max(-frame.attenuation.min(), frame.attenuation.max() - 1, 0.0)
        yield Check(dtype, "A outside [0, 1]", float(outside), 0, "It is an amplitude over a larger one.")
    terms = products(settings, probe or ConvexProbe())
    largest = float(double.envelope.max())
    yield Check(
        "float32",
        "envelope against float64, of its largest",
        off(single.envelope, double.envelope, largest or 1.0),
        terms**1.5 * FLOAT32,
        f"A sample sums {terms} products of the pulse: random rounding takes sqrt(n) 2^-24 of the magnitudes "
        "(Higham and Mary 2019), which add up to at most n times the largest.",
    )
    yield Check(
        "float32",
        "pixels more than a grey level from float64",
        int(np.count_nonzero(np.abs(single.image.astype(int) - double.image) > 1)),
        0,
        "What differs by far less than a grey level may still be rounded to either side.",
    )
    yield Check(
        "float32",
        "A against float64",
        off(single.attenuation, double.attenuation),
        (settings.axial_samples + settings.scanlines) * 2 * FLOAT32 + 4 * FLOAT32,
        "A pixel's place among n samples is off by n 2^-23 of their spacing, and A differs by at most 1 a sample.",
    )


def products(settings: SimulatorSettings, probe: ConvexProbe) -> int:
    """How many products a sample of the signal sums: pulse, beam and layers."""
    depth = sample_depths_mm(probe, 64)
    beam = np.count_nonzero(lateral_kernels(probe, settings, depth), axis=-1).max()
    return len(axial_kernel(probe, settings)) + int(beam) + settings.layers
