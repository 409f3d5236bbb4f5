"""Swept tubes against closed forms."""

import math

import numpy as np
import pytest

from ablate.anatomy.fetal.shapes import frames, joined, rod, smooth_path, spindle, tube
from ablate.anatomy.meshes.repair import odd_edges


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


def test_rod_is_as_long_as_asked() -> None:
    mesh = rod((0, 0, 0), (39, 0, 0), 2.0, 16, bow_mm=1.0)
    assert mesh.extents[0] == pytest.approx(39.0, abs=0.1)
    assert len(odd_edges(mesh.faces)) == 0
    assert mesh.volume > 0


def test_smooth_path_passes_through_its_ends() -> None:
    path = smooth_path([(0, 0, 0), (1, 5, 0), (7, 2, 1), (9, 9, 9)], 50)
    assert path[0] == pytest.approx([0, 0, 0])
    assert path[-1] == pytest.approx([9, 9, 9])


def test_joined_meshes_keep_their_volumes() -> None:
    parts = [rod((0, 0, 3.0 * i), (10, 0, 3.0 * i), 1.0, 8) for i in range(4)]
    whole = joined(parts, "bars")
    assert whole.volume == pytest.approx(sum(part.volume for part in parts))
    assert whole.metadata["name"] == "bars"
    assert len(odd_edges(whole.faces)) == 0
