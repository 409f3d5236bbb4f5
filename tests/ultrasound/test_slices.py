"""Labels against geometry, and whether the probe can see the scene at all, told from labels."""

import math

import numpy as np
import pytest
import trimesh

from ablate.anatomy import Scene, Structure, Tissue, check_scene, load_tissues
from ablate.ultrasound import ConvexProbe, Simulator, SimulatorSettings
from ablate.ultrasound.probe import pixel_coordinates_mm
from ablate.ultrasound.surfaces.slices import beside, contact_warning

PAPER_SIZE = SimulatorSettings()
BALL = trimesh.creation.icosphere(subdivisions=4, radius=40.0).apply_translation((3.0, 2.0, 60.0))
CORNERS = BALL.triangles.reshape(-1, 3)
SHAKEN = CORNERS + np.random.default_rng(0).uniform(-1e-5, 1e-5, CORNERS.shape)
ONE_EACH = np.arange(len(CORNERS)).reshape(-1, 3)
CUT = BALL.subdivide(face_index=np.arange(0, len(BALL.faces), 7))
UNUSED = np.concatenate([BALL.vertices, [(np.nan,) * 3]])
#: Meshes that are not what a modeller would draw, but enclose the same.
SAME = {
    "inside out": (BALL.vertices, BALL.faces[:, ::-1]),
    "every triangle twice": (BALL.vertices, np.concatenate([BALL.faces, BALL.faces[:, ::-1]])),
    "some three times": (BALL.vertices, np.concatenate([BALL.faces, BALL.faces[:900], BALL.faces[:900]])),
    "degenerate ones too": (BALL.vertices, np.concatenate([BALL.faces, [(3, 3, 9), (5, 5, 5)]])),
    "unused vertex": (UNUSED, BALL.faces),
    "zeros of both signs": (np.where(BALL.vertices == 0, -0.0, BALL.vertices), BALL.faces),
    "vertices not shared": (CORNERS, ONE_EACH),
    "vertices nearly shared": (SHAKEN, ONE_EACH),
    "t-junctions": (CUT.vertices, CUT.faces),
}


def segment(scene: Scene, probe: ConvexProbe, settings: SimulatorSettings, pose: np.ndarray) -> np.ndarray:
    return Simulator(scene, probe, settings).maps(pose)[0]


def grid(probe: ConvexProbe, settings: SimulatorSettings) -> tuple[np.ndarray, np.ndarray]:
    x, z = pixel_coordinates_mm(probe, settings.image_shape)
    return np.meshgrid(x, z)


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


TABLE = load_tissues()
GEL = TABLE["coupling_gel"]
SAMPLES = 3072


def lines(*layers: tuple[int, float], scanlines: int = 192, depth_mm: float = 150.0) -> np.ndarray:
    """Labels of scanlines that all meet the same layers: (label, thickness in mm); the last goes on for ever."""
    depth = (np.arange(SAMPLES) + 0.5) * depth_mm / SAMPLES
    ends = np.cumsum([thickness for _, thickness in layers[:-1]])
    row = np.array([label for label, _ in layers], np.uint8)[np.searchsorted(ends, depth)]
    return np.tile(row, (scanlines, 1))


@pytest.mark.parametrize("frequency_mhz", [3.0, 8.0])
def test_a_probe_in_bone_or_gas_is_warned_of_and_in_nothing_else(frequency_mhz: float) -> None:
    probe, labels = ConvexProbe(frequency_mhz=frequency_mhz), lines((1, 150.0))
    warnings = {name: contact_warning(labels, (Tissue("water"), tissue), probe) for name, tissue in TABLE.items()}
    assert {name for name in TABLE if warnings[name] is not None} == {"bone", "fetal_bone", "gas"}
    for name in ("bone", "fetal_bone", "gas"):
        assert f"most scanlines start in {name}," in warnings[name]
        assert "\n" not in warnings[name]


@pytest.mark.parametrize(("impedance", "attenuation"), [(1.5, 7.0), (6.0, 7.0), (6.0, 4.0), (0.05, 1.0)])
def test_the_line_is_drawn_where_40_db_are_lost_there_and_back(impedance: float, attenuation: float) -> None:
    reflected = ((impedance - 1.5) / (impedance + 1.5)) ** 2
    face_db = -20 * math.log10(1 - reflected)
    critical_mm = 10 * (40.0 - face_db) / (2 * attenuation * 8.0)
    plate = Tissue("plate", impedance_mrayl=impedance, attenuation_db_cm_mhz=attenuation)
    for share, warned in ((0.97, False), (1.03, True)):
        labels = lines((1, share * critical_mm), (2, 150.0))
        warning = contact_warning(labels, (GEL, plate, TABLE["liver"]), ConvexProbe(frequency_mhz=8.0))
        assert (warning is not None) == warned


def test_what_lies_behind_a_rib_or_within_half_of_the_face_is_no_matter() -> None:
    tissues = (GEL, TABLE["skin"], TABLE["bone"])
    assert contact_warning(lines((1, 4.0), (2, 150.0)), tissues, ConvexProbe()) is None
    labels = lines((2, 150.0))
    everywhere = contact_warning(labels, tissues, ConvexProbe())
    labels[:96] = lines((1, 150.0), scanlines=96)
    assert contact_warning(labels, tissues, ConvexProbe()) is None
    labels[95] = 2
    assert contact_warning(labels, tissues, ConvexProbe()) == everywhere is not None  # one warning for all such poses


def test_a_probe_that_looks_past_the_scene_is_warned_of() -> None:
    labels = lines((0, 150.0))
    words = contact_warning(labels, (GEL, TABLE["liver"]), ConvexProbe())
    assert words == "no scanline meets anything but coupling_gel, the background: the probe looks past the scene"
    for tissues in ((GEL,), (TABLE["liver"], TABLE["bile"])):  # no other tissue, or one that scatters
        assert contact_warning(labels, tissues, ConvexProbe()) is None
    labels[50, -1] = 1
    assert contact_warning(labels, (GEL, TABLE["liver"]), ConvexProbe()) is None


@pytest.mark.parametrize("samples", [1, 9])
def test_too_few_samples_tell_nothing(samples: int) -> None:
    labels = np.ones((4, samples), np.uint8)
    assert contact_warning(labels, (GEL, TABLE["bone"]), ConvexProbe()) is None
