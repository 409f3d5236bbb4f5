"""The attenuation map compensated for the time gain, against closed forms and a plain loop."""

import math

import numpy as np
import pytest

from ablate.anatomy import Scene, Tissue
from ablate.ultrasound import ConvexProbe, Simulator, SimulatorSettings, compensated_attenuation
from ablate.ultrasound.probe import fan_mask, pixel_polar
from ablate.ultrasound.time_gain import compensated_beam

PROBE = ConvexProbe(frequency_mhz=3.0)
SETTINGS = SimulatorSettings(scanlines=160, axial_samples=2000, image_shape=(250, 347))
TGC = SETTINGS.tgc_db_cm_mhz


def body(attenuation_db_cm_mhz: float) -> Tissue:
    return Tissue("body", 1540, 1.5, attenuation_db_cm_mhz)


def compensated(scene: Scene, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The map of a pose, and the depth of its pixels in mm, NaN outside the fan."""
    labels, attenuation = Simulator(scene, PROBE, SETTINGS).maps(pose)
    depth, _ = pixel_polar(PROBE, SETTINGS.image_shape)
    return compensated_attenuation(attenuation, PROBE, TGC), np.where(labels > 0, depth, np.nan)


def test_tissue_with_the_slope_of_the_time_gain_is_flat(ahead: np.ndarray) -> None:
    """Where A is not clipped, it is exp(-mu (z - z98)), and z98 lies 2 % of the depth below the face."""
    values, depth = compensated(Scene((), body(TGC), "uniform"), ahead)
    assert values.dtype == np.float32
    level = 0.5 + 2 * TGC * 3 * 0.02 * 15 / 72
    np.testing.assert_allclose(values[depth > 4], level, atol=1e-3)
    assert (values[np.isnan(depth)] == 0).all()


@pytest.mark.parametrize("thick_mm", [10.0, 30.0])
def test_behind_fluid_it_is_brighter_by_what_the_gain_adds_there(ahead: np.ndarray, slab, thick_mm: float) -> None:
    fluid = slab(Tissue("fluid", 1540, 1.5, 0.0), 40.0, 40.0 + thick_mm)
    values, depth = compensated(Scene((fluid,), body(TGC), "fluid"), ahead)
    line, z = values[:, 173].astype(float), depth[:, 173]
    before, behind = line[(z > 10) & (z < 38)], line[z > 42 + thick_mm]
    assert np.ptp(before) < 2e-3
    assert np.ptp(behind) < 2e-3
    assert 72 * (behind.mean() - before.mean()) == pytest.approx(2 * thick_mm / 10 * TGC * 3, abs=0.1)


def test_every_pixel_is_that_of_a_plain_loop() -> None:
    """Three frames of any values, 0 and 1 among them, at two frequencies and gains."""
    random = np.random.default_rng(0)
    attenuation = (10 ** random.uniform(-6, 0, (3, 20, 28))).astype(np.float32)
    attenuation[0, :, ::5], attenuation[1, :, ::5] = 0, 1
    for probe, tgc in ((PROBE, 0.4), (ConvexProbe(radius_mm=50, fov_deg=60, depth_mm=90, frequency_mhz=8), 1.0)):
        half = math.radians(probe.fov_deg) / 2
        wide = 2 * (probe.radius_mm + probe.depth_mm) * math.sin(half)
        top = probe.radius_mm * math.cos(half)
        high = probe.radius_mm + probe.depth_mm - top
        expected = np.zeros(attenuation.shape)
        for k, i, j in np.ndindex(*attenuation.shape):
            x, y = ((j + 0.5) / 28 - 0.5) * wide, top + (i + 0.5) / 20 * high
            depth_cm = (math.hypot(x, y) - probe.radius_mm) / 10
            if 0 <= depth_cm <= probe.depth_mm / 10 and abs(math.atan2(x, y)) <= half:
                level = 20 * 2 * math.log10(max(float(attenuation[k, i, j]), 1e-4))
                level += 2 * tgc * probe.frequency_mhz * depth_cm
                expected[k, i, j] = min(max((level + 36) / 72, 0), 1)
        values = compensated_attenuation(attenuation, probe, tgc)
        np.testing.assert_allclose(values, expected, atol=2e-6)
        fan = fan_mask(probe, (20, 28))
        assert values[:, fan].min() == 0  # too dark or too bright for the range inside the fan, too
        assert values[:, fan].max() == (1 if tgc == 1.0 else pytest.approx(1, abs=0.05))
        np.testing.assert_array_equal(values[1], compensated_attenuation(attenuation[1], probe, tgc))
        gain_db = 2 * tgc * probe.frequency_mhz * (np.arange(20)[:, None] + 0.5) * probe.depth_mm / 200  # in beam space
        level = (40 * np.log10(np.maximum(attenuation, 1e-4)) + gain_db + 36) / 72
        np.testing.assert_allclose(compensated_beam(attenuation, probe, tgc), np.clip(level, 0, 1), atol=2e-6)
