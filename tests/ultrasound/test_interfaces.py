"""Surfaces against textbook formulas, in double precision."""

import numpy as np
import pytest

from ablate.ultrasound.interfaces import (
    facing,
    mirrored,
    pressure_reflection,
    refracted,
    rough_normal,
    transmission_cosine,
)

ANGLES = np.radians([0.0, 5.0, 20.0, 40.0, 60.0, 85.0])


def rays(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    direction = np.stack([np.sin(angles), np.zeros_like(angles), np.cos(angles)], axis=-1)
    return direction, np.tile([0.0, 0.0, -1.0], (len(angles), 1))


@pytest.mark.parametrize(("c1", "c2"), [(1540.0, 1460.0), (1460.0, 1655.0), (1540.0, 3200.0)])
def test_snell_in_closed_form(c1: float, c2: float) -> None:
    direction, normal = rays(ANGLES)
    cos_i = np.cos(ANGLES)
    cos_t = transmission_cosine(cos_i, np.full(6, c1), np.full(6, c2))
    sine = c2 / c1 * np.sin(ANGLES)
    total = sine >= 1
    np.testing.assert_allclose(cos_t[~total], np.cos(np.arcsin(sine[~total])), atol=1e-12)
    assert (cos_t[total] == 0).all()
    onward = refracted(direction, normal, cos_i, cos_t, np.full(6, c2 / c1))[~total]
    np.testing.assert_allclose(np.linalg.norm(onward, axis=1), 1, atol=1e-12)
    np.testing.assert_allclose(onward[:, 0], sine[~total], atol=1e-12)
    assert (onward[:, 2] > 0).all()


def test_mirror_law() -> None:
    direction, normal = rays(ANGLES)
    np.testing.assert_allclose(mirrored(direction, normal, np.cos(ANGLES)), direction * (1, 1, -1), atol=1e-15)


@pytest.mark.parametrize(("z1", "z2"), [(1.63, 1.4), (1.63, 7.8), (1.63, 4e-4), (4e-4, 8.0)])
def test_fresnel_conserves_energy(z1: float, z2: float) -> None:
    c1, c2 = 1540.0, 2600.0
    cos_i = np.cos(ANGLES)
    cos_t = transmission_cosine(cos_i, np.full(6, c1), np.full(6, c2))
    r = pressure_reflection(np.full(6, z1), np.full(6, z2), cos_i, cos_t)
    t = 2 * z2 * cos_i / (z2 * cos_i + z1 * cos_t)
    transmitted = t**2 * (z1 * cos_t) / (z2 * cos_i)  # energy crossing the surface
    np.testing.assert_allclose(r**2 + transmitted, 1, atol=1e-12)
    assert r[0] == pytest.approx((z2 - z1) / (z2 + z1), abs=1e-15)
    assert (np.abs(r[cos_t == 0]) == 1).all()


def test_equal_media_do_nothing() -> None:
    direction, normal = rays(ANGLES)
    same = np.full(6, 1540.0)
    cos_i = np.cos(ANGLES)
    cos_t = transmission_cosine(cos_i, same, same)
    assert (pressure_reflection(same, same, cos_i, cos_t) == 0).all()
    assert (refracted(direction, normal, cos_i, cos_t, np.ones(6)) == direction).all()


def test_two_way_transmission_is_what_reflection_leaves() -> None:
    z1, z2, one = np.array([1.63]), np.array([4.2]), np.ones(1)
    r = pressure_reflection(z1, z2, one, one)
    there, back = 2 * z2 / (z1 + z2), 2 * z1 / (z1 + z2)
    np.testing.assert_allclose(1 - r**2, there * back, rtol=1e-14)


def test_rough_normals_follow_the_power_cosine() -> None:
    n, s = 200_000, 20.0
    generator = np.random.default_rng(0)
    azimuth = generator.uniform(0, 2 * np.pi, n)
    normal = np.tile(np.array([0.48, -0.6, 0.64]), (n, 1))
    drawn = rough_normal(normal, np.log(generator.random(n)), np.cos(azimuth), np.sin(azimuth), np.full(n, 1 / (s + 1)))
    np.testing.assert_allclose(np.linalg.norm(drawn, axis=1), 1, atol=1e-12)
    cosine = (drawn * normal).sum(axis=1)
    assert cosine.mean() == pytest.approx((s + 1) / (s + 2), abs=4 * cosine.std() / np.sqrt(n))
    mean = drawn.mean(axis=0)
    np.testing.assert_allclose(mean / np.linalg.norm(mean), normal[0], atol=2e-3)


@pytest.mark.parametrize("z", [1.0, -1.0])
def test_a_mirror_keeps_its_normal(z: float) -> None:
    normal = np.array([[0.0, 0.0, z]])
    one = np.ones(1)
    assert (rough_normal(normal, -3 * one, one, 0 * one, 0 * one) == normal).all()


def test_normals_are_turned_against_the_ray() -> None:
    direction = np.array([[0, 0, 1.0], [0, 0, 1.0]])
    unit = facing(np.array([[0, 0, 5.0], [0, 0, -0.1]]), direction)
    np.testing.assert_allclose(unit, [[0, 0, -1], [0, 0, -1]])
