"""The probe's poses in the standard planes: on the skin, looking at what they are named for."""

import numpy as np
import pytest
import trimesh

from ablate.anatomy import fetal_planes
from ablate.anatomy.fetal.fetal_abdomen import abdomen_plane, head_plane
from ablate.anatomy.fetal.mother import torso
from ablate.anatomy.fetal.pregnancy import draw_pregnancy

SEEDS = [0, 1, 2, 3]
SHOWN = {
    "head": "skull",
    "abdomen": "stomach",
    "four_chambers": "heart chambers",
    "femur": "femora",
    "spine": "fetal vertebral bodies",
    "placenta": "placenta",
}


@pytest.mark.parametrize("seed", SEEDS)
def test_poses_are_rigid_and_on_the_skin(seed: int) -> None:
    poses = fetal_planes(seed, press_mm=6.0)
    assert list(poses) == list(SHOWN)
    for name, pose in poses.items():
        assert pose[:3, :3] @ pose[:3, :3].T == pytest.approx(np.eye(3)), name
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
        assert -6.5 < torso(*pose[:3, 3]) < -3.5, name  # pressed in, along a beam that may be oblique
        outside = pose[:3, 3] - 12.0 * pose[:3, 2]
        assert torso(*outside) > 0, name
        assert pose[:3, 0] @ (1.0, 0.0, -1.0) >= 0, f"{name}: mirrored"


@pytest.mark.parametrize("seed", SEEDS)
def test_what_is_named_lies_in_the_image(built, mesh_of, seed: int) -> None:
    scene = built(30_000, seed)
    for name, pose in fetal_planes(seed).items():
        cut = trimesh.intersections.mesh_plane(mesh_of(scene, SHOWN[name]), pose[:3, 1], pose[:3, 3]).reshape(-1, 3)
        x, _, z = ((cut - pose[:3, 3]) @ pose[:3, :3]).T
        in_fan = (np.hypot(x, z + 40.0) < 190.0) & (np.abs(np.arctan2(x, z + 40.0)) < np.deg2rad(35.0)) & (z > 0)
        assert in_fan.mean() > (0.3 if name in ("placenta", "spine") else 0.6), name


@pytest.mark.parametrize("seed", SEEDS)
def test_head_and_abdomen_are_cut_as_they_are_measured(seed: int) -> None:
    poses, pregnancy = fetal_planes(seed), draw_pregnancy(seed)
    for name, (point, normal) in {"head": head_plane(pregnancy), "abdomen": abdomen_plane(pregnancy)}.items():
        pose = poses[name]
        assert abs(pose[:3, 1] @ normal) > np.cos(np.deg2rad(10.0)), name
        assert np.linalg.inv(pose)[:3] @ [*point, 1.0] == pytest.approx([0.0, 0.0, np.linalg.norm(point - pose[:3, 3])])


def test_the_textbook_case_is_seen_in_every_plane() -> None:
    poses, pregnancy = fetal_planes(0), draw_pregnancy(0)
    left, back, _ = pregnancy.rotation.T
    assert abs(poses["head"][:3, 2] @ left) > np.cos(np.deg2rad(20))  # the midline lies across the beam
    assert abs(poses["spine"][:3, 2] @ back) > np.cos(np.deg2rad(10))
    assert abs(poses["spine"][:3, 1] @ left) > np.cos(np.deg2rad(3))
    thighs = [pregnancy.rotation @ (limb.bend - limb.root) / 46.0 for limb in map(pregnancy.limbs.leg, (1.0, -1.0))]
    _, across, beam = poses["femur"][:3, :3].T
    assert max(np.linalg.norm(thigh - across * (thigh @ across)) for thigh in thighs) > 0.999
    assert min(abs(thigh @ beam) for thigh in thighs) < np.sin(np.deg2rad(25))
