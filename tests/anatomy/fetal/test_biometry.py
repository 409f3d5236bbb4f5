"""Biometry, measured on the meshes as a sonographer would: BPD, HC, AC and FL, for pregnancies of several sizes."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from ablate.anatomy import Scene
from ablate.anatomy.fetal.fetal_abdomen import abdomen_plane, head_plane
from ablate.anatomy.fetal.pregnancy import draw_pregnancy

Built = Callable[[int, int], Scene]
MeshOf = Callable[..., trimesh.Trimesh]
SEEDS = [0, 1, 2, 3]
TRIANGLES = 30_000


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


@pytest.mark.parametrize("seed", SEEDS)
def test_bpd_and_hc(built: Built, mesh_of: MeshOf, seed: int) -> None:
    pregnancy = draw_pregnancy(seed)
    outer = section(mesh_of(built(TRIANGLES, seed), "skull"), head_plane(pregnancy))
    assert narrowest(outer, head_plane(pregnancy)[1]) == pytest.approx(54.0 * pregnancy.size, rel=0.03)
    assert perimeter(outer) == pytest.approx(200.0 * pregnancy.size, rel=0.03)


@pytest.mark.parametrize("seed", SEEDS)
def test_ac(built: Built, mesh_of: MeshOf, seed: int) -> None:
    pregnancy, scene = draw_pregnancy(seed), built(TRIANGLES, seed)
    plane = abdomen_plane(pregnancy)
    assert perimeter(section(mesh_of(scene, "body and head"), plane)) == pytest.approx(175.0 * pregnancy.size, rel=0.03)
    for name in ("stomach", "umbilical vein", "liver", "fetal vertebral bodies"):  # what tells the level
        assert len(section(mesh_of(scene, name), plane)) > 0, name


@pytest.mark.parametrize("seed", SEEDS)
def test_fl(built: Built, mesh_of: MeshOf, seed: int) -> None:
    for femur in np.split(mesh_of(built(TRIANGLES, seed), "femora").vertices, 2):
        apart = np.linalg.norm(femur[:, None] - femur[None], axis=2)
        assert apart.max() == pytest.approx(39.0 * draw_pregnancy(seed).size, rel=0.03)


def test_sizes_differ_and_the_first_is_the_table() -> None:
    sizes = [draw_pregnancy(seed).size for seed in range(6)]
    assert sizes[0] == 1.0
    assert len(set(sizes)) == len(sizes)
    assert all(0.85 < size < 1.11 for size in sizes)
