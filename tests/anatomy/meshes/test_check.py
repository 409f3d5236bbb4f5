"""What a simulator is told of a scene before it casts a ray: refused, warned of, or let pass."""

import pickle
from pathlib import Path

import numpy as np
import pytest
import trimesh

from ablate.anatomy import Scene, Structure, check_scene, load_scene, load_tissues
from ablate.anatomy.meshes.check import openings
from ablate.ultrasound import ConvexProbe, Simulator

TISSUES = load_tissues()
BALL = trimesh.creation.icosphere(subdivisions=3, radius=40.0)


def scene_of(vertices: np.ndarray, faces: np.ndarray) -> Scene:
    """A sound structure, and one of these vertices and faces."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    return Scene(
        (Structure(BALL.copy(), TISSUES["fat"]), Structure(mesh, TISSUES["liver"])), TISSUES["coupling_gel"], "s"
    )


def moved(index: int, value: float) -> np.ndarray:
    vertices = BALL.vertices.copy()
    vertices[index, 1] = value
    return vertices


def doubled_wall() -> tuple[np.ndarray, np.ndarray]:
    """Two boxes side by side, the wall between them twice: watertight, but a ray crosses the two walls as one."""
    box = trimesh.creation.box((10, 10, 10))
    other = box.vertices * (1, 1, -1) + (0, 0, 10)
    return np.concatenate([box.vertices, other]), np.concatenate([box.faces, box.faces + 8])


BELOW = BALL.faces[BALL.triangles_center[:, 2] < 20.0]
REFUSED = {
    "nothing": (BALL.vertices, np.empty((0, 3), int), "holds no triangles"),
    "far index": (BALL.vertices, np.array([(0, 1, 642)]), "vertices that are not among its 642"),
    "negative index": (BALL.vertices, np.array([(0, 1, -1)]), "vertices that are not among its 642"),
    "nan": (moved(7, np.nan), BALL.faces, "not finite or beyond 1.8e[+]18 mm"),
    "infinite": (moved(7, -np.inf), BALL.faces, "not finite"),
    "float32 overflows": (moved(7, 1e30), BALL.faces, "not finite or beyond"),
    "line": (np.diag([1.0, 2.0, 3.0]) @ np.ones((3, 3)), np.array([(0, 1, 2)]), "no triangle with an area"),
    "open": (BALL.vertices, BELOW, "not closed: .* open edges"),
    "open and doubled": (BALL.vertices, np.concatenate([BELOW, BELOW[:, ::-1]]), "not closed: .* open edges"),
    "doubled wall": (*doubled_wall(), "not closed: 4 open edges, the largest hole 1[0-4]"),
    "single triangle": (BALL.vertices, BALL.faces[:1], "not closed: 3 open edges"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_would_be_imaged_wrongly_is_refused_by_index_and_tissue(name: str) -> None:
    vertices, faces, message = REFUSED[name]
    with pytest.raises(ValueError, match=rf"^scene 's': structure 1 \(liver\) .*{message}") as caught:
        check_scene(scene_of(vertices, faces), 150.0)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("missing", [0, 1, 2, 5, 60])
@pytest.mark.parametrize("seed", range(4))
def test_closed_is_what_an_independent_library_calls_watertight(missing: int, seed: int) -> None:
    body = trimesh.util.concatenate([trimesh.creation.torus(30, 9), trimesh.creation.annulus(20, 30, 50)])
    faces = np.random.default_rng(seed).permutation(body.faces)[missing:]
    watertight = trimesh.Trimesh(body.vertices, faces, process=False).is_watertight
    assert watertight == (missing == 0) == (openings(body.vertices, faces)[0] == 0)


def test_holes_are_measured() -> None:
    tube = trimesh.creation.cylinder(radius=6.0, height=20.0, sections=32)
    end = np.isclose(tube.face_normals[:, 2], 1.0)
    edges, width_mm = openings(tube.vertices, tube.faces[~end])
    assert edges == 32
    assert width_mm == pytest.approx(12.0)
    two = trimesh.Trimesh(tube.vertices, tube.faces[~np.isclose(np.abs(tube.face_normals[:, 2]), 1.0)], process=False)
    assert openings(two.vertices, two.faces) == (64, pytest.approx(12.0))
    assert openings(tube.vertices, tube.faces) == (0, 0.0)


@pytest.mark.parametrize(("scale", "size"), [(1e-3, "0.08 mm"), (1e3, "8e[+]04 mm"), (40.0, "3.2e[+]03 mm")])
def test_a_scene_of_no_body_s_size_is_warned_of(scale: float, size: str) -> None:
    scene = scene_of(BALL.vertices, BALL.faces)
    for structure in scene.structures:
        structure.mesh.apply_scale(scale)
    with pytest.warns(UserWarning, match=rf"'s': its largest extent is {size} and the probe images 150 mm deep"):
        check_scene(scene, 150.0)
    check_scene(scene, 150.0 * scale)  # scaled together with its probe


def test_scenes_as_they_come_and_a_point_target_pass(built) -> None:
    point = Structure(BALL.copy().apply_scale(1e-3), TISSUES["liver"])
    for scene in (Scene((), TISSUES["liver"], "empty"), Scene((point,), TISSUES["coupling_gel"], "s"), built(4_000, 0)):
        check_scene(scene, 150.0)  # a warning is an error


def test_a_repaired_patient_passes(cases: Path) -> None:
    check_scene(load_scene(cases / "ircad11"), 150.0)


def test_a_simulator_tells_once_a_scene_of_walls_that_coincide(caplog: pytest.LogCaptureFixture) -> None:
    below, above = (trimesh.creation.box((80, 80, 40)).apply_translation((0, 0, z)) for z in (20, 60))
    touching = Scene((Structure(below, TISSUES["fat"]), Structure(above, TISSUES["liver"])), TISSUES["blood"], "boxes")
    for _ in range(2):
        Simulator(pickle.loads(pickle.dumps(touching)) if caplog.records else touching)
        (told,) = (record.getMessage() for record in caplog.records)
        assert told.startswith("structure 0 and structure 1 share a wall (at 63 of 256 points)")  # a quarter of a box
    caplog.clear()
    above.apply_scale((0.9, 0.9, 1.0)).apply_translation((0, 0, -1))
    overlapping = Scene(touching.structures, touching.background, "boxes")
    Simulator(overlapping, ConvexProbe())
    assert overlapping.looked_at
    assert not caplog.records


def test_what_trimesh_computes_for_the_checks_does_not_stay() -> None:
    """It is several times as large as the mesh, and decided how many triangles fit into memory."""
    scene = scene_of(BALL.vertices, BALL.faces)
    Simulator(scene, ConvexProbe())
    for structure in scene.structures:
        kept = sum(getattr(value, "nbytes", 0) for value in structure.mesh._cache.cache.values())
        assert kept < structure.mesh.vertices.nbytes
