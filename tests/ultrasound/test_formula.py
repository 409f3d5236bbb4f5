"""The formula against the ray tracer where both know the same: tissue without surfaces, whose sound A tells."""

from dataclasses import replace

import numpy as np
import pytest

from ablate.anatomy import Scene, load_tissues
from ablate.ultrasound import ConvexProbe, Simulator, SimulatorSettings
from ablate.ultrasound.formula import Formula, Insonified

PROBE = ConvexProbe(frequency_mhz=3.0)
SETTINGS = SimulatorSettings(
    scanlines=96, axial_samples=512, rays=8, layers=3, image_shape=(192, 266), axial_fwhm_mm=1.2, lateral_fwhm_mm=1.6
)
TISSUE = replace(load_tissues()["liver"], texture_contrast_db=0.0)
POSE = np.eye(4)


@pytest.fixture(scope="module")
def beam():
    simulator = Simulator(Scene((), TISSUE, "liver"), PROBE, SETTINGS)
    return simulator.render(POSE, seed=3).beam


@pytest.fixture(scope="module")
def formula() -> Formula:
    return Formula([TISSUE], PROBE, SETTINGS)


def _maps(beam, **more) -> dict[str, np.ndarray]:
    return {"segmentation": beam.segmentation, "attenuation": beam.attenuation, **more}


def test_it_is_as_bright_as_the_simulators_image_at_every_depth(beam, formula: Formula) -> None:
    """A is relative to its 98th percentile, which is a constant in decibels here."""
    image = formula(formula.insonified(_maps(beam)), seed=0).astype(float)
    rows = slice(40, None)  # the aperture of a simulated frame is smaller nearby
    difference = (image - beam.image)[rows].reshape(-1, 9 * 4, 96).mean(axis=(1, 2))
    assert np.abs(difference - difference.mean()).max() < 4
    assert abs(difference.mean()) < 6


def test_with_the_lattice_its_speckle_is_the_simulators(beam, formula: Formula) -> None:
    image = formula(formula.insonified(_maps(beam, grain=beam.grain)), seed=0)
    rows = slice(40, None)
    assert np.corrcoef(image[rows].ravel(), beam.image[rows].ravel())[0, 1] > 0.8
    other = formula(formula.insonified(_maps(beam)), seed=0)
    assert abs(np.corrcoef(other[rows].ravel(), beam.image[rows].ravel())[0, 1]) < 0.2


def test_an_echo_alone_is_the_point_spread_function_at_its_level(formula: Formula) -> None:
    """One surface that is as bright as white: white in its row, and a Gaussian of the pulse's length around it."""
    rows, scanlines = SETTINGS.beam_shape
    echo = np.zeros((rows, scanlines))
    echo[100] = 1.0
    silent = np.full(echo.shape, -np.inf)
    image = formula(Insonified(np.ones(echo.shape, np.uint8), silent, echo), seed=0).astype(float)
    level_db = (image[98:103, 20:-20].mean(axis=1) / 255 - 1) * SETTINGS.dynamic_range_db
    rows_mm = PROBE.depth_mm / rows
    sigma = SETTINGS.axial_fwhm_mm / 2.3548
    expected = [-10 / np.log(10) * (k * rows_mm / sigma) ** 2 for k in (2, 1, 0, 1, 2)]
    np.testing.assert_allclose(level_db - level_db[2], expected, atol=3)


@pytest.mark.parametrize("each", [1, 2, 3])
def test_any_number_of_samples_a_row(each: int) -> None:
    settings = replace(SETTINGS, axial_samples=128 * each, samples_per_row=each, axial_fwhm_mm=4.0)
    beam = Simulator(Scene((), TISSUE, "liver"), PROBE, settings).render(POSE, seed=3).beam
    formula = Formula([TISSUE], PROBE, settings)
    for more in ({}, {"grain": beam.grain}):
        image = formula(formula.insonified(_maps(beam, **more)), seed=0)
        assert image.shape == beam.image.shape
        assert abs(image[20:].mean() - beam.image[20:].mean()) < 12


def test_what_lies_outside_the_fan_has_no_tissue(beam) -> None:
    """Label 0 is none of the tissues, also not the last, as an index of -1 would be; what is far off is as before."""
    bone = replace(load_tissues()["bone"], texture_contrast_db=0.0)
    formula = Formula([TISSUE, bone], PROBE, SETTINGS)
    labels = beam.segmentation.copy()
    labels[:, :20] = 0
    maps = _maps(beam)
    whole, cut = (formula(formula.insonified(maps | {"segmentation": read}), 0) for read in (beam.segmentation, labels))
    assert whole[:, :20].any()
    assert not cut[:, :20].any()
    np.testing.assert_allclose(cut[:, 48:].astype(int), whole[:, 48:], atol=1)  # side lobes reach it
    alone = Formula([TISSUE], PROBE, SETTINGS)
    np.testing.assert_array_equal(alone(alone.insonified(maps | {"segmentation": labels}), 0), cut)
    labels[0, 0] = 3
    with pytest.raises(ValueError, match="a label is 3, and there are 2 tissues"):
        formula(formula.insonified(maps | {"segmentation": labels}), 0)


def test_nothing_that_scatters_is_the_amplifiers_noise() -> None:
    gel = load_tissues()["coupling_gel"]
    formula = Formula([gel], PROBE, SETTINGS)
    nothing = Insonified(np.ones(SETTINGS.beam_shape, np.uint8), np.zeros(SETTINGS.beam_shape))
    beam = Simulator(Scene((), gel, "gel"), PROBE, SETTINGS).render(POSE, seed=3).beam
    assert abs(formula(nothing, 0)[-60:].mean() - beam.image[-60:].mean()) < 2.5
