"""The integral attenuation map against closed forms."""

import numpy as np
import pytest

from ablate.anatomy import Scene, Tissue
from ablate.ultrasound import ConvexProbe, Simulator, SimulatorSettings
from ablate.ultrasound.maps.attenuation import integral_attenuation

LAYERS = (  # near mm, far mm, alpha, b
    (10.0, 30.0, 1.2, 1.0),
    (35.0, 60.0, 0.1, 1.0),
    (60.2, 90.0, 0.8, 1.3),
)
BODY = 0.3  # dB/cm/MHz around the layers
FREQUENCY = 2.0


def decay(depth: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Amplitude left after the way along a scanline of the fan, through flat layers, one way."""
    face = 40 * (np.cos(angle) - 1)
    z = face + depth * np.cos(angle)
    db = BODY * FREQUENCY / 10 * depth
    for near, far, alpha, power in LAYERS:
        within = np.clip(np.minimum(z, far) - np.maximum(face, near), 0, None) / np.cos(angle)
        db = db + within * (alpha * FREQUENCY**power - BODY * FREQUENCY) / 10
    return 10 ** (-db / 20)


@pytest.mark.parametrize("settings", [SimulatorSettings(), SimulatorSettings(scanlines=160, axial_samples=2000)])
def test_layers_in_closed_form(slab, ahead, settings) -> None:
    """Every pixel of the fan; the map is divided by the 98th percentile of the scanlines' samples, and clipped."""
    tissues = (Tissue(f"t{i}", 1540, 1.5, alpha, attenuation_power=b) for i, (_, _, alpha, b) in enumerate(LAYERS))
    slabs = tuple(slab(tissue, near, far) for tissue, (near, far, _, _) in zip(tissues, LAYERS, strict=True))
    probe = ConvexProbe(frequency_mhz=FREQUENCY)
    simulator = Simulator(Scene(slabs, Tissue("body", 1540, 1.5, BODY), "s"), probe, settings)
    labels, attenuation = simulator.maps(ahead)
    assert attenuation.dtype == np.float32

    ends = np.arange(1, settings.axial_samples + 1) * 150 / settings.axial_samples
    angles = np.linspace(-1, 1, settings.scanlines) * np.radians(35)
    percentile = np.percentile(decay(*np.meshgrid(ends, angles)), 98)
    half = np.radians(35)
    rows, columns = settings.image_shape
    x = ((np.arange(columns) + 0.5) / columns - 0.5) * 2 * 190 * np.sin(half)
    from_centre = (np.arange(rows)[:, None] + 0.5) / rows * (190 - 40 * np.cos(half)) + 40 * np.cos(half)
    expected = np.minimum(1, decay(np.hypot(x, from_centre) - 40, np.arctan2(x, from_centre)) / percentile)
    fan = labels > 0
    np.testing.assert_allclose(attenuation[fan], expected[fan], rtol=5e-3)
    assert 0 < (expected[fan] == 1).mean() < 0.02
    assert attenuation[~fan].max() == 0


@pytest.mark.parametrize("db_mm", [1e2, 1e5])
def test_thousands_of_decibels(db_mm: float) -> None:
    got = integral_attenuation(np.zeros((4, 3000), np.uint8), np.array([db_mm]), 0.05)
    assert np.isfinite(got).all()
    assert (np.diff(got, axis=1) <= 0).all()
    assert got[:, 0] == pytest.approx(1)


def test_one_sample() -> None:
    assert integral_attenuation(np.zeros((1, 1), np.uint8), np.array([0.5]), 1.0) == pytest.approx(1)
