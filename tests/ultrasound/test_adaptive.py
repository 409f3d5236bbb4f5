"""Rays where they are needed: their number, against the smallest sum that meets the error; and what it may not bias."""

from dataclasses import replace

import numpy as np
import pytest

from ablate.anatomy import Scene, Tissue
from ablate.ultrasound import Simulator, SimulatorSettings
from ablate.ultrasound.transport.adaptive import HALF, Shown, rays_needed

LAYERS, LINES, NODES = 2, 40, 600


@pytest.fixture
def shown() -> Shown:
    return Shown(np.empty(0), np.empty(0), 0.0, 0.25, LINES)


def halves(deviation: np.ndarray, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Means of HALF rays about a level of 1 in all layers together, with a known deviation of one ray, by scanline."""
    rng = np.random.default_rng(seed)
    by_group = np.tile(deviation, LAYERS)[:, None]
    made = [1 / LAYERS + by_group * rng.normal(size=(LAYERS * LINES, NODES)) / HALF**0.5 for _ in range(2)]
    return made[0], made[1]


def frame_error(deviation: np.ndarray, counts: np.ndarray, shown: Shown) -> float:
    variance = np.tile(deviation, LAYERS) ** 2 / counts
    return float(np.sqrt(shown.overlap * variance.sum() / LINES))


def test_the_error_asked_for_is_met_with_the_fewest_rays(shown: Shown) -> None:
    deviation = np.linspace(0.01, 0.04, LINES)  # so small that the logarithm changes nothing
    tolerance = 0.001
    counts = rays_needed(*halves(deviation), shown, tolerance, 10**6)
    assert frame_error(deviation, counts, shown) == pytest.approx(tolerance, rel=0.05)
    for even in (counts.mean(), np.sqrt(counts.mean() * counts)):  # the same, and the same with half the contrast
        others = np.broadcast_to(even, counts.shape) * counts.sum() / np.broadcast_to(even, counts.shape).sum()
        assert frame_error(deviation, others, shown) > frame_error(deviation, counts, shown)


def test_a_group_does_not_judge_itself(shown: Shown) -> None:
    """Else one that misses what is bright would get no more rays, and the mean over seeds would be too dark."""
    a, b = halves(np.full(LINES, 0.1))
    a[LINES + 7] += 1.0
    loud = shown._replace(floor=1.0)  # so that the level hardly changes
    counts = rays_needed(a, b, loud, 0.003, 10**6).reshape(LAYERS, LINES)
    around = [counts[0, 7], counts[1, 6], counts[1, 8]]
    assert counts[1, 7] < min(around) / 1.2, "its neighbours are judged by it, and it is not"


def test_the_number_of_rays_has_a_floor_and_a_ceiling(shown: Shown) -> None:
    assert set(rays_needed(*halves(np.full(LINES, 1.0)), shown, 1e-4, 32)) == {32}
    assert set(rays_needed(*halves(np.zeros(LINES)), shown, 1e-4, 32)) == {2 * HALF}


@pytest.fixture
def rough(slab) -> Scene:
    """A rough face in front of tissue."""
    front = Tissue("front", 1540, 1.5, 0.0, 0.0, 0.0, 0.0, roughness=0.2, specularity=6.0)
    behind = Tissue("behind", 1200, 3.0, 0.3, 0.6, 0.0, 1.0)
    return Scene((slab(front, -50.0, 60.0),), behind, "s")


@pytest.fixture
def few(small) -> SimulatorSettings:
    return replace(small, scanlines=24, axial_samples=256, rays=64, image_shape=(40, 56), noise_floor_db=-55.0)


def test_a_smaller_tolerance_gives_a_smaller_error(rough, probe, few) -> None:
    exact = Simulator(rough, probe, replace(few, rays=1024)).render(np.eye(4)).envelope
    errors = []
    for tolerance in (0.2, 1e-4):
        simulator = Simulator(rough, probe, replace(few, tolerance=tolerance))
        errors.append(np.abs(simulator.render(np.eye(4)).envelope - exact).mean())
    assert errors[1] < errors[0] / 1.5


def test_the_same_seed_gives_the_same_rays(rough, probe, few, ahead) -> None:
    settings = replace(few, tolerance=0.1)
    first, again = (Simulator(rough, probe, settings).render(ahead) for _ in range(2))
    assert (first.envelope == again.envelope).all()


def test_what_surfaces_send_back_is_not_biased(rough, pencil, few) -> None:
    """Means over path seeds, all scanlines and layers alike, against those of a fixed number of rays."""
    anechoic = replace(rough, background=replace(rough.background, scatterer_density=0.0))
    settings = replace(few, rays=32, layers=1, scanlines=32, lateral_fwhm_mm=1e-6)

    def echoes(tolerance: float | None, first: int) -> np.ndarray:
        frames = (
            Simulator(anechoic, pencil, replace(settings, tolerance=tolerance, path_seed=first + k)).render(np.eye(4))
            for k in range(12)
        )
        return np.array([frame.envelope[90:115].sum(axis=0) for frame in frames]).ravel()

    adapted, fixed = echoes(0.3, 0), echoes(None, 100)
    error = np.sqrt(adapted.var(ddof=1) / adapted.size + fixed.var(ddof=1) / fixed.size)
    assert abs(adapted.mean() - fixed.mean()) <= 3 * error
    assert error < 0.05 * fixed.mean(), "the test can tell"
    assert adapted.std() > 1.2 * fixed.std(), "fewer rays were traced"
