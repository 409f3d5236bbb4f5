"""What told pictures of the built-in anatomy from a patient's: muscles in groups, the heart, fascia, the femur."""

from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from ablate.anatomy import Scene, Structure, load_tissues
from ablate.anatomy.fetal.body import ABDOMEN_S_MM, curl, outline
from ablate.anatomy.fetal.heart import HEART_AXES, HEART_CENTER
from ablate.anatomy.fetal.pregnancy import draw_pregnancy
from ablate.ultrasound import ConvexProbe, Simulator, SimulatorSettings

Mesh = Callable[..., trimesh.Trimesh]


def around(s_mm: float, deep_mm: np.ndarray) -> np.ndarray:
    """Points of the straight trunk at a level, (120 angles, depths, 3)."""
    width, depth, middle = (float(part) for part in outline(np.array(s_mm)))
    angle = np.linspace(0.0, 2.0 * np.pi, 120, endpoint=False)[:, None]
    x, y = (width - deep_mm) * np.sin(angle), middle + (depth - deep_mm) * np.cos(angle)
    return np.stack([x, y, np.full_like(x, s_mm)], axis=-1)


@pytest.mark.parametrize(("s_mm", "contents"), [(ABDOMEN_S_MM, "abdominal contents"), (22.0, "mediastinum")])
def test_muscles_of_the_trunk_are_no_closed_ring(scene: Scene, mesh_of: Mesh, s_mm: float, contents: str) -> None:
    """They cover most of the circle and leave gaps, the widest of them in the midlines."""
    places = around(s_mm, np.arange(0.5, 9.0, 0.25))
    points = draw_pregnancy(0).to_world(curl(places.reshape(-1, 3)))
    muscle = mesh_of(scene, "trunk muscles and diaphragm").contains(points)
    muscle = (muscle & ~mesh_of(scene, contents).contains(points)).reshape(places.shape[:2])
    covered = muscle.sum(axis=1) >= 4  # a millimetre and more
    assert 0.5 < covered.mean() < 0.9
    assert not covered[0]  # behind
    assert not covered[60]  # in front


def test_muscles_of_the_thigh_are_groups(scene: Scene, mesh_of: Mesh) -> None:
    """On a circle around the middle of the femur, fat and fascia part three of them; there is none at the knee."""
    pregnancy = draw_pregnancy(0)
    leg = pregnancy.limbs.leg(1.0)
    along = (leg.bend - leg.root) / np.linalg.norm(leg.bend - leg.root)
    first = np.cross(along, (0.0, 0.0, 1.0))
    first /= np.linalg.norm(first)
    angle = np.linspace(0.0, 2.0 * np.pi, 360, endpoint=False)[:, None]
    circle = 5.5 * (np.cos(angle) * first + np.sin(angle) * np.cross(along, first))
    muscles = mesh_of(scene, "left leg muscles")
    points = pregnancy.to_world(0.55 * leg.root + 0.45 * leg.bend + circle)
    inside = muscles.contains(points) & ~mesh_of(scene, "septa of thighs and upper arms").contains(points)
    assert (inside & ~np.roll(inside, 1)).sum() == 3
    assert 0.6 < inside.mean() < 0.95
    assert not muscles.contains(pregnancy.to_world(leg.bend)[None])[0]


