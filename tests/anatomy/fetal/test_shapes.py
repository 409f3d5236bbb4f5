"""Distance fields, swept tubes and their meshes against closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ablate.anatomy.fetal import shapes as sdf
from ablate.anatomy.fetal.tubes import frames, spindle, tube
from ablate.anatomy.meshes.repair import odd_edges

BOX = ((-40.0, -40.0, -40.0), (40.0, 40.0, 40.0))
numbers = st.floats(-50, 50)


def test_ellipsoid_volume_converges_with_order_two() -> None:
    exact = 4 / 3 * math.pi * 12 * 17 * 25
    pitches = np.array([4.0, 2.0, 1.0])
    errors = []
    for pitch in pitches:
        mesh = sdf.mesh_field(sdf.ellipsoid((1.3, -2.1, 0.7), (12, 17, 25)), BOX, pitch, "egg")
        assert len(odd_edges(mesh.faces)) == 0
        errors.append(abs(mesh.volume / exact - 1))  # positive volume: outward
    order = np.polyfit(np.log(pitches), np.log(errors), 1)[0]
    assert order == pytest.approx(2.0, abs=0.35)
    assert errors[-1] < 5e-3


def test_ellipsoid_can_be_turned() -> None:
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    field = sdf.ellipsoid((1.0, 2.0, 3.0), (5.0, 8.0, 13.0), turn)
    for axis, radius in zip(turn.T, (5.0, 8.0, 13.0), strict=True):
        assert field(*(np.array([1.0, 2.0, 3.0]) + radius * axis)) == pytest.approx(0, abs=1e-6)


def test_capsule_is_an_exact_distance() -> None:
    field = sdf.capsule((0, 0, 0), (0, 0, 10), 2.0, 2.0)
    assert field(np.array(5.0), np.array(0.0), np.array(4.0)) == pytest.approx(3.0)
    assert field(np.array(3.0), np.array(0.0), np.array(14.0)) == pytest.approx(3.0)


@given(numbers, numbers, st.floats(0.1, 20))
def test_smooth_minimum_is_between_the_minimum_and_a_quarter_blend_below(a: float, b: float, k: float) -> None:
    low = float(sdf.smooth_min(np.array(a), np.array(b), k))
    assert min(a, b) - k / 4 - 1e-9 <= low <= min(a, b) + 1e-9
    if abs(a - b) >= k:
        assert low == min(a, b)
    assert float(sdf.smooth_max(np.array(a), np.array(b), k)) == pytest.approx(
        -float(sdf.smooth_min(np.array(-a), np.array(-b), k))
    )


def test_union_and_difference_of_spheres_have_the_lens_volume() -> None:
    a, b, r, d = sdf.ellipsoid((-3, 0, 0), (8, 8, 8)), sdf.ellipsoid((3, 0, 0), (8, 8, 8)), 8.0, 6.0
    ball = 4 / 3 * math.pi * r**3
    lens = math.pi * (4 * r + d) * (2 * r - d) ** 2 / 12
    for field, exact in (
        (sdf.union([a, b], 1e-3), 2 * ball - lens),
        (sdf.intersection([a, b], 1e-3), lens),
        (sdf.intersection([a, sdf.outside(b)], 1e-3), ball - lens),
    ):
        assert sdf.mesh_field(field, BOX, 0.5, "s").volume == pytest.approx(exact, rel=0.015)


def test_ripple_has_the_given_size_and_follows_its_seed() -> None:
    points = np.random.default_rng(1).uniform(-500, 500, (3, 40_000))
    plane = sdf.half_space((0.0, 0.0, 1.0), 0.0)
    moved, again, other = (sdf.rippled(plane, seed, 1.5, 20.0)(*points) - plane(*points) for seed in (5, 5, 6))
    assert moved.std() == pytest.approx(1.5, rel=0.02)
    assert (moved == again).all()
    assert not np.allclose(moved, other)


def test_empty_and_clipped_shapes_are_refused_by_name() -> None:
    with pytest.raises(ValueError, match="nothing: the shape is empty"):
        sdf.mesh_field(sdf.ellipsoid((500, 0, 0), (1, 1, 1)), BOX, 1.0, "nothing")
    with pytest.raises(ValueError, match="giant: the shape leaves its box"):
        sdf.mesh_field(sdf.ellipsoid((0, 0, 0), (60, 10, 10)), BOX, 1.0, "giant")


@pytest.mark.parametrize("sides", [3, 4, 12])
def test_straight_tube_is_a_prism(sides: int) -> None:
    path = np.linspace((1.0, 2.0, 3.0), (11.0, 2.0, 3.0), 5)
    mesh = tube(path, np.full(5, 2.0), sides)
    exact = 10.0 * sides / 2 * 4.0 * math.sin(2 * math.pi / sides)
    assert mesh.volume == pytest.approx(exact)
    assert len(mesh.faces) == 2 * 5 * sides
    assert len(odd_edges(mesh.faces)) == 0
    assert mesh.is_winding_consistent


def test_half_torus_has_pappus_volume() -> None:
    angle = np.linspace(0, math.pi, 200)
    path = np.stack([20 * np.cos(angle), 20 * np.sin(angle), 0 * angle], 1)
    mesh = tube(path, np.full(200, 3.0), 64)
    assert mesh.volume == pytest.approx(math.pi * 9 * math.pi * 20, rel=3e-3)


def test_two_radii_make_an_ellipse_with_its_first_axis_along_up() -> None:
    mesh = tube(np.linspace((0, 0, 0), (0, 0, 8), 3), np.tile([1.0, 4.0], (3, 1)), 64, up=(1, 0, 0))
    assert mesh.extents == pytest.approx([2, 8, 8], rel=1e-6)


def test_frames_are_orthonormal_and_do_not_twist() -> None:
    t = np.linspace(0, 4 * math.pi, 400)
    helix = np.stack([5 * np.cos(t), 5 * np.sin(t), 2 * t], 1)
    first, second = frames(helix, (0, 0, 1))
    assert (first * second).sum(1) == pytest.approx(0, abs=1e-12)
    assert np.linalg.norm(first, axis=1) == pytest.approx(1)
    turn = np.diff(first, axis=0)
    assert np.abs((turn * second[:-1]).sum(1)).max() < 1e-3  # it never turns about the path


def test_spindle_is_an_ellipsoid() -> None:
    mesh = spindle((0, 0, -6), (0, 0, 6), (2.0, 3.0), 64, up=(1, 0, 0))
    assert mesh.volume == pytest.approx(4 / 3 * math.pi * 6 * 2 * 3, rel=0.01)
