"""What a sonographer measures, counts and recognises in the fetus, on the meshes: BPD, HC, AC and FL, and its parts."""

import math
from itertools import pairwise

import numpy as np
import pytest
import trimesh

from ablate.anatomy.fetal.body import curl, curled, trunk
from ablate.anatomy.fetal.fetal_abdomen import abdomen_plane, fetal_planes, head_plane
from ablate.anatomy.fetal.pregnancy import draw_pregnancy
from ablate.anatomy.fetal.shapes import unit

SEEDS = [0, 1, 2, 3]
TRIANGLES = 30_000


def section(mesh: trimesh.Trimesh, plane: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Segments (n, 2, 3) where a plane cuts a mesh."""
    return trimesh.intersections.mesh_plane(mesh, plane_normal=plane[1], plane_origin=plane[0])


def perimeter(segments: np.ndarray) -> float:
    return float(np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum())


def narrowest(segments: np.ndarray, normal: np.ndarray) -> float:
    """Smallest calliper width within the plane."""
    first = unit(np.cross(normal, [0.3, 0.5, 0.8]))
    second = np.cross(normal, first)
    angle = np.linspace(0, math.pi, 180, endpoint=False)
    directions = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second
    return float(np.ptp(segments.reshape(-1, 3) @ directions.T, axis=0).min())


@pytest.mark.parametrize("seed", SEEDS)
def test_bpd_and_hc(built, mesh_of, seed: int) -> None:
    pregnancy = draw_pregnancy(seed)
    outer = section(mesh_of(built(TRIANGLES, seed), "skull"), head_plane(pregnancy))
    assert narrowest(outer, head_plane(pregnancy)[1]) == pytest.approx(54.0 * pregnancy.size, rel=0.03)
    assert perimeter(outer) == pytest.approx(200.0 * pregnancy.size, rel=0.03)


@pytest.mark.parametrize("seed", SEEDS)
def test_ac(built, mesh_of, seed: int) -> None:
    pregnancy, scene = draw_pregnancy(seed), built(TRIANGLES, seed)
    plane = abdomen_plane(pregnancy)
    assert perimeter(section(mesh_of(scene, "body and head"), plane)) == pytest.approx(175.0 * pregnancy.size, rel=0.03)
    for name in ("stomach", "umbilical vein", "liver", "fetal vertebral bodies"):  # what tells the level
        assert len(section(mesh_of(scene, name), plane)) > 0, name


@pytest.mark.parametrize("seed", SEEDS)
def test_fl(built, mesh_of, seed: int) -> None:
    for femur in np.split(mesh_of(built(TRIANGLES, seed), "femora").vertices, 2):
        apart = np.linalg.norm(femur[:, None] - femur[None], axis=2)
        assert apart.max() == pytest.approx(39.0 * draw_pregnancy(seed).size, rel=0.03)


def pieces(mesh: trimesh.Trimesh) -> list[np.ndarray]:
    """Vertices of each connected piece."""
    label = trimesh.graph.connected_component_labels(mesh.edges, node_count=len(mesh.vertices))
    return [mesh.vertices[label == i] for i in range(label.max() + 1)]


@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("ribs", 24),
        ("fetal vertebral bodies", 28),
        ("fetal vertebral arches", 56),
        ("femora", 2),
        ("heart chambers", 4),
        ("lungs", 2),
        ("kidneys", 2),
        ("eyes", 2),
        ("scapulae", 2),
        ("cord vessels", 3),
        ("umbilical arteries", 2),
        ("brain", 1),
        ("placenta", 1),
    ],
)
def test_pieces(scene, mesh_of, name: str, count: int) -> None:
    assert len(pieces(mesh_of(scene, name))) == count


def test_vertebrae_are_apart(scene, mesh_of) -> None:
    """Between two ossified centres there is a third of their height, or they cast one shadow."""
    spine = draw_pregnancy(0)
    heights = []
    for body in pieces(mesh_of(scene, "fetal vertebral bodies")):
        _, y, z = ((body - spine.origin) @ spine.rotation).T
        level = np.arctan2(z, y + 125.0) * 125.0
        heights.append((level.min(), level.max()))
    heights.sort()
    gaps = [above[0] - below[1] for below, above in pairwise(heights)]
    sizes = [top - bottom for bottom, top in heights]
    assert min(gaps) > 0.3 * np.median(sizes)


def test_two_arteries_are_thinner_than_the_vein_of_the_cord(scene, mesh_of) -> None:
    volumes = sorted(trimesh.Trimesh(p.vertices, p.faces).volume for p in mesh_of(scene, "cord vessels").split())
    assert volumes[1] == pytest.approx(volumes[0], rel=0.1)
    assert volumes[2] > 2.0 * volumes[1]


def test_ribs_follow_the_chest(scene, mesh_of) -> None:
    """Every rib lies at one depth under the skin along its way."""
    pregnancy = draw_pregnancy(0)
    points = (mesh_of(scene, "ribs").vertices - pregnancy.origin) @ pregnancy.rotation
    depth = -curled(trunk)(*points.T)
    assert np.percentile(depth, 2) > 2.5
    assert np.percentile(depth, 98) < 6.0


def test_left_is_left(scene, mesh_of) -> None:
    left = draw_pregnancy(0).rotation[:, 0]
    middle = mesh_of(scene, "fetal vertebral bodies").vertices.mean(axis=0) @ left
    for name, side in (("stomach", 1), ("heart", 1), ("liver", -1), ("gallbladder", -1), ("left leg", 1)):
        assert side * (mesh_of(scene, name).vertices.mean(axis=0) @ left - middle) > 1.0, name
    chambers = pieces(mesh_of(scene, "heart chambers"))
    assert sum(chamber.mean(axis=0) @ left > middle for chamber in chambers) >= 3  # the apex points to the left


@pytest.mark.parametrize("name", ["thalami", "falx", "cavum septi pellucidi", "lateral ventricles", "choroid plexus"])
def test_the_plane_of_the_bpd_shows(scene, mesh_of, name: str) -> None:
    assert len(section(mesh_of(scene, name), head_plane(draw_pregnancy(0)))) > 0


def test_the_four_chamber_plane_cuts_all_chambers_lungs_and_aorta(scene, mesh_of) -> None:
    pose = fetal_planes(0)["four_chambers"]
    others = [mesh_of(scene, name) for name in ("lungs", "ribs", "aorta and venae cavae")]
    for mesh in (*mesh_of(scene, "heart chambers").split(), *others):
        assert len(section(mesh, (pose[:3, 3], pose[:3, 1]))) > 0


def test_the_umbilical_vein_turns_to_the_right(scene, mesh_of) -> None:
    """A J in the plane of the abdominal circumference: straight back from the navel, then to the fetus's right."""
    pregnancy = draw_pregnancy(0)
    plane = abdomen_plane(pregnancy)
    cut = section(mesh_of(scene, "umbilical vein"), plane).reshape(-1, 3)
    x, y, _ = ((cut - plane[0]) @ pregnancy.rotation).T
    assert np.ptp(y) > 10.0
    assert x.min() < -8.0
    assert x.max() < 4.0
    assert y[x < -6.0].mean() > y[np.abs(x) < 2.0].mean()


def test_curling_the_trunk_is_undone_by_its_field() -> None:
    points = np.random.default_rng(0).uniform((-25, -25, -60), (25, 25, 55), (500, 3))
    assert curled(trunk)(*curl(points).T) == pytest.approx(trunk(*points.T), abs=1e-3)
    slices = curl(np.array([(10.0, 5.0, 30.0), (-10.0, -5.0, 30.0)]))
    assert np.linalg.norm(slices[0] - slices[1]) == pytest.approx(np.hypot(20, 10))  # sections keep their shape
