"""Pregnancies: lies that differ, limbs that do not tangle, a fetus that lies on a wall, how deep the fluid is."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from ablate.anatomy.fetal.body import Limbs
from ablate.anatomy.fetal.mother import placenta_field
from ablate.anatomy.fetal.pregnancy import draw_pregnancy, lie, untangled
from ablate.anatomy.fetal.umbilical_cord import JELLY_MM, cord_route

SEEDS = [0, 1, 2, 3]
TEN = [*SEEDS, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(4, 10))]
FLESH = ("body and head", "left leg", "right leg", "left arm", "right arm")


@pytest.mark.parametrize("seed", SEEDS)
def test_lie_is_rigid_and_limbs_are_untangled(seed: int) -> None:
    pregnancy = draw_pregnancy(seed)
    assert pregnancy.rotation @ pregnancy.rotation.T == pytest.approx(np.eye(3))
    assert np.linalg.det(pregnancy.rotation) == pytest.approx(1.0)
    assert np.linalg.norm(pregnancy.uterus.placenta) == pytest.approx(1.0)
    assert untangled(pregnancy.limbs)


def test_tangled_limbs_are_told() -> None:
    assert untangled(Limbs())
    crossed = Limbs(*(type(Limbs().left_leg)(90.0, -25.0, 10.0, 0.0) for _ in range(2)))
    assert not untangled(crossed)


def test_pregnancies_differ() -> None:
    pregnancies = [draw_pregnancy(seed) for seed in range(8)]
    heads = np.array([p.rotation[:, 2] for p in pregnancies])
    backs = np.array([p.rotation[:, 1] for p in pregnancies])
    placentas = np.array([p.uterus.placenta for p in pregnancies])
    assert heads[:, 2].min() < -0.8 < 0.8 < heads[:, 2].max()  # head down and breech
    assert np.abs(heads[:, 0]).max() > 0.8  # across
    assert np.ptp([p.uterus.fat_mm for p in pregnancies]) > 4.0
    assert backs[:, 0].min() < -0.5 < 0.5 < backs[:, 0].max()  # back to her right and left
    assert placentas[:, 1].min() < -0.5 < 0.5 < placentas[:, 1].max()  # in front and behind
    assert len({p.limbs for p in pregnancies}) == len({p.size for p in pregnancies}) == len(pregnancies)
    assert pregnancies[0].size == 1.0, "the textbook case"
    assert all(0.85 < p.size < 1.11 for p in pregnancies)


def test_lie_points_head_and_back_where_asked() -> None:
    rotation = lie(head_down=True, back_deg=90.0, oblique_deg=0.0, nod_deg=0.0)
    assert rotation[:, 2] == pytest.approx([0, 0, -1])
    assert rotation[:, 1] == pytest.approx([1, 0, 0])


@pytest.mark.parametrize("seed", TEN)
def test_deepest_pocket_is_of_a_normal_pregnancy(built, mesh_of, seed: int) -> None:
    """The deepest vertical pocket (the mother lies on her back) without limbs and cord is 2 to 8 cm, on the meshes.

    A line of fluid counts if four lines 5 mm beside it are in fluid too: the pocket is 1 cm wide.
    """
    scene, pitch = built(30_000, seed), 2.5
    cavity = mesh_of(scene, "amniotic cavity")
    others = [mesh_of(scene, name) for name in (*FLESH, "placenta", "umbilical cord")]
    low, high = cavity.bounds
    x, z = np.meshgrid(np.arange(low[0], high[0], pitch), np.arange(low[2], high[2], pitch), indexing="ij")
    y = np.arange(low[1], high[1], pitch)
    fluid = np.zeros((*x.shape, len(y)), bool)
    for mesh in (cavity, *others):
        starts = np.column_stack([x.ravel(), np.full(x.size, low[1] - 5.0), z.ravel()])
        points, line, _ = mesh.ray.intersects_location(starts, np.broadcast_to((0.0, 1.0, 0.0), starts.shape))
        crossings = np.zeros((x.size, len(y) + 1), int)
        np.add.at(crossings, (line, np.searchsorted(y, points[:, 1])), 1)
        inside = (np.cumsum(crossings[:, :-1], axis=1) % 2 == 1).reshape(fluid.shape)
        fluid = inside if mesh is cavity else fluid & ~inside
    step = 2
    wide = fluid[step:-step, step:-step]
    wide = wide & fluid[2 * step :, step:-step] & fluid[: -2 * step, step:-step]
    wide = wide & fluid[step:-step, 2 * step :] & fluid[step:-step, : -2 * step]
    ends = np.diff(wide.reshape(-1, len(y)).astype(int), axis=1, prepend=0, append=0)
    deepest = pitch * (np.argwhere(ends == -1)[:, 1] - np.argwhere(ends == 1)[:, 1]).max()
    assert 20.0 <= deepest <= 80.0


@pytest.mark.parametrize("seed", TEN)
def test_fetus_lies_on_a_wall_or_the_placenta(built, mesh_of, seed: int) -> None:
    """It is in the cavity, and somewhere less than 1 mm from wall or placenta."""
    scene, pregnancy = built(30_000, seed), draw_pregnancy(seed)
    inner, disc = pregnancy.uterus.cavity(), placenta_field(pregnancy.uterus)
    gap = np.inf
    for name in FLESH:
        points = mesh_of(scene, name).vertices
        to_wall, to_disc = -inner(*points.T), disc(*points.T)
        assert to_wall.min() > -1.0, f"{name} cuts the uterus"
        assert to_disc.min() > -1.0, f"{name} lies in the placenta"
        gap = min(gap, to_wall.min(), to_disc.min())
    assert gap < 1.0
    front = mesh_of(scene, "skin").vertices[:, 1].min()
    depth = np.concatenate([mesh_of(scene, name).vertices[:, 1] for name in FLESH]) - front
    assert 30 < depth.min()
    assert depth.max() < 155


@pytest.mark.parametrize("seed", SEEDS)
def test_cord_runs_free_from_navel_to_placenta(built, mesh_of, seed: int) -> None:
    scene, pregnancy = built(30_000, seed), draw_pregnancy(seed)
    path, insertion = cord_route(pregnancy)
    length = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))]
    assert length[-1] > 120.0
    assert mesh_of(scene, "body and head").contains(path[:1]).all()
    assert placenta_field(pregnancy.uterus)(*path[-1:].T)[0] < 0.0
    assert np.linalg.norm(path[-1] - insertion) < 10.0
    between = path[(length > 24.0) & (length < length[-1] - 22.0)]
    assert pregnancy.uterus.cavity()(*between.T).max() < -JELLY_MM
    for name in FLESH:
        skin = trimesh.sample.sample_surface(mesh_of(scene, name), 30_000, seed=0)[0]
        distance = cKDTree(skin).query(between)[0]
        assert distance.min() > JELLY_MM - 1.5, name  # the balls that it was kept from are not quite the flesh
