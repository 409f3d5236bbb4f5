"""Scenes of boxes, their frames in float32 and float64, and the checks that every such pair of frames must pass."""

from collections.abc import Generator, Iterator
from dataclasses import replace

import numpy as np
import trimesh

from ablate.anatomy import Scene, Structure, Tissue
from ablate.numerics.stability.checks import FLOAT32, Check, finite, labelled, none, off
from ablate.ultrasound import ConvexProbe, Frame, Simulator, SimulatorPrecision, SimulatorSettings
from ablate.ultrasound.imaging.point_spread import axial_kernel, lateral_kernels
from ablate.ultrasound.probe import sample_depths_mm

AHEAD = np.eye(4)
GEL = Tissue("gel", 1540, 1.5, 0.0, 0.0, 0.0, 0.0, roughness=0.0)
SOFT = Tissue("soft tissue", 1540, 1.63, 0.5, 0.6, 0.0, 1.0, roughness=0.0)
PROBE = ConvexProbe()
#: A frame with every part of the model, in a tenth of a second.
SMALL = SimulatorSettings(
    scanlines=64, axial_samples=1024, rays=8, layers=3, image_shape=(200, 277), axial_fwhm_mm=1.2, lateral_fwhm_mm=1.6
)
#: One scanline along its axis.
ONE_LINE = SimulatorSettings(
    scanlines=1, axial_samples=1024, rays=8, layers=1, image_shape=(64, 89), axial_fwhm_mm=1.2,
    noise_floor_db=-300.0, tgc_db_cm_mhz=0.0, aperture_mm=0.0, elevational_aperture_mm=0.0,
)  # fmt: skip


def slab(tissue: Tissue, near_mm: float, far_mm: float, wide_mm: float = 300.0) -> Structure:
    """Make a box around the probe's axis, between two depths."""
    mesh = trimesh.creation.box((wide_mm, wide_mm, far_mm - near_mm))
    return Structure(mesh.apply_translation((0, 0, (near_mm + far_mm) / 2)), tissue)


def moved(x_mm: float = 0.0, y_mm: float = 0.0, z_mm: float = 0.0, tilt_deg: float = 0.0) -> np.ndarray:
    """Make a pose with this origin, rotated about the probe's y."""
    c, s = np.cos(np.radians(tilt_deg)), np.sin(np.radians(tilt_deg))
    return np.array([[c, 0, s, x_mm], [0, 1, 0, y_mm], [-s, 0, c, z_mm], [0, 0, 0, 1]])


def both(
    scene: Scene, settings: SimulatorSettings, device: str, probe: ConvexProbe = PROBE, pose: np.ndarray = AHEAD,
    seed: int = 0,
) -> dict[str, Frame]:  # fmt: skip
    """Render a frame in float32 and in float64, by the name of the precision."""
    chosen = {p.value: replace(settings, precision=p, device=device) for p in SimulatorPrecision}
    return {dtype: Simulator(scene, probe, s).render(pose, seed) for dtype, s in chosen.items()}


def checked_frames(
    scene: Scene, settings: SimulatorSettings, device: str, probe: ConvexProbe = PROBE, pose: np.ndarray = AHEAD,
    *, label: str = "",
) -> Generator[Check, None, dict[str, Frame]]:  # fmt: skip
    """Render `both`, yield the checks of any frame, and return the frames."""
    frames = both(scene, settings, device, probe, pose)
    yield from labelled(label, any_frame(frames, settings, probe))
    return frames


def any_frame(frames: dict[str, Frame], settings: SimulatorSettings, probe: ConvexProbe = PROBE) -> Iterator[Check]:
    """Check what must hold for any frame: values are finite, and float32 is near float64."""
    single, double = frames["float32"], frames["float64"]
    for dtype, frame in frames.items():
        yield finite(dtype, frame.envelope, frame.attenuation, what="samples and pixels")
        outside = float(max(-frame.attenuation.min(), frame.attenuation.max() - 1, 0.0))
        yield Check(dtype, "A outside [0, 1]", outside, 0, "A is the ratio of an amplitude to a larger one.")
    terms = products(settings, probe)
    why = (
        f"A sample is a sum of {terms} products. Random rounding errors are sqrt(n) 2^-24 of the sum of magnitudes "
        "(Higham and Mary 2019), and this sum is at most n times the largest."
    )
    error = envelope_error(single, double)
    yield Check("float32", "envelope against float64, of its largest", error, terms**1.5 * FLOAT32, why)
    apart = np.abs(single.image.astype(int) - double.image) > 1
    why = "Values that differ by far less than a grey level can be rounded to two neighbouring levels."
    yield none("float32", "pixels more than a grey level from float64", apart, why)
    bound = (settings.axial_samples + settings.scanlines) * 2 * FLOAT32 + 4 * FLOAT32
    why = "The position of a pixel among n samples is rounded by n 2^-23 samples, and A changes by at most 1 a sample."
    yield Check("float32", "A against float64", off(single.attenuation, double.attenuation), bound, why)


def envelope_error(frame: Frame, other: Frame) -> float:
    """Compute the largest difference of two envelopes over the largest sample of the other."""
    return off(frame.envelope, other.envelope) / (float(other.envelope.max()) or 1.0)


def products(settings: SimulatorSettings, probe: ConvexProbe = PROBE) -> int:
    """Count the products that are summed for a sample of the signal: pulse, beam and layers."""
    depth = sample_depths_mm(probe, 64)
    beam = np.count_nonzero(lateral_kernels(probe, settings, depth), axis=-1).max()
    return len(axial_kernel(probe, settings)) + int(beam) + settings.layers
