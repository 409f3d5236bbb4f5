"""Surfaces against textbook formulas, in double precision, and the random numbers of the paths."""

import math

import numpy as np
import pytest
from scipy.stats import kstest

from ablate.ultrasound.transport import rays
from ablate.ultrasound.transport.scattering import (
    Interface,
    refracted,
    rough_normal,
    scatter_about,
    transmission_cosine,
)

ANGLES = np.radians([0.0, 5.0, 20.0, 40.0, 60.0, 85.0])
Vector = tuple[float, float, float]
DOWN: Vector = (0.0, 0.0, 1.0)
UP: Vector = (0.0, 0.0, -1.0)


def at(angle: float) -> Vector:
    """Direction at an angle to the normal `UP` of a surface met from above."""
    return math.sin(angle), 0.0, math.cos(angle)


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize(("c1", "c2"), [(1540.0, 1460.0), (1460.0, 1655.0), (1540.0, 3200.0)])
def test_snell_in_closed_form(c1: float, c2: float, angle: float) -> None:
    cos_t = transmission_cosine(math.cos(angle), c1, c2)
    sine = c2 / c1 * math.sin(angle)
    if sine >= 1:
        assert cos_t == 0
        return
    assert cos_t == pytest.approx(math.cos(math.asin(sine)), abs=1e-12)
    onward = refracted(at(angle), UP, math.cos(angle), cos_t, c2 / c1)
    np.testing.assert_allclose(onward, (sine, 0, math.sqrt(1 - sine**2)), atol=1e-12)


@pytest.mark.parametrize(("c1", "c2"), [(1540.0, 2600.0), (1540.0, 1540.0), (1540.0, 1100.0)])
def test_a_ray_along_a_surface_keeps_its_length(c1: float, c2: float) -> None:
    """cos i = 0: total reflection where the other side is faster, R_p = -1 where slower, nothing where equal."""
    (back, onward, pressure), _, _ = scatter_about((1.0, 0.0, 0.0), UP, Interface(c1, c2, 1.5, 3.0, True))
    assert pressure == {2600.0: 1.0, 1540.0: 0.0, 1100.0: -1.0}[c2]
    assert np.linalg.norm(back) == pytest.approx(1)
    if pressure == 0:
        assert onward == (1.0, 0.0, 0.0)


def test_rough_normals_follow_the_power_cosine() -> None:
    n, s = 50_000, 20.0
    generator = np.random.default_rng(0)
    azimuth = generator.uniform(0, 2 * np.pi, n)
    columns = np.log(generator.random(n)), np.cos(azimuth), np.sin(azimuth)
    normal = 0.48, -0.6, 0.64
    drawn = np.array([rough_normal(normal, *row, 1 / (s + 1)) for row in zip(*columns, strict=True)])
    np.testing.assert_allclose(np.linalg.norm(drawn, axis=1), 1, atol=1e-12)
    cosine = drawn @ normal
    assert cosine.mean() == pytest.approx((s + 1) / (s + 2), abs=4 * cosine.std() / np.sqrt(n))
    mean = drawn.mean(axis=0)
    np.testing.assert_allclose(mean / np.linalg.norm(mean), normal, atol=4e-3)
    assert rough_normal(DOWN, -3.0, 1.0, 0.0, 0.0) == DOWN  # a mirror


def test_unstratified_draws_are_uniform_and_unrelated() -> None:
    """Columns as in the table; neighbouring seeds, interfaces and rays have nothing in common."""
    drawn = np.array([
        [[rays.unstratified(np.uint64(seed), k, ray) for ray in range(500)] for k in range(64, 74)]
        for seed in (0, 1, 2**64 - 1)
    ])  # fmt: skip
    flat = drawn.reshape(-1, rays.COLUMNS)
    n = len(flat)
    for column in (flat[:, rays.CHOICE], flat[:, rays.SURVIVAL], np.exp(flat[:, rays.LOG_U])):
        assert kstest(column, "uniform").pvalue > 1e-3
    assert kstest(flat[:, rays.THICKNESS], "halfnorm").pvalue > 1e-3
    azimuth = np.arctan2(flat[:, rays.SIN_AZIMUTH], flat[:, rays.COS_AZIMUTH])
    assert kstest(azimuth, "uniform", (-np.pi, 2 * np.pi)).pvalue > 1e-3
    apart = np.corrcoef(flat[:, [rays.CHOICE, rays.THICKNESS, rays.LOG_U, rays.SURVIVAL]].T) - np.eye(4)
    assert (np.abs(apart) < 4 / np.sqrt(n)).all()
    u = drawn[..., rays.CHOICE]
    for one, other in ((u[0], u[1]), (u[:, 0], u[:, 1]), (u[..., 1:], u[..., :-1])):
        assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 4 / np.sqrt(one.size)


def test_draws_are_stratified_and_repeat() -> None:
    u = rays.stratified(np.random.default_rng(0), 5, 16, 2)
    assert (np.sort(np.floor(u * 16), axis=-1) == np.arange(16)).all()
    a, other = (rays.Draws(seed, 5, 16).table(10)[0][:10] for seed in (3, 4))
    step_by_step = rays.Draws(3, 5, 16)
    for k in range(10):
        step_by_step.table(k)
    assert (a == step_by_step.table(10)[0][:10]).all()
    assert abs(np.corrcoef(a[0, :, rays.CHOICE], a[1, :, rays.CHOICE])[0, 1]) < 0.4
    assert (a[9] != other[9]).any()
