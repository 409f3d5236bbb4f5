"""Labels against geometry."""

import numpy as np
import pytest
import trimesh

from ablate.anatomy import Scene, Structure, Tissue, check_scene
from ablate.ultrasound import ConvexProbe, Simulator, SimulatorSettings
from ablate.ultrasound.probe import fan_size_mm, pixel_coordinates_mm
from ablate.ultrasound.surfaces.slices import beside

PAPER_SIZE = SimulatorSettings()
BALL = trimesh.creation.icosphere(subdivisions=4, radius=40.0).apply_translation((3.0, 2.0, 60.0))
CORNERS = BALL.triangles.reshape(-1, 3)
SHAKEN = CORNERS + np.random.default_rng(0).uniform(-1e-5, 1e-5, CORNERS.shape)
ONE_EACH = np.arange(len(CORNERS)).reshape(-1, 3)
CUT = BALL.subdivide(face_index=np.arange(0, len(BALL.faces), 7))
#: Meshes that are not what a modeller would draw, but enclose the same.
SAME = {
    "inside out": (BALL.vertices, BALL.faces[:, ::-1]),
    "every triangle twice": (BALL.vertices, np.concatenate([BALL.faces, BALL.faces[:, ::-1]])),
    "some three times": (BALL.vertices, np.concatenate([BALL.faces, BALL.faces[:900], BALL.faces[:900]])),
    "vertices not shared": (CORNERS, ONE_EACH),
    "vertices nearly shared": (SHAKEN, ONE_EACH),
    "t-junctions": (CUT.vertices, CUT.faces),
}


def segment(scene: Scene, probe: ConvexProbe, settings: SimulatorSettings, pose: np.ndarray) -> np.ndarray:
    return Simulator(scene, probe, settings).maps(pose)[0]


def grid(probe: ConvexProbe, settings: SimulatorSettings) -> tuple[np.ndarray, np.ndarray]:
    x, z = pixel_coordinates_mm(probe, settings.image_shape)
    return np.meshgrid(x, z)


def test_the_papers_image_size_follows_from_its_probe() -> None:
    height, width = fan_size_mm(ConvexProbe())
    assert (height, width) == (pytest.approx(157.234, abs=1e-3), pytest.approx(217.959, abs=1e-3))
    _, z = pixel_coordinates_mm(ConvexProbe(), (1000, 1386))
    assert z[0] - height / 2000 == pytest.approx(-7.234, abs=1e-3)


def test_a_sphere_is_a_disc(gel, tissue, ball, probe, ahead) -> None:
    """Every pixel farther in than the nearest facet's plane, and none outside the sphere that holds the vertices."""
    structure = ball(tissue, (5.0, 3.0, 80.0), 25.0)
    labels = segment(Scene((structure,), gel, "s"), probe, PAPER_SIZE, ahead)
    x, z = grid(probe, PAPER_SIZE)
    distance = np.sqrt((x - 5) ** 2 + 3**2 + (z - 80) ** 2)
    a, b, c = structure.mesh.triangles.transpose(1, 0, 2) - (5.0, 3.0, 80.0)
    normal = np.cross(b - a, c - a)
    nearest = (np.abs((normal * a).sum(axis=1)) / np.linalg.norm(normal, axis=1)).min()
    assert 25 - nearest < 0.01
    assert (labels[distance < nearest] == 2).all()
    assert (labels[(distance > 25) & (labels > 0)] == 1).all()


@pytest.mark.parametrize("seed", range(4))
def test_a_box_is_exact_to_the_pixel(gel, tissue, probe, seed) -> None:
    """Six tilted planes, seen from anywhere, against the box's own coordinates of each pixel's centre."""
    random = np.random.default_rng(seed)
    pose, place = (trimesh.transformations.random_rotation_matrix(random.random(3)) for _ in range(2))
    pose[:3, 3], place[:3, 3] = random.uniform(-500, 500, 3), random.uniform((-30, -5, 40), (30, 5, 110))
    size = random.uniform(20, 80, 3)
    box = trimesh.creation.box(size).apply_transform(pose @ place)
    labels = segment(Scene((Structure(box, tissue),), gel, "s"), probe, PAPER_SIZE, pose)
    x, z = grid(probe, PAPER_SIZE)
    inside = (size / 2 - np.abs((np.stack([x, 0 * x, z], axis=-1) - place[:3, 3]) @ place[:3, :3])).min(axis=-1)
    certain = (labels > 0) & (np.abs(inside) > 1e-4)  # rays are float32
    assert ((labels == 2) == (inside > 0))[certain].all()
    assert (inside[certain] > 0).sum() > 10_000
    assert (labels > 0).sum() - certain.sum() < 20


def test_the_later_structure_owns_the_point(gel, tissue, ball, probe, small, ahead) -> None:
    other = Tissue("other")
    big, little = ball(tissue, (0, 0, 70.0), 30.0), ball(other, (0, 0, 75.0), 10.0)
    x, z = grid(probe, small)
    core = np.hypot(x, z - 75) < 9.9
    assert (segment(Scene((big, little), gel, "s"), probe, small, ahead)[core] == 3).all()
    hidden = segment(Scene((little, big), gel, "s"), probe, small, ahead)
    assert (hidden[core] == 3).all()  # big's tissue now comes second
    assert 2 not in hidden


def test_a_probe_inside_the_body_knows_where_it_is(gel, tissue, slab, ball, probe, small, ahead) -> None:
    body, cyst = slab(tissue, -100.0, 300.0), ball(gel, (0, 0, 30.0), 38.0)
    labels = segment(Scene((body, cyst), gel, "s"), probe, small, ahead)
    x, z = grid(probe, small)
    fan = labels > 0
    assert (labels[fan & (np.hypot(x, z - 30) > 38)] == 2).all()
    assert (labels[fan & (np.hypot(x, z - 30) < 37.9)] == 1).all()


def test_a_line_is_moved_off_itself_whatever_its_direction() -> None:
    """Also where its coordinates are equal, so that turning them round gives the same line."""
    diagonals = np.array([[1, 1, 1], [-1, -1, -1], [1.01, 1, 0.99]]) / np.sqrt(3)
    directions = np.concatenate([np.eye(3), diagonals, np.random.default_rng(0).normal(size=(200, 3))])
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    moved = beside(directions)
    assert (np.linalg.norm(np.cross(moved, directions), axis=-1) > 0.4).all()


@pytest.mark.parametrize("name", SAME)
def test_the_same_ball_has_the_same_labels(gel, tissue, probe, small, ahead, name: str) -> None:
    def labels(mesh: trimesh.Trimesh) -> np.ndarray:
        scene = Scene((Structure(mesh, tissue),), gel, "s")
        check_scene(scene, probe.depth_mm)
        return Simulator(scene, probe, small).maps(ahead)[0]

    odd = labels(trimesh.Trimesh(*SAME[name], process=False))
    np.testing.assert_array_equal(odd, labels(BALL))
