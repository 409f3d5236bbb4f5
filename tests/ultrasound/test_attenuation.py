"""The integral attenuation map against closed forms."""

import numpy as np
import pytest

from ablate.anatomy import Scene, Tissue
from ablate.ultrasound import ConvexProbe, Simulator
from ablate.ultrasound.attenuation import integral_attenuation, loss_db_mm
from ablate.ultrasound.probe import pixel_polar


def test_power_of_frequency() -> None:
    tissue = Tissue("t", attenuation_db_cm_mhz=0.3, attenuation_power=1.5)
    assert loss_db_mm(tissue, 4.0) == pytest.approx(0.3 * 8 / 10)


def test_layers_in_closed_form() -> None:
    labels = np.repeat(np.array([[0, 1, 2]], np.uint8), [100, 50, 150], axis=1)
    losses = np.array([0.0, 1.3, 0.2])
    got = integral_attenuation(labels, losses, 0.5)
    db = np.cumsum(losses[labels[0]] * 0.5)
    amplitude = 10 ** (-db / 20)
    np.testing.assert_allclose(got[0], np.minimum(1, amplitude / np.percentile(amplitude, 98)), rtol=1e-4)


def test_in_an_image(gel, slab, small, ahead) -> None:
    probe = ConvexProbe(frequency_mhz=2.0)
    tissue = Tissue("t", 1540, 1.5, attenuation_db_cm_mhz=0.5)
    simulator = Simulator(Scene((slab(tissue, 60.0, 100.0),), gel, "s"), probe, small)
    _, attenuation = simulator.maps(ahead)
    depth, angle = pixel_polar(probe, small.image_shape)
    axis = (np.abs(angle) < 0.02) & simulator.mask
    db = np.clip(depth - 60, 0, 40) * 0.1
    np.testing.assert_allclose(attenuation[axis], 10 ** (-db[axis] / 20), atol=0.01)
    assert attenuation[~simulator.mask].max() == 0
    assert attenuation.dtype == np.float32


@pytest.mark.parametrize("db_mm", [1e2, 1e5])
def test_thousands_of_decibels(db_mm: float) -> None:
    got = integral_attenuation(np.zeros((4, 3000), np.uint8), np.array([db_mm]), 0.05)
    assert np.isfinite(got).all()
    assert (np.diff(got, axis=1) <= 0).all()
    assert got[:, 0] == pytest.approx(1)


def test_one_sample() -> None:
    assert integral_attenuation(np.zeros((1, 1), np.uint8), np.array([0.5]), 1.0) == pytest.approx(1)
