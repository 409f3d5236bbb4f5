"""Holds of the probe against the grid of probe sites, and back from poses."""

import numpy as np
import pytest
import trimesh

from ablate.anatomy import Scene, SiteGrid, Structure, Tissue, fetal_abdomen, fetal_planes, fetal_sites
from ablate.dataset import place_probe
from ablate.ultrasound import ConvexProbe
from ablate.viewer.hand import Hand, Hold

PROBE = ConvexProbe()
AXIS, FRONT = (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)
GRID = SiteGrid(AXIS, FRONT, (-20.0, 30.0), (-40.0, 0.0, 55.0), (-15.0, 10.0), (0.0, 90.0))


@pytest.fixture(scope="module")
def hand(body: Scene) -> Hand:
    return Hand(body, AXIS, FRONT, 5.0, PROBE)


def test_a_hold_is_the_pose_of_the_same_probe_site(body: Scene, hand: Hand) -> None:
    poses = iter(place_probe(body, GRID, 5.0, PROBE).poses)
    for height in GRID.heights_mm:
        for angle in GRID.angles_deg:
            for rock in GRID.tilts_deg:
                for roll in GRID.rolls_deg:
                    held = hand.place(Hold(height, angle, roll, rock))
                    assert held is not None
                    np.testing.assert_allclose(held.pose, next(poses).probe_to_world, atol=1e-9)
                    assert held.words == ""


@pytest.mark.parametrize("hold", [Hold(10, 20), Hold(-30, -50, 70, 10, -12), Hold(0, 100, -120, -20, 15)])
def test_a_hold_is_found_again_from_its_pose(hand: Hand, hold: Hold) -> None:
    held = hand.place(hold)
    assert held is not None
    found = hand.hold_of(held.pose)
    for name in ("height_mm", "angle_deg", "roll_deg", "rock_deg", "tilt_deg"):
        assert getattr(found, name) == pytest.approx(getattr(hold, name), abs=0.5), name


def test_tilt_turns_the_image_plane_about_the_probes_x(hand: Hand) -> None:
    straight, tilted = hand.place(Hold(0, 0)), hand.place(Hold(0, 0, tilt_deg=20))
    assert straight is not None
    assert tilted is not None
    np.testing.assert_allclose(tilted.pose[:3, 0], straight.pose[:3, 0], atol=1e-9)
    assert tilted.pose[:3, 2] @ straight.pose[:3, 2] == pytest.approx(np.cos(np.deg2rad(20)))


def test_beyond_the_body_there_is_nothing_to_hold_it_on(hand: Hand) -> None:
    assert hand.place(Hold(500, 0)) is None


def test_a_face_over_the_edge_is_off_the_body(hand: Hand) -> None:
    held = hand.place(Hold(98, 0, roll_deg=90))
    assert held is not None
    assert held.words.startswith("off the body")
    assert hand.judge(held.pose).startswith("off the body")


def test_a_face_in_bone_is_said() -> None:
    bone = Tissue("bone", impedance_mrayl=6.0)
    scene = Scene((Structure(trimesh.creation.cylinder(radius=100, height=200, sections=180), bone),), Tissue("g"), "b")
    hand = Hand(scene, AXIS, FRONT, 5.0, PROBE)
    held = hand.place(Hold(0, 0))
    assert held is not None
    assert held.words.startswith("in bone")
    assert hand.judge(held.pose).startswith("in bone")


def test_a_pose_in_the_air_is_off_the_body(hand: Hand) -> None:
    held = hand.place(Hold(0, 0))
    assert held is not None
    assert hand.judge(held.pose) == ""
    away = held.pose.copy()
    away[:3, 3] -= 60 * away[:3, 2]
    assert hand.judge(away).startswith("off the body")


def test_standard_planes_are_held_within_a_few_millimetres() -> None:
    scene, sites = fetal_abdomen(triangles=6000), fetal_sites()
    hand = Hand(scene, sites.axis, sites.front, 8.0, PROBE)
    for name, pose in fetal_planes().items():
        held = hand.place(hand.hold_of(pose))
        assert held is not None
        off = pose[:3, 3] - held.pose[:3, 3]
        np.testing.assert_allclose(held.pose[:3, :3], pose[:3, :3], atol=1e-6, err_msg=name)
        assert np.linalg.norm(off) < 12, name


def test_a_scene_without_structures_is_refused() -> None:
    with pytest.raises(ValueError, match="no structure to put a probe on"):
        Hand(Scene((), Tissue("gel"), "empty"), AXIS, FRONT, 5.0, PROBE)
