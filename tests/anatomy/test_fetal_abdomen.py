"""The built-in anatomy: biometry on the meshes, who lies in whom, and meshes fit for counting crossings."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

from ablate.anatomy import Scene, content_hash, fetal_abdomen, fetal_sites
from ablate.anatomy.closing import odd_edges
from ablate.anatomy.fetal_frame import abdomen_plane, curl, curled, head_plane, trunk
from ablate.anatomy.mother import cavity
from ablate.anatomy.walls import shared_walls

FETUS_FLESH = ("body and head", "left leg", "right leg", "left arm", "right arm")


@pytest.fixture(scope="module")
def scene() -> Scene:
    return fetal_abdomen(100_000)


def mesh_of(scene: Scene, name: str, occurrence: int = 0) -> trimesh.Trimesh:
    return [s.mesh for s in scene.structures if s.mesh.metadata["name"] == name][occurrence]


def section(mesh: trimesh.Trimesh, plane: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Segments (n, 2, 3) where a plane cuts a mesh."""
    return trimesh.intersections.mesh_plane(mesh, plane_normal=plane[1], plane_origin=plane[0])


def perimeter(segments: np.ndarray) -> float:
    return float(np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum())


def narrowest(segments: np.ndarray, normal: np.ndarray) -> float:
    """Smallest calliper width within the plane."""
    first = np.cross(normal, [0.3, 0.5, 0.8])
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    angle = np.linspace(0, math.pi, 180, endpoint=False)
    directions = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second
    return float(np.ptp(segments.reshape(-1, 3) @ directions.T, axis=0).min())


def test_bpd_and_hc(scene: Scene) -> None:
    outer = section(mesh_of(scene, "skull"), head_plane())
    assert narrowest(outer, head_plane()[1]) == pytest.approx(54.0, rel=0.03)
    assert perimeter(outer) == pytest.approx(200.0, rel=0.03)


def test_ac(scene: Scene) -> None:
    assert perimeter(section(mesh_of(scene, "body and head"), abdomen_plane())) == pytest.approx(175.0, rel=0.03)
    assert len(section(mesh_of(scene, "stomach"), abdomen_plane())) > 0  # at the level of the stomach


def test_fl(scene: Scene) -> None:
    vertices = mesh_of(scene, "femora").vertices
    for femur in np.split(vertices, 2):
        apart = np.linalg.norm(femur[:, None] - femur[None], axis=2)
        assert apart.max() == pytest.approx(39.0, rel=0.03)


def test_abdominal_wall_of_the_mother(scene: Scene) -> None:
    """Depths under the skin where a needle goes straight in beside the midline, at the navel."""
    depth = {}
    for name in ("skin", "subcutaneous fat", "abdominal wall", "abdominal cavity", "uterus", "amniotic cavity"):
        cut = section(mesh_of(scene, name), (np.array([30.0, 0, 0]), np.array([1.0, 0, 0])))
        near = cut.reshape(-1, 3)
        near = near[(np.abs(near[:, 2] - 5.0) < 12.0) & (near[:, 1] < 0)]
        depth[name] = near[:, 1].mean()
    thickness = -np.diff([-depth[name] for name in depth])
    assert thickness[0] == pytest.approx(2.0, abs=0.6)
    assert 13 < thickness[1] < 20
    assert 7 < thickness[2] < 14
    assert 5 < thickness[4] < 11
    body = mesh_of(scene, "skin").extents
    assert 290 < body[0] < 320
    assert 220 < body[1] < 260
    assert body[2] > 300


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_fetus_floats_in_the_fluid(seed: int) -> None:
    scene = fetal_abdomen(30_000, seed=seed)
    inner = cavity(seed)
    for name in FETUS_FLESH:
        assert inner(*mesh_of(scene, name).vertices.T).max() < 0.0, f"{name} touches the uterus"
    front = mesh_of(scene, "skin").vertices[:, 1].min()
    depth = np.concatenate([mesh_of(scene, name).vertices[:, 1] for name in FETUS_FLESH]) - front
    assert 40 < depth.min()
    assert depth.max() < 150


