"""Meshes that are not what a modeller would draw, but enclose the same: their image is the same."""

import numpy as np
import pytest
import trimesh

from ablate.anatomy import Scene, Structure, check_scene
from ablate.ultrasound import Simulator

BALL = trimesh.creation.icosphere(subdivisions=4, radius=40.0).apply_translation((3.0, 2.0, 60.0))
CORNERS = BALL.triangles.reshape(-1, 3)
SHAKEN = CORNERS + np.random.default_rng(0).uniform(-1e-5, 1e-5, CORNERS.shape)
ONE_EACH = np.arange(len(CORNERS)).reshape(-1, 3)
CUT = BALL.subdivide(face_index=np.arange(0, len(BALL.faces), 7))
SAME = {
    "inside out": (BALL.vertices, BALL.faces[:, ::-1]),
    "every triangle twice": (BALL.vertices, np.concatenate([BALL.faces, BALL.faces[:, ::-1]])),
    "some three times": (BALL.vertices, np.concatenate([BALL.faces, BALL.faces[:900], BALL.faces[:900]])),
    "vertices not shared": (CORNERS, ONE_EACH),
    "vertices nearly shared": (SHAKEN, ONE_EACH),
    "t-junctions": (CUT.vertices, CUT.faces),
}


@pytest.mark.parametrize("name", SAME)
def test_the_same_ball_has_the_same_labels(gel, tissue, probe, small, ahead, name: str) -> None:
    def labels(mesh: trimesh.Trimesh) -> np.ndarray:
        scene = Scene((Structure(mesh, tissue),), gel, "s")
        check_scene(scene, probe.depth_mm)
        return Simulator(scene, probe, small).maps(ahead)[0]

    odd = labels(trimesh.Trimesh(*SAME[name], process=False))
    np.testing.assert_array_equal(odd, labels(BALL))
