"""Holds of the probe against the grid of probe sites, and back from poses."""

from itertools import product

import numpy as np
import pytest
import trimesh

from ablate.anatomy import Scene, SiteGrid, Structure, Tissue, fetal_abdomen, fetal_planes, fetal_sites
from ablate.dataset import place_probe
from ablate.ultrasound import ConvexProbe
from ablate.viewer.hand import Hand, Hold
from support.viewed_body import BODY

PROBE = ConvexProbe()
AXIS, FRONT = (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)
GRID = SiteGrid(AXIS, FRONT, (-20.0, 30.0), (-40.0, 0.0, 55.0), (-15.0, 10.0), (0.0, 90.0))


@pytest.fixture(scope="module")
def hand() -> Hand:
    return Hand(BODY, AXIS, FRONT, 5.0, PROBE)


def place(hand: Hand, hold: Hold) -> tuple[np.ndarray, str]:
    held = hand.place(hold)
    assert held is not None
    return held


def test_a_hold_is_the_pose_of_the_same_probe_site(hand: Hand) -> None:
    poses = iter(place_probe(BODY, GRID, 5.0, PROBE).poses)
    for height, angle, rock, roll in product(GRID.heights_mm, GRID.angles_deg, GRID.tilts_deg, GRID.rolls_deg):
        pose, words = place(hand, Hold(height, angle, roll, rock))
        np.testing.assert_allclose(pose, next(poses), atol=1e-9)
        assert words == ""


@pytest.mark.parametrize("hold", [Hold(10, 20), Hold(-30, -50, 70, 10, -12), Hold(0, 100, -120, -20, 15)])
def test_a_hold_is_found_again_from_its_pose(hand: Hand, hold: Hold) -> None:
    found_again = hand.hold_of(place(hand, hold)[0])
    for name in ("height_mm", "angle_deg", "roll_deg", "rock_deg", "tilt_deg"):
        assert getattr(found_again, name) == pytest.approx(getattr(hold, name), abs=0.5), name


def test_the_axis_of_an_aimed_probe_goes_through_the_point_from_the_nearest_side(hand: Hand) -> None:
    point = np.array([12.0, -9.0, 14.0])
    pose = hand.aim(point, (-30.0, 0.0, 150.0))
    assert pose is not None
    x, y, _ = (point - pose[:3, 3]) @ pose[:3, :3]
    assert (x, y) == pytest.approx((0, 0), abs=0.01)
    assert abs(hand.site_of(pose[:3, 3])[1]) < 20, "angle 0 is nearer to the front left than -30 or 150"
    assert hand.judge(pose) == ""
    assert hand.aim(np.array([0.0, 0.0, 500.0]), (0.0, 90.0)) is None, "there is no skin at this height"


def test_tilt_turns_the_image_plane_about_the_probes_x(hand: Hand) -> None:
    straight, tilted = (place(hand, Hold(0, 0, tilt_deg=tilt))[0] for tilt in (0, 20))
    np.testing.assert_allclose(tilted[:3, 0], straight[:3, 0], atol=1e-9)
    assert tilted[:3, 2] @ straight[:3, 2] == pytest.approx(np.cos(np.deg2rad(20)))


def test_a_face_in_bone_is_said() -> None:
    bone = Tissue("bone", impedance_mrayl=6.0)
    scene = Scene((Structure(trimesh.creation.cylinder(radius=100, height=200, sections=180), bone),), Tissue("g"), "b")
    hand = Hand(scene, AXIS, FRONT, 5.0, PROBE)
    pose, words = place(hand, Hold(0, 0))
    assert words.startswith("in bone")
    assert hand.judge(pose).startswith("in bone")


def test_a_pose_in_the_air_is_off_the_body(hand: Hand) -> None:
    pose, _ = place(hand, Hold(0, 0))
    assert hand.judge(pose) == ""
    away = pose.copy()
    away[:3, 3] -= 60 * away[:3, 2]
    assert hand.judge(away).startswith("off the body")


def test_a_face_deep_in_the_body_does_not_lie_on_the_skin(hand: Hand) -> None:
    pose, _ = place(hand, Hold(0, 0))
    pose[:3, 3] += 30 * pose[:3, 2]
    assert hand.judge(pose).startswith("inside the body: the face is ")


def test_standard_planes_are_held_within_a_few_millimetres() -> None:
    scene, sites = fetal_abdomen(triangles=6000), fetal_sites()
    hand = Hand(scene, sites.axis, sites.front, 8.0, PROBE)
    for name, pose in fetal_planes().items():
        held, _ = place(hand, hand.hold_of(pose))
        off = pose[:3, 3] - held[:3, 3]
        np.testing.assert_allclose(held[:3, :3], pose[:3, :3], atol=1e-6, err_msg=name)
        assert np.linalg.norm(off) < 12, name