def test_the_heart_has_four_chambers_between_septa_and_flat_valves(scene: Scene, mesh_of: Mesh) -> None:
    """Atrium and ventricle are as near to each other beside the axis as on it; the right valve is nearer the apex."""
    pregnancy, chambers = draw_pregnancy(0), mesh_of(scene, "heart chambers")
    assert len(chambers.split()) == 4

    def gap(start: tuple[float, float, float], axis: int) -> np.ndarray:
        """First stretch without blood on the way along an axis of the heart, from and to, mm."""
        way = np.array(start) + np.linspace(0.0, 14.0, 700)[:, None] * np.eye(3)[axis]
        points = pregnancy.to_world(curl(HEART_CENTER + way @ HEART_AXES.T))
        blood = chambers.contains(points)
        leaves = int(np.argmin(blood))
        enters = leaves + int(np.argmax(blood[leaves:]))
        assert blood[0]
        return way[[leaves, enters], axis]

    left = np.array([gap((-8.0, 3.4 + u, v), 0) for u in (-1.5, 0.0, 1.5) for v in (-1.5, 0.0, 1.5)])
    right = np.array([gap((-8.0, -3.6 + u, v), 0) for u in (-1.5, 0.0, 1.5) for v in (-1.5, 0.0, 1.5)])
    for valve in (left, right):
        assert np.ptp(valve, axis=1).max() < 1.2
    assert 0.8 < right.mean() - left.mean() < 2.0
    between_atria, between_ventricles = gap((-7.0, -3.0, 0.0), 1), gap((1.0, -4.0, 0.0), 1)
    assert np.ptp(between_atria) < 1.2
    assert 1.3 < np.ptp(between_ventricles) < 3.0


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_fascia_lines_the_muscles_of_the_mother(built, seed: int) -> None:
    """Straight in beside the midline: fat, sheath, muscle, sheath; in the midline hardly more than the sheaths."""
    scene = built(100_000, seed)
    names = [structure.mesh.metadata["name"] for structure in scene.structures]
    wall = scene.structures[: names.index("abdominal cavity") + 1]
    wall += tuple(structure for structure in scene.structures if structure.tissue.name == "fascia")

    def layers(x: float) -> tuple[list[str], dict[str, float]]:
        y = np.arange(-140.0, -60.0, 0.1)
        points = np.stack([np.full_like(y, x), y, np.full_like(y, -30.0)], axis=1)
        tissue = np.full(len(y), "outside", dtype=object)
        for structure in wall:
            tissue[structure.mesh.contains(points)] = structure.tissue.name
        starts = np.flatnonzero(np.r_[True, tissue[1:] != tissue[:-1]])
        return list(tissue[starts]), {name: 0.1 * float((tissue == name).sum()) for name in ("fascia", "muscle")}

    order, beside_mm = layers(30.0)
    assert order == ["outside", "skin", "fat", "fascia", "muscle", "fascia", "soft_tissue"]
    assert 0.8 < beside_mm["fascia"] < 2.0
    _, middle_mm = layers(0.5)
    assert middle_mm["muscle"] < 0.2 * beside_mm["muscle"]
    assert middle_mm["fascia"] > 1.5


def test_the_far_side_of_the_femur_is_not_seen_and_its_shadow_is(scene: Scene, mesh_of: Mesh) -> None:
    """Across a thigh at 5 MHz: the far cortex is under the muscle before the bone, and what is behind it 12 dB down."""
    femur = mesh_of(scene, "femora").split()[0].copy()
    axes = np.linalg.svd(femur.vertices - femur.vertices.mean(axis=0), full_matrices=False)[2]
    femur.vertices = (femur.vertices - femur.vertices.mean(axis=0)) @ axes.T + (0.0, 0.0, 50.0)
    muscle, bone = (load_tissues()[name] for name in ("muscle", "fetal_bone"))
    settings = SimulatorSettings(scanlines=96, axial_samples=1500, image_shape=(64, 89))
    thigh = Scene((Structure(femur, bone),), muscle, "a femur in muscle")
    simulator = Simulator(thigh, ConvexProbe(frequency_mhz=5.0, depth_mm=100.0), settings)
    envelope = np.mean([simulator.render(np.eye(4), seed).envelope.astype(float) ** 2 for seed in range(4)], axis=0)
    depth = (np.arange(1500) + 0.5) / 15.0
    lines = envelope[:, 42:54]  # 3 mm to either side of the middle of its shaft
    half = np.ptp(femur.vertices[np.abs(femur.vertices[:, 0]) < 6.0, 2]) / 2.0

    def level_db(first: float, last: float, of: np.ndarray = lines) -> float:
        return float(10.0 * np.log10(of[(depth > first) & (depth < last)].mean()))

    def peak_db(at: float) -> float:
        return float(10.0 * np.log10(np.median(lines[np.abs(depth - at) < 1.0].max(axis=0))))

    near, far = peak_db(50.0 - half), peak_db(50.0 + half)
    assert far - near < -40.0
    assert far < level_db(40.0, 46.0) + 3.0
    aside = envelope[:, [2, 3, 4, 91, 92, 93]]
    assert level_db(56.0, 66.0) < level_db(56.0, 66.0, aside) - 12.0
