"""Surfaces of labels: their volume, what they enclose, and that structures which touch share no wall."""

from collections.abc import Sequence

import numpy as np
import pytest
import trimesh
from scipy.ndimage import find_objects, gaussian_filter
from scipy.spatial import cKDTree

from ablate.anatomy.meshes.check import openings, shared_walls
from ablate.anatomy.meshes.repair import repair
from ablate.anatomy.volumes import labelled_structures as module
from ablate.anatomy.volumes.labelled_structures import label_surface

CUBE, SLICES = (1.0, 1.0, 1.0), (0.7, 0.8, 4.0)


def surfaces(order: np.ndarray, spacing_mm: Sequence[float]) -> list[trimesh.Trimesh]:
    """The meshes of all numbers, in mm."""
    boxes = find_objects(order)
    meshes = [label_surface(order, i + 1, box, spacing_mm) for i, box in enumerate(boxes)]
    return [repair(vertices * spacing_mm, faces, f"label {i}") for i, (vertices, faces) in enumerate(meshes)]


def places_mm(shape: Sequence[int], spacing_mm: Sequence[float]) -> np.ndarray:
    """Middles of voxels, (x, y, z, 3), about the middle of the volume and a little beside."""
    axes = [(np.arange(n) - n / 2 + 0.29) * side for n, side in zip(shape, spacing_mm, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def ball(radius_mm: float, spacing_mm: Sequence[float]) -> np.ndarray:
    shape = [int(2 * radius_mm / side) + 7 for side in spacing_mm]
    return (np.linalg.norm(places_mm(shape, spacing_mm), axis=-1) < radius_mm).astype(np.uint8)


def blobs(shape: tuple[int, int, int], numbers: int, seed: int) -> np.ndarray:
    """A volume in which `numbers` structures and the outside touch each other in every way."""
    random = np.random.default_rng(seed)
    fields = [gaussian_filter(random.normal(size=shape), 4, mode="constant") for _ in range(numbers + 1)]
    return np.argmax(fields, axis=0).astype(np.uint8)


def owners(meshes: Sequence[trimesh.Trimesh], points: np.ndarray) -> np.ndarray:
    """1 + the last mesh that contains each of points (n, 3), by the crossings of rays that trimesh casts."""
    owner = np.zeros(len(points), int)
    for i, mesh in enumerate(meshes):
        owner[mesh.contains(points)] = i + 1
    return owner


@pytest.mark.parametrize("spacing_mm", [CUBE, SLICES])
@pytest.mark.parametrize("radius_mm", [9.0, 21.0])
def test_a_ball_has_its_volume_and_its_radius(radius_mm: float, spacing_mm: tuple[float, ...]) -> None:
    (mesh,) = surfaces(order := ball(radius_mm, spacing_mm), spacing_mm)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(order.sum() * np.prod(spacing_mm), rel=0.01)
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * radius_mm**3, rel=0.04)
    middle = mesh.vertices - (np.array(order.shape) / 2 - 0.29) * spacing_mm
    assert np.linalg.norm(middle, axis=1) == pytest.approx(radius_mm, abs=max(spacing_mm))


@pytest.mark.parametrize("radius_mm", [0.6, 1.0, 1.5, 2.0, 3.0, 5.0])
def test_a_label_of_few_voxels_keeps_its_volume(radius_mm: float) -> None:
    order = ball(radius_mm, CUBE)
    (mesh,) = surfaces(order, CUBE)
    tolerance = 0.1 if order.sum() < 5 else 0.02
    assert mesh.volume == pytest.approx(order.sum(), rel=tolerance)


def test_a_thin_sheet_and_a_thin_vessel_do_not_vanish() -> None:
    for thin in (np.s_[20:21, 5:35, 5:35], np.s_[19:21, 19:21, 2:38]):
        order = np.zeros((40, 40, 40), np.uint8)
        order[thin] = 1
        (mesh,) = surfaces(order, CUBE)
        assert mesh.volume == pytest.approx(order.sum(), rel=0.02)
        assert mesh.extents == pytest.approx(np.array(order[thin].shape), abs=1)


def test_a_sheet_keeps_its_volume_between_thick_slices() -> None:
    spacing_mm = (0.3, 0.3, 5.0)
    order = np.zeros((24, 216, 28), np.uint8)
    order[12, 8:-8, 8:-8] = 1
    (mesh,) = surfaces(order, spacing_mm)
    assert mesh.volume == pytest.approx(order.sum() * np.prod(spacing_mm), rel=0.02)


def test_a_plane_is_smooth_and_where_the_labels_change() -> None:
    """The steps of a plane that is tilted against the voxels are not seen; unsmoothed ones are half a voxel high."""
    points = places_mm((60, 60, 60), CUBE)
    normal = np.array([0.3, 0.2, 1.0]) / np.linalg.norm([0.3, 0.2, 1.0])
    (mesh,) = surfaces((points @ normal < 0).astype(np.uint8), CUBE)
    beside = (mesh.vertices - 30 + 0.29) @ normal
    far = np.abs(mesh.vertices - 30).max(axis=1) < 20
    assert np.abs(beside[far]).max() < 0.35
    assert beside[far].mean() == pytest.approx(0, abs=0.05)
    assert beside[far].std() < 0.15


@pytest.mark.parametrize(("seed", "spacing_mm"), [(0, CUBE), (1, CUBE), (2, SLICES)])
def test_structures_that_touch_share_no_wall_and_own_their_volumes(seed: int, spacing_mm: tuple[float, ...]) -> None:
    order = np.pad(blobs((26, 30, 24), 3, seed), 2)
    meshes = surfaces(order, spacing_mm)
    assert shared_walls(meshes) == []
    for mesh in meshes:
        assert openings(np.asarray(mesh.vertices), mesh.faces)[0] == 0
    steps = np.random.default_rng(seed).uniform(-0.5, 0.5, (order.size, 3))  # stratified: a point in every voxel
    owner = owners(meshes, (np.argwhere(np.ones_like(order)) + steps) * spacing_mm)
    volumes = np.bincount(owner, minlength=4)[1:]
    assert volumes == pytest.approx(np.bincount(order.ravel())[1:], rel=0.02)


def test_the_wall_between_two_labels_is_where_they_meet() -> None:
    """Inside a block of one label lies another; both visible walls are at the labels' borders, whoever is first."""
    order = np.full((30, 30, 30), 1, np.uint8)
    order[:, :, 12:] = 2
    for numbers in (order, 3 - order):
        meshes = surfaces(numbers, CUBE)
        height = np.linspace(0, 29, 200)
        line = np.column_stack([np.full(200, 14.03), np.full(200, 15.01), height])
        owner = owners(meshes, line)
        assert set(owner) == {1, 2}
        change = height[np.flatnonzero(np.diff(owner))]
        assert change == pytest.approx([11.5], abs=0.15)


def test_what_the_border_of_the_volume_cuts_is_closed_there() -> None:
    order = ball(12.0, CUBE)[:, :, :14]
    (mesh,) = surfaces(order, CUBE)
    assert mesh.is_watertight
    assert mesh.bounds[1, 2] == pytest.approx(13.5, abs=0.15)


def test_blocks_leave_no_seam(monkeypatch: pytest.MonkeyPatch) -> None:
    order = blobs((22, 20, 24), 2, 3)
    whole = surfaces(order, CUBE)
    monkeypatch.setattr(module, "BLOCK", 11)
    for one, many in zip(whole, surfaces(order, CUBE), strict=True):
        assert many.is_watertight
        assert len(many.faces) == len(one.faces)
        assert cKDTree(one.vertices).query(many.vertices)[0].max() < 1e-3
