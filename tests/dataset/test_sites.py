"""Poses on the skin of shapes whose surface is known."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from ablate.anatomy import Scene, SiteGrid, Structure, Tissue
from ablate.dataset import probe_poses, resample_grid

GRID = SiteGrid((0, 0, 1), (0, -1, 0), (-20.0, 0.0, 20.0), (-40.0, 0.0, 40.0), (-15.0, 0.0, 15.0), (0.0, 90.0))


def cylinder(radius: float) -> Scene:
    mesh = trimesh.creation.cylinder(radius=radius, height=200, sections=720)
    return Scene((Structure(mesh, Tissue("skin")),), Tissue("gel"), "cylinder")


def test_poses_are_rigid_and_touch_the_skin() -> None:
    poses = probe_poses(cylinder(100), GRID, press_mm=5)
    assert len(poses) == 3 * 3 * 3 * 2
    assert len({p.site for p in poses}) == 9
    for pose in poses:
        m = pose.probe_to_world
        np.testing.assert_allclose(m[:3, :3].T @ m[:3, :3], np.eye(3), atol=1e-9)
        assert np.linalg.det(m[:3, :3]) == pytest.approx(1)


def test_angles_turn_about_the_axis_and_the_probe_looks_inward() -> None:
    grid = SiteGrid((0, 0, 1), (0, -1, 0), (0.0,), (0.0, 90.0), (0.0,), (0.0,))
    front, side = (p.probe_to_world for p in probe_poses(cylinder(100), grid, press_mm=5))
    np.testing.assert_allclose(front[:3, 3], [0, -95, 0], atol=0.1)
    np.testing.assert_allclose(front[:3, 2], [0, 1, 0], atol=0.01)
    np.testing.assert_allclose(front[:3, 0], np.cross(front[:3, 2], [0, 0, 1]), atol=0.01)  # x = z cross axis
    np.testing.assert_allclose(side[:3, 3], [95, 0, 0], atol=0.1)  # right hand about +z from -y is +x


def test_roll_turns_to_the_sagittal_plane_and_tilt_rocks_within_the_plane() -> None:
    grid = SiteGrid((0, 0, 1), (0, -1, 0), (0.0,), (0.0,), (0.0, 15.0), (0.0, 90.0))
    upright, sagittal, tilted, _ = (p.probe_to_world for p in probe_poses(cylinder(100), grid, press_mm=0))
    assert abs(sagittal[:3, 0] @ [0, 0, 1]) == pytest.approx(1, abs=0.01)
    np.testing.assert_allclose(tilted[:3, 1], upright[:3, 1], atol=1e-9)
    assert tilted[:3, 2] @ upright[:3, 2] == pytest.approx(np.cos(np.deg2rad(15)))


def test_directions_that_miss_are_dropped_and_nothing_left_is_an_error() -> None:
    grid = SiteGrid((0, 0, 1), (0, -1, 0), (0.0, 500.0), (0.0,), (0.0,), (0.0,))
    assert len(probe_poses(cylinder(100), grid, 5)) == 1
    beyond = SiteGrid((0, 0, 1), (0, -1, 0), (500.0,), (0.0,), (0.0,), (0.0,))
    with pytest.raises(ValueError, match="no probe site meets the body"):
        probe_poses(cylinder(100), beyond, 5)
    with pytest.raises(ValueError, match="no structure"):
        probe_poses(Scene((), Tissue("gel"), "empty"), GRID, 5)


def test_a_grid_is_resampled_over_its_own_ranges() -> None:
    fine = resample_grid(GRID, (13, 19, 9, 3))
    assert (len(fine.heights_mm), len(fine.angles_deg), len(fine.tilts_deg), len(fine.rolls_deg)) == (
        13,
        19,
        9,
        3,
    )
    assert (fine.heights_mm[0], fine.heights_mm[-1]) == (-20, 20)
    assert 13 * 19 * 9 * 3 == 6669  # the paper's number of frames
    with pytest.raises(ValueError, match=r"dataset\.grid"):
        resample_grid(GRID, (0, 1, 1, 1))