@pytest.mark.parametrize(
    ("inner", "outer"),
    [
        ("brain", "subarachnoid space"),
        ("subarachnoid space", "skull"),
        ("skull", "body and head"),
        ("heart chambers", "heart"),
        ("liver", "abdominal contents"),
        ("kidneys", "body and head"),
        ("ribs", "body and head"),
        ("lungs", "mediastinum"),
        ("ribs", "trunk muscles and diaphragm"),
        ("stomach", "stomach wall"),
        ("femora", None),
    ],
)
def test_parts_lie_in_their_wholes(scene: Scene, inner: str, outer: str | None) -> None:
    points = mesh_of(scene, inner).vertices[::7]
    if outer is None:
        inside = np.logical_or(*(mesh_of(scene, leg).contains(points) for leg in ("left leg", "right leg")))
        inside |= mesh_of(scene, "body and head").contains(points)
    else:
        inside = mesh_of(scene, outer).contains(points)
    assert inside.mean() > 0.98  # the rest is the corners that a coarse grid cuts


def test_twelve_pairs_of_ribs(scene: Scene) -> None:
    faces = mesh_of(scene, "ribs").faces
    pieces = trimesh.graph.connected_component_labels(mesh_of(scene, "ribs").face_adjacency, node_count=len(faces))
    assert pieces.max() + 1 == 24


@pytest.mark.parametrize("triangles", [4_000, 30_000, 300_000])
def test_meshes_are_fit_for_counting_crossings(triangles: int) -> None:
    scene = fetal_abdomen(triangles)
    for structure in scene.structures:
        name = structure.mesh.metadata["name"]
        assert len(odd_edges(structure.mesh.faces)) == 0, f"{name} is open"
        assert structure.mesh.volume > 0, f"{name} is inside out"
        assert np.isfinite(structure.mesh.vertices).all()
    assert shared_walls([structure.mesh for structure in scene.structures]) == []
    assert len(scene.structures) <= 64


@pytest.mark.parametrize("triangles", [50_000, 200_000])
def test_resolution_is_about_what_was_asked(triangles: int) -> None:
    count = sum(len(s.mesh.faces) for s in fetal_abdomen(triangles).structures)
    assert count == pytest.approx(triangles, rel=0.1)


def test_default_is_the_papers_size() -> None:
    structures = fetal_abdomen().structures
    count = [len(s.mesh.faces) for s in structures]
    cut = next(i for i, s in enumerate(structures) if s.mesh.metadata["name"] == "umbilical cord")
    assert sum(count) == pytest.approx(675_000, rel=0.05)
    assert sum(count[:cut]) == pytest.approx(275_000, rel=0.05)


def test_same_seed_same_scene_other_seed_another() -> None:
    assert content_hash(fetal_abdomen(4_000, seed=1)) == content_hash(fetal_abdomen(4_000, seed=1))
    assert content_hash(fetal_abdomen(4_000, seed=1)) != content_hash(fetal_abdomen(4_000, seed=2))


def test_too_few_triangles_are_refused() -> None:
    with pytest.raises(ValueError, match="triangles must be at least 4000, not 100"):
        fetal_abdomen(100)


def test_sites_look_at_the_fetus(scene: Scene) -> None:
    sites = fetal_sites()
    body = mesh_of(scene, "body and head").bounds
    assert body[0, 2] - 20 < min(sites.heights_mm)
    assert max(sites.heights_mm) < body[1, 2] + 20
    assert len(sites.heights_mm) * len(sites.angles_deg) >= 50
    assert sites.rolls_deg == (0.0, 90.0)


def test_curling_the_trunk_is_undone_by_its_field() -> None:
    points = np.random.default_rng(0).uniform((-25, -25, -60), (25, 25, 55), (500, 3))
    assert curled(trunk)(*curl(points).T) == pytest.approx(trunk(*points.T), abs=1e-3)
    slices = curl(np.array([(10.0, 5.0, 30.0), (-10.0, -5.0, 30.0)]))
    assert np.linalg.norm(slices[0] - slices[1]) == pytest.approx(math.hypot(20, 10))  # sections keep their shape
