"""Surfaces against textbook formulas, in double precision."""

import math

import numpy as np
import pytest

from ablate.anatomy import Tissue
from ablate.ultrasound.media import tabulate
from ablate.ultrasound.settings import DepthMode
from ablate.ultrasound.transport.bounce import (
    facing,
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
    media = tabulate([Tissue("a", c1, 1.5), Tissue("b", c2, 3.0)], np.arange(2), 3.0, DepthMode.geometric, True)
    (back, onward, pressure), _, _ = scatter_about((1.0, 0.0, 0.0), UP, 0, 1, media)
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


@pytest.mark.parametrize("normal", [DOWN, UP])
def test_a_mirror_keeps_its_normal(normal: Vector) -> None:
    assert rough_normal(normal, -3.0, 1.0, 0.0, 0.0) == normal


def test_normals_are_turned_against_the_ray() -> None:
    for normal in ((0.0, 0.0, 5.0), (0.0, 0.0, -0.1)):
        np.testing.assert_allclose(facing(normal, DOWN), UP)
