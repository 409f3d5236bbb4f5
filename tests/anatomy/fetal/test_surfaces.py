"""Meshes of the built-in anatomy are fit for counting crossings: closed, outward, and nowhere twice around a point."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from ablate.anatomy.meshes.check import shared_walls
from ablate.anatomy.meshes.repair import odd_edges

CASES = [
    (4_000, 0),
    (4_000, 4),
    (30_000, 1),
    (30_000, 2),
    (30_000, 3),
    pytest.param(300_000, 0, marks=pytest.mark.slow),
]


def nesting(mesh: trimesh.Trimesh, rays: int) -> np.ndarray:
    """How often a surface is entered and not yet left, after each crossing of rays through it, (n,) int.

    Rays go through the middles of random triangles; the surface's sense is that of its winding.
    """
    generator = np.random.default_rng(0)
    corners = Rotation.random(random_state=1).apply(mesh.vertices)[mesh.faces]
    aimed = corners[generator.integers(len(corners), size=rays)].mean(axis=1)[:, :2]
    low, high = corners[..., :2].min(axis=1), corners[..., :2].max(axis=1)
    ray, face = np.nonzero(((aimed[:, None] >= low) & (aimed[:, None] <= high)).all(axis=2))
    a, b, c = (corners[face, i] for i in range(3))
    p = aimed[ray]

    def doubled_area(u: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        return (v[:, 0] - u[:, 0]) * (w[:, 1] - u[:, 1]) - (v[:, 1] - u[:, 1]) * (w[:, 0] - u[:, 0])

    whole = doubled_area(a, b, c)
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.stack([doubled_area(p, b, c), doubled_area(a, p, c), doubled_area(a, b, p)]) / whole
    hit = (shares > 0).all(axis=0)
    height = (shares * np.stack([a[:, 2], b[:, 2], c[:, 2]])).sum(axis=0)
    ray, height, entering = ray[hit], height[hit], np.where(whole[hit] < 0, 1, -1)
    order = np.lexsort((height, ray))
    return np.cumsum(entering[order])


def test_nesting_tells_an_overlap_from_two_bodies() -> None:
    ball = trimesh.creation.icosphere(2)
    apart, overlapping = (
        trimesh.util.concatenate([ball, ball.copy().apply_translation(by)]) for by in ((3, 0, 0), (1, 0, 0))
    )
    assert set(nesting(apart, 200)) == {0, 1}
    assert set(nesting(overlapping, 200)) == {0, 1, 2}


@pytest.mark.parametrize(("triangles", "seed"), CASES)
def test_every_surface_is_closed_outward_nowhere_in_itself_and_shares_no_wall(built, triangles: int, seed: int) -> None:
    meshes = [structure.mesh for structure in built(triangles, seed).structures]
    for mesh in meshes:
        name = mesh.metadata["name"]
        assert np.isfinite(mesh.vertices).all(), name
        assert len(odd_edges(mesh.faces)) == 0, f"{name} is open"
        assert mesh.volume > 0, f"{name} is inside out"
        assert set(nesting(mesh, 250)) <= {0, 1}, f"{name} overlaps itself"
    assert shared_walls(meshes) == []
    assert len(meshes) < 96
