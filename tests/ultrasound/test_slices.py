"""Labels against geometry."""

import numpy as np
import pytest
import trimesh

from ablate.anatomy import Scene, Structure, Tissue
from ablate.ultrasound import ConvexProbe, Simulator, SimulatorSettings, fan_mask
from ablate.ultrasound.probe import fan_size_mm, pixel_coordinates_mm


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


def test_the_mask_is_the_fan(empty, probe, small, ahead) -> None:
    labels = segment(empty, probe, small, ahead)
    x, z = grid(probe, small)
    r, angle = np.hypot(x, z + 40), np.degrees(np.arctan2(x, z + 40))
    inside = (r >= 40) & (r <= 190) & (np.abs(angle) <= 35)
    assert ((labels > 0) == inside).all()
    assert (fan_mask(probe, small.image_shape) == inside).all()
    assert set(np.unique(labels)) == {0, 1}


def test_a_sphere_is_a_disc(gel, tissue, ball, probe, small, ahead) -> None:
    labels = segment(Scene((ball(tissue, (5.0, 3.0, 80.0), 25.0),), gel, "s"), probe, small, ahead)
    x, z = grid(probe, small)
    distance = np.hypot(x - 5, z - 80)
    cut = np.sqrt(25.0**2 - 3.0**2)
    assert (labels[distance < cut - 0.05] == 2).all()
    assert (labels[(distance > cut) & (labels > 0)] == 1).all()


def test_a_slab_begins_and_ends_at_the_pixel(gel, tissue, slab, probe, small, ahead) -> None:
    labels = segment(Scene((slab(tissue, 40.0, 70.5),), gel, "s"), probe, small, ahead)
    _, z = grid(probe, small)
    assert ((labels == 2) == ((z >= 40.0) & (z <= 70.5) & (labels > 0))).all()


def test_the_later_structure_owns_the_point(gel, tissue, ball, probe, small, ahead) -> None:
    other = Tissue("other")
    big, little = ball(tissue, (0, 0, 70.0), 30.0), ball(other, (0, 0, 75.0), 10.0)
    x, z = grid(probe, small)
    core = np.hypot(x, z - 75) < 9.9
    assert (segment(Scene((big, little), gel, "s"), probe, small, ahead)[core] == 3).all()
    hidden = segment(Scene((little, big), gel, "s"), probe, small, ahead)
    assert (hidden[core] == 3).all()  # big's tissue now comes second
    assert 2 not in hidden


def test_winding_does_not_matter(gel, tissue, ball, probe, small, ahead) -> None:
    right = ball(tissue, (5.0, 3.0, 80.0), 25.0)
    wrong = Structure(trimesh.Trimesh(right.mesh.vertices, right.mesh.faces[:, ::-1], process=False), tissue)
    a, b = (segment(Scene((s,), gel, "s"), probe, small, ahead) for s in (right, wrong))
    assert (a == b).all()


def test_more_than_32_structures(gel, ball, probe, small, ahead) -> None:
    shells = tuple(ball(Tissue(f"t{i}"), (0, 0, 75.0), 60.0 - i) for i in range(40))
    labels = segment(Scene(shells, gel, "s"), probe, small, ahead)
    x, z = grid(probe, small)
    distance = np.hypot(x, z - 75)
    expected = np.clip(np.floor(61 - distance), 0, 40).astype(int) + 1
    clear = (np.abs(distance - np.rint(distance)) > 0.1) & (labels > 0)
    assert (labels[clear] == expected[clear]).all()


def test_a_probe_inside_the_body_knows_where_it_is(gel, tissue, slab, ball, probe, small, ahead) -> None:
    body, cyst = slab(tissue, -100.0, 300.0), ball(gel, (0, 0, 30.0), 38.0)
    labels = segment(Scene((body, cyst), gel, "s"), probe, small, ahead)
    x, z = grid(probe, small)
    fan = labels > 0
    assert (labels[fan & (np.hypot(x, z - 30) > 38)] == 2).all()
    assert (labels[fan & (np.hypot(x, z - 30) < 37.9)] == 1).all()


def test_a_turned_and_moved_probe_sees_the_same(gel, tissue, ball, probe, small, ahead) -> None:
    scene = Scene((ball(tissue, (5.0, 3.0, 80.0), 25.0),), gel, "s")
    pose = trimesh.transformations.random_rotation_matrix(np.array([0.3, 0.6, 0.2]))
    pose[:3, 3] = (300.0, -4000.0, 12.0)
    moved = Structure(scene.structures[0].mesh.copy().apply_transform(pose), tissue)
    a = segment(scene, probe, small, ahead)
    b = segment(Scene((moved,), gel, "s"), probe, small, pose)
    assert (a != b).mean() < 1e-4
