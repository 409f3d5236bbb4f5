"""Poses on the skin of shapes whose surface is known, and on both kinds of scene."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from ablate.anatomy import Scene, SiteGrid, Structure, Tissue, fetal_abdomen, fetal_sites, load_scene, load_sites
from ablate.dataset import Dropped, place_probe, resample_grid
from ablate.ultrasound import ConvexProbe, Simulator, SimulatorSettings
from ablate.ultrasound.probe import face_points

SKIN, BONE = Tissue("skin"), Tissue("bone", impedance_mrayl=6.0)
GRID = SiteGrid((0, 0, 1), (0, -1, 0), (-20.0, 0.0, 20.0), (-40.0, 0.0, 40.0), (-15.0, 0.0, 15.0), (0.0, 90.0))
PROBE = ConvexProbe()


def scene(*structures: tuple[trimesh.Trimesh, Tissue], names: tuple[str, ...] = ()) -> Scene:
    for (mesh, _), name in zip(structures, names, strict=False):
        mesh.metadata["name"] = name
    return Scene(tuple(Structure(mesh, tissue) for mesh, tissue in structures), Tissue("gel"), "shapes")


def box(lower: tuple[float, ...], upper: tuple[float, ...]) -> trimesh.Trimesh:
    return trimesh.creation.box(bounds=(lower, upper))


def cylinder(radius: float) -> Scene:
    return scene((trimesh.creation.cylinder(radius=radius, height=200, sections=720), SKIN))


def dense_face(pose: np.ndarray) -> np.ndarray:
    """Points of the face in the image plane, in world coordinates."""
    angle = np.deg2rad(np.linspace(-35, 35, 701))
    arc = 40 * np.stack([np.sin(angle), 0 * angle, np.cos(angle) - 1], axis=-1)
    return arc @ pose[:3, :3].T + pose[:3, 3]


def test_poses_are_rigid_and_touch_the_skin() -> None:
    placed = place_probe(cylinder(100), GRID, press_mm=5)
    assert len(placed.poses) == 3 * 3 * 3 * 2
    assert len(set(placed.sites)) == 9
    for m in placed.poses:
        np.testing.assert_allclose(m[:3, :3].T @ m[:3, :3], np.eye(3), atol=1e-9)
        assert np.linalg.det(m[:3, :3]) == pytest.approx(1)
        assert (100 - np.linalg.norm(dense_face(m)[:, :2], axis=-1)).max() > 4  # it does not hover


def test_angles_turn_about_the_axis_and_the_probe_looks_inward() -> None:
    grid = SiteGrid((0, 0, 1), (0, -1, 0), (0.0,), (0.0, 90.0), (0.0,), (0.0,))
    front, side = place_probe(cylinder(100), grid, press_mm=5).poses
    np.testing.assert_allclose(front[:3, 3], [0, -95, 0], atol=0.1)
    np.testing.assert_allclose(front[:3, 2], [0, 1, 0], atol=0.01)
    np.testing.assert_allclose(front[:3, 0], np.cross(front[:3, 2], [0, 0, 1]), atol=0.01)  # x = z cross axis
    np.testing.assert_allclose(side[:3, 3], [95, 0, 0], atol=0.1)  # right hand about +z from -y is +x


def test_roll_turns_to_the_sagittal_plane_and_tilt_rocks_within_the_plane() -> None:
    grid = SiteGrid((0, 0, 1), (0, -1, 0), (0.0,), (0.0,), (0.0, 15.0), (0.0, 90.0))
    upright, sagittal, tilted, _ = place_probe(cylinder(100), grid, press_mm=0).poses
    assert abs(sagittal[:3, 0] @ [0, 0, 1]) == pytest.approx(1, abs=0.01)
    np.testing.assert_allclose(tilted[:3, 1], upright[:3, 1], atol=1e-9)
    assert tilted[:3, 2] @ upright[:3, 2] == pytest.approx(np.cos(np.deg2rad(15)))


def test_a_press_that_is_no_number_is_refused() -> None:
    grid = SiteGrid((0, 0, 1), (0, -1, 0), (0.0,), (0.0,), (0.0,), (0.0,))
    with pytest.raises(ValueError, match="press_mm=nan: allowed are finite numbers"):
        place_probe(cylinder(100), grid, press_mm=float("nan"))


@pytest.mark.parametrize(("tilt", "press_mm"), [(-20.0, 0.0), (0.0, 3.0), (15.0, 8.0)])
def test_on_a_flat_skin_the_arc_reaches_the_press_and_no_deeper(tilt: float, press_mm: float) -> None:
    """The lowest point of a rocked arc is that of its circle: its centre stays 40 mm - press above a flat skin."""
    slab = scene((box((-100, 0, -100), (100, 80, 100)), SKIN))
    grid = SiteGrid((0, 0, 1), (0, -1, 0), (0.0,), (0.0,), (tilt,), (0.0, 90.0))
    for m in place_probe(slab, grid, press_mm).poses:
        centre = m[:3, 3] - 40 * m[:3, 2]
        assert centre[1] == pytest.approx(press_mm - 40, abs=0.01)
        assert dense_face(m)[:, 1].max() == pytest.approx(press_mm, abs=0.01)


@pytest.mark.parametrize("radius", [60.0, 100.0])
def test_on_a_sphere_no_point_of_the_face_is_deeper_than_the_press(radius: float) -> None:
    ball = scene((trimesh.creation.icosphere(6, radius=radius), SKIN))
    grid = replace(GRID, heights_mm=(-20.0, 0.0, 20.0))
    upright = place_probe(ball, replace(grid, tilts_deg=(0.0,), rolls_deg=(0.0,)), press_mm=6)
    approaches = dict(zip(upright.sites, upright.poses[:, :3, 2], strict=True))
    placed = place_probe(ball, grid, press_mm=6)
    assert len(placed.poses) == 54
    for pose, site in zip(placed.poses, placed.sites, strict=True):
        face, approach = dense_face(pose), approaches[site]
        assert (radius - np.linalg.norm(face, axis=-1)).max() <= 6.05
        # Along the approach the skin of a ball lies sqrt(r^2 - u^2) from the plane through its middle.
        height = face @ -approach
        aside = np.linalg.norm(face + height[:, None] * approach, axis=-1)
        assert (np.sqrt(radius**2 - aside**2) - height).max() == pytest.approx(6, abs=0.05)


def test_over_a_groove_the_probe_rests_on_its_edges() -> None:
    """A gap of 2 x 5 mm between two blocks: the arc is lowest there, and sinks until an edge is `press` deep."""
    left, right = box((-80, 0, -80), (-5, 60, 80)), box((5, 0, -80), (80, 60, 80))
    floor = box((-80, 30, -80), (80, 60, 80))
    grid = SiteGrid((0, 0, 1), (0, -1, 0), (0.0,), (0.0,), (0.0,), (0.0,))
    (pose,) = place_probe(scene((left, SKIN), (right, SKIN), (floor, SKIN)), grid, press_mm=4).poses
    assert pose[1, 3] == pytest.approx(4 + 40 - np.sqrt(40**2 - 5**2), abs=0.12)
    face = dense_face(pose)
    assert face[np.abs(face[:, 0]) > 5][:, 1].max() <= 4 + 0.1  # the arc is looked at every 1.7 mm


def test_a_face_in_bone_is_dropped_and_counted() -> None:
    slab, plate = box((-100, 0, -100), (100, 80, 100)), box((-90, 5, -90), (90, 10, 90))
    grid = SiteGrid((0, 0, 1), (0, -1, 0), (0.0,), (-20.0, 0.0, 20.0), (0.0,), (0.0, 90.0))
    body = scene((slab, SKIN), (plate, BONE))
    assert place_probe(body, grid, press_mm=4.5).dropped[Dropped.hard] == 0
    with pytest.raises(ValueError, match=r"no probe pose can be used.*dropped 6: 6 the face lies in bone or gas"):
        place_probe(body, grid, press_mm=5.5)
    half = scene((slab, SKIN), (box((0, 5, -90), (90, 10, 90)), BONE))
    placed = place_probe(half, replace(grid, angles_deg=(-60.0, 60.0)), press_mm=6)  # +60 degrees is at x > 0
    assert placed.dropped[Dropped.hard] == 2
    assert (placed.poses[:, 0, 3] < 0).all()


def test_a_face_beyond_the_body_is_dropped_and_counted() -> None:
    """The cylinder ends at z = 100 mm: from 80 mm a sagittal face of +-22.9 mm reaches over, a transverse does not."""
    grid = SiteGrid((0, 0, 1), (0, -1, 0), (70.0, 80.0), (0.0,), (0.0,), (0.0, 90.0))
    placed = place_probe(cylinder(100), grid, press_mm=5)
    assert placed.dropped[Dropped.off_body] == 1
    assert len(placed.poses) == 3


def test_a_fan_that_misses_the_region_is_dropped_and_counted() -> None:
    """A ball of 5 mm in the axis 70 mm from the skin: a line at angle a from the site's normal passes it at
    (95 + 40) sin(a) mm from the middle, so of 32 lines over 70 degrees two or three meet it, fewer than a tenth;
    a ball of 12 mm is met by four or more.
    """

    def body(radius: float) -> Scene:
        skin = trimesh.creation.cylinder(radius=100, height=200, sections=720)
        return scene(
            (skin, SKIN),
            (trimesh.creation.icosphere(4, radius=radius), Tissue("organ")),
            names=("skin.obj", "organ.obj"),
        )

    grid = SiteGrid((0, 0, 1), (0, -1, 0), (0.0, 60.0), (0.0,), (0.0,), (0.0, 90.0), region=("organ.obj",))
    with pytest.raises(ValueError, match="4 the fan misses the region of interest"):
        place_probe(body(5), grid, press_mm=5)
    placed = place_probe(body(12), grid, press_mm=5)
    seen = [(m[2, 3], abs(m[2, 0]) > 0.5) for m in placed.poses]
    # 60 mm up the transverse plane passes the ball by; the sagittal fan meets it at atan(60 / 135) = 24 degrees.
    assert [(round(z), sagittal) for z, sagittal in seen] == [(0, False), (0, True), (60, True)]
    assert placed.dropped[Dropped.off_region] == 1
    assert "3 probe poses at 2 sites; dropped 1: 1 the fan misses the region of interest" in str(placed)
    with pytest.raises(ValueError, match=r"sites\.region: no structure 'lung'; known: skin\.obj, organ\.obj"):
        place_probe(body(12), replace(grid, region=("lung",)), press_mm=5)


def test_directions_that_miss_are_dropped_and_nothing_left_is_an_error() -> None:
    grid = SiteGrid((0, 0, 1), (0, -1, 0), (0.0, 500.0), (0.0,), (0.0, 5.0), (0.0,))
    placed = place_probe(cylinder(100), grid, 5)
    assert len(placed.poses) == 2
    assert placed.dropped[Dropped.no_skin] == 2
    beyond = SiteGrid((0, 0, 1), (0, -1, 0), (500.0,), (0.0,), (0.0,), (0.0,))
    with pytest.raises(ValueError, match=r"no probe pose can be used.*1 the direction misses the body"):
        place_probe(cylinder(100), beyond, 5)
    with pytest.raises(ValueError, match="no structure"):
        place_probe(Scene((), Tissue("gel"), "empty"), GRID, 5)


@pytest.mark.parametrize("where", ["fetal", "ircad11"])
def test_every_used_pose_of_a_scene_is_on_its_skin(where: str, request: pytest.FixtureRequest) -> None:
    """Seen by the simulator: gel above the middle of the face, body below the press, and no bone at the face."""
    if where == "fetal":
        body, grid = fetal_abdomen(triangles=20_000), fetal_sites()
    else:
        folder: Path = request.getfixturevalue("cases") / where
        body, grid = load_scene(folder), load_sites(folder)
    placed = place_probe(body, grid, press_mm=8)
    asked = len(grid.heights_mm) * len(grid.angles_deg) * len(grid.tilts_deg) * len(grid.rolls_deg)
    assert len(placed.poses) + sum(placed.dropped.values()) == asked
    assert len(placed.poses) > 0.9 * asked
    skin = body.structures[0].mesh
    on_skin = cKDTree(trimesh.sample.sample_surface(skin, 300_000, seed=0)[0])
    face = face_points(PROBE)
    settings = SimulatorSettings(image_shape=(80, 111), axial_samples=64, scanlines=16, rays=1, layers=1)
    simulator = Simulator(body, PROBE, settings)
    bone = [i + 1 for i, t in enumerate(body.tissues) if t.impedance_mrayl > 3]
    for m in placed.poses[:: len(placed.poses) // 12]:
        points = face @ m[:3, :3].T + m[:3, 3]
        inside = skin.contains(points)
        assert inside.any()
        assert on_skin.query(points[inside])[0].max() <= 8 + 1  # a millimetre or so between the samples
        labels, _ = simulator.maps(m)
        first = np.argmax(labels > 0, axis=0)
        top = labels[first, np.arange(labels.shape[1])][45:-45]  # above the face, not above the fan's edges
        assert not np.isin(top, bone).any()


def test_a_grid_is_resampled_over_its_own_ranges() -> None:
    fine = resample_grid(GRID, (13, 19, 9, 3))
    counts = [len(v) for v in (fine.heights_mm, fine.angles_deg, fine.tilts_deg, fine.rolls_deg)]
    assert counts == [13, 19, 9, 3]
    assert (fine.heights_mm[0], fine.heights_mm[-1]) == (-20, 20)
    assert 13 * 19 * 9 * 3 == 6669  # the paper's number of frames


@pytest.mark.parametrize("angles", [(340.0, 0.0, 20.0), (-20.0, 0.0, 20.0), (20.0, 0.0, -20.0)])
def test_angles_that_pass_zero_are_resampled_between_their_ends(angles: tuple[float, ...]) -> None:
    fine = resample_grid(replace(GRID, angles_deg=angles), (1, 5, 1, 1))
    assert [(angle + 180) % 360 - 180 for angle in fine.angles_deg] == [-20.0, -10.0, 0.0, 10.0, 20.0]


def test_no_place_comes_twice_in_a_grid() -> None:
    fine = resample_grid(SiteGrid(heights_mm=(5.0,), angles_deg=(-180.0, 90.0)), (3, 4, 2, 2))
    assert (fine.heights_mm, fine.tilts_deg, fine.rolls_deg) == ((5.0,), (0.0,), (0.0,))
    assert fine.angles_deg == (-180.0, -90.0, 0.0, 90.0)
    for again in ({"angles_deg": (-180.0, 0.0, 180.0)}, {"heights_mm": (0.0, 0.0)}, {"rolls_deg": (0.0, 360.0)}):
        with pytest.raises(ValueError, match="site grid: a height, angle, tilt or roll stands twice"):
            SiteGrid(**again)
