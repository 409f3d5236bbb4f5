"""A small case of docs/against_pymust: one lesion in ablate and in PyMUST, and the measures against closed forms."""

import importlib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy import ndimage
from threadpoolctl import threadpool_limits

pytest.importorskip("pymust")
FOLDER = Path(__file__).parents[2] / "scripts" / "against_pymust"


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator:
    """Threads of NumPy's BLAS wait for each other in PyMUST's small products: five times the processor time."""
    with threadpool_limits(1):
        yield


@pytest.fixture(scope="module")
def load() -> Iterator:
    """Modules of the folder by name."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(FOLDER)
        yield importlib.import_module


@pytest.fixture(scope="module")
def measures(load) -> ModuleType:
    return load("speckle_measures")


@pytest.mark.slow
def test_both_simulators_show_the_same_lesion(load) -> None:
    """Both get the same pulse. The lesion has its true size; the speckle follows the images of single points."""
    compare, phantoms, arrays = load("compare"), load("lesion_phantom"), load("pymust_array")
    lesion = phantoms.Lesion("lesion", 0.0, 50.0, 6.0, -6.0)
    phantom = phantoms.Phantom(36.0, 64.0, 20.0, (lesion,), per_mm2=12.0, samples=640, lines=51)
    array = arrays.Array(fov_deg=50.0, elements=48, transmissions=5)
    settings = compare.matched_settings(phantom, arrays.point_widths(array, [40.0, 50.0, 60.0]))
    clouds = [*compare.points(phantom), phantoms.scatterers(phantom, 0)]
    *points, image = arrays.images(array, clouds, phantom.depths_mm, phantom.angles_rad)
    pymust = compare.measured(phantom, np.abs(image))
    images = [compare.measured(phantom, image) for image in compare.render(phantom, array, settings, range(12))]
    ablate = {key: np.mean([measures[key] for measures in images]) for key in pymust}
    for measures, expected, tolerance in (
        (pymust, compare.expected(phantom, points, phantom.per_mm2), 0.15),
        (ablate, compare.expected(phantom, compare.pulse_points(phantom, settings), np.inf), 0.06),
    ):
        assert measures["mean / sd"] == pytest.approx(expected["mean / sd"], abs=0.05)
        assert measures["distance to Rayleigh"] < 0.03
        assert measures["lesion: contrast (dB)"] == pytest.approx(-6, abs=1)
        assert measures["lesion: diameter (mm)"] == pytest.approx(12, abs=0.5)
        for key in (key for key in expected if "cell" in key):
            assert measures[key] == pytest.approx(expected[key], rel=tolerance), key


@pytest.fixture(scope="module")
def speckle() -> np.ndarray:
    """Circular Gaussian noise through a Gaussian pulse of 6 x 4 samples (standard deviation), unit mean power."""
    noise = np.random.default_rng(3).standard_normal((2, 1000, 1000))
    smooth = ndimage.gaussian_filter(noise, (0, 6, 4))
    return np.hypot(*smooth) / np.sqrt(2 * smooth.var())


def test_measures_of_uniform_speckle(measures, speckle) -> None:
    assert measures.mean_over_sd(speckle) == pytest.approx(np.sqrt(np.pi / (4 - np.pi)), abs=0.02)
    assert measures.rayleigh_distance(speckle) < 0.01
    y, x = np.mgrid[-60:61, -60:61]
    point = np.exp(-(y**2) / (2 * 6**2) - x**2 / (2 * 4**2))
    expected = measures.expected_cell(point)
    # of a Gaussian pulse: the width at which 2F1(-1/2, -1/2; 1; r^2) - 1 is half of 4/pi - 1, r^2 = 0.527
    assert expected == pytest.approx([2 * sd * np.sqrt(-2 * np.log(0.527)) for sd in (6, 4)], rel=0.01)
    assert [measures.cell_size(speckle, axis) for axis in (0, 1)] == pytest.approx(expected, rel=0.03)


def test_measures_of_a_lesion(measures, speckle) -> None:
    y, x = np.mgrid[:1000, :1000]
    distance = np.hypot(y - 500, x - 500)
    image = np.where(distance < 250, 0.5, 1.0) * speckle
    inside, outside = image[distance < 250], image[distance > 250]
    assert measures.contrast_db(inside, outside) == pytest.approx(20 * np.log10(0.5), abs=0.3)
    rings = np.arange(0.0, 500.0, 20.0)
    profile = measures.radial_profile(image**2, distance, rings)
    assert measures.lesion_diameter(profile, rings, 450.0) == pytest.approx(500, rel=0.01)


@pytest.mark.parametrize("per_cell", [8.0, 20.0])
def test_few_scatterers_a_cell(measures, per_cell) -> None:
    """Sums of a Poisson number of unit phasors, which is a cell with a flat pulse."""
    generator = np.random.default_rng(5)
    counts = generator.poisson(per_cell, 200_000)
    phasors = np.exp(2j * np.pi * generator.random(counts.sum()))
    ends = np.cumsum(counts)
    total = np.concatenate([[0], np.cumsum(phasors)])
    envelope = np.abs(total[ends] - total[ends - counts])
    assert measures.mean_over_sd(envelope) == pytest.approx(measures.expected_mean_over_sd(per_cell), abs=0.01)
    assert measures.expected_mean_over_sd(np.inf) == pytest.approx(1.913, abs=1e-3)
    flat = np.ones((5, 4))
    assert measures.scatterers_per_cell(flat, 0.5, per_cell / 10) == pytest.approx(per_cell)


def test_contrast_of_a_blurred_step(measures) -> None:
    """Half a plane of scatterers through a pulse that puts a hundredth of its power into a far side lobe."""
    power = np.zeros((41, 201))
    power[:, 100:] = 1
    point = np.zeros((41, 201))
    point[20, 100], point[20, 150] = 0.99, 0.01
    columns = np.broadcast_to(np.arange(201), power.shape)
    far, near = columns < 40, (columns > 60) & (columns < 90)
    scattering = columns > 160
    assert measures.expected_contrast_db(power, point, scattering, scattering) == pytest.approx(0)
    assert measures.expected_contrast_db(power, point[:, ::-1], near, scattering) == pytest.approx(-20, abs=0.1)
    assert measures.expected_contrast_db(power, point[:, ::-1], far, scattering) < -100
