"""Which pregnancy a seed stands for: size, lie and limbs of the fetus, the placenta, and the fluid around them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from skimage.measure import marching_cubes

from ablate.anatomy.fetal.body import LimbPose, Limbs, fetal_balls, untangled
from ablate.anatomy.fetal.mother import UTERUS_CENTER, UTERUS_RADII, cavity, placenta_field
from ablate.anatomy.fetal.shapes import unit

PITCH_MM = 4.0  # of the grid of clearances
CLEARANCE_MM = 2.0  # of fluid between a drawn fetus and wall or placenta, where there is room
_DRAWS = 40
#: Least and largest angles of a drawn limb: flexion, abduction, bend, inward; see `LimbPose`.
_LEG_DEG = ((95.0, 8.0, 100.0, 5.0), (130.0, 24.0, 148.0, 30.0))
_ARM_DEG = ((10.0, 0.0, 50.0, 5.0), (60.0, 20.0, 125.0, 40.0))
#: Share of pregnancies and direction from the middle of the uterus: placenta in front, behind, fundal, left, right.
PLACENTA_SITES = (
    (0.36, (0.1, -0.85, 0.45)),
    (0.34, (-0.1, 0.85, 0.45)),
    (0.14, (0.0, -0.3, 0.95)),
    (0.08, (0.85, -0.2, 0.45)),
    (0.08, (-0.85, -0.2, 0.45)),
)


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """Clearance on a grid of spacing `PITCH_MM`: about the distance to the nearest surface."""

    first: np.ndarray  # (3,): world position of the first grid point, mm
    clearance: np.ndarray  # (i, j, k), mm; negative where there is no fluid

    def clearance_at(self, points: np.ndarray) -> np.ndarray:
        """Clearance at world points (..., 3), interpolated; (...) mm."""
        index = np.moveaxis((points - self.first) / PITCH_MM, -1, 0)
        return map_coordinates(self.clearance, index, order=1, mode="nearest")

    @property
    def points(self) -> np.ndarray:
        """World positions of the grid, (i, j, k, 3) mm."""
        return self.first + PITCH_MM * np.moveaxis(np.indices(self.clearance.shape), 0, -1)

    def without(self, balls: np.ndarray) -> FreeSpace:
        """The space that balls, (n, 4) centre and radius, leave."""
        points = self.points.reshape(-1, 3).astype(np.float32)
        clearance = self.clearance.reshape(-1).copy()
        for x, y, z, radius in balls.astype(np.float32):
            distance = np.sqrt(((points - (x, y, z)) ** 2).sum(axis=1)) - radius
            np.minimum(clearance, distance, out=clearance)
        return replace(self, clearance=clearance.reshape(self.clearance.shape))


def uterine_space(seed: int, towards: np.ndarray) -> FreeSpace:
    """The space between wall and placenta; arguments as for `placenta_field`."""
    reach = np.array(UTERUS_RADII) + PITCH_MM
    low = np.array(UTERUS_CENTER) - reach
    shape = np.ceil(2.0 * reach / PITCH_MM).astype(int) + 1
    x, y, z = np.meshgrid(*(low[i] + PITCH_MM * np.arange(shape[i]) for i in range(3)), indexing="ij", sparse=True)
    field = np.minimum(-cavity(seed)(x, y, z), placenta_field(seed, towards)(x, y, z)).astype(np.float32)
    space = FreeSpace(low, field)
    corners, faces, _, _ = marching_cubes(field, 0.0)
    surface = low + PITCH_MM * np.concatenate([corners, corners[faces].mean(axis=1)])
    free = np.flatnonzero(field > 0.0)
    clearance = field.ravel().copy()  # the field is a distance near the surface only
    distance = cKDTree(surface).query(space.points.reshape(-1, 3)[free])[0]
    clearance[free] = np.minimum(clearance[free], distance)
    return replace(space, clearance=clearance.reshape(field.shape))


@dataclass(frozen=True, eq=False)
class Pregnancy:
    """One mother and fetus."""

    seed: int  # of the surface displacements
    size: float  # factor on every length of the fetus; 1 is the table's 22 weeks
    rotation: np.ndarray  # (3, 3): columns are the fetus's left, back and head in the world
    origin: np.ndarray  # (3,): the fetal origin in the world, mm
    limbs: Limbs
    placenta: np.ndarray  # (3,): unit direction of the placenta's middle, see `placenta_field`
    uterus: FreeSpace  # between its wall and the placenta

    def to_world(self, points: np.ndarray) -> np.ndarray:
        """From fetal axes (..., 3) to the mother's (..., 3), mm."""
        return self.size * np.asarray(points) @ self.rotation.T + self.origin

    def balls(self) -> np.ndarray:
        """Balls that about fill the fetus in the world: centre and radius, (n, 4), mm."""
        balls = fetal_balls(self.limbs)
        return np.column_stack([self.to_world(balls[:, :3]), self.size * balls[:, 3]])


@cache
def draw_pregnancy(seed: int) -> Pregnancy:
    """The pregnancy of a seed.

    Seed 0 is the textbook case: head down, its left side and its back to the probe, placenta high in front.
    Others vary in size (about 0.93 to 1.03), presentation (a third breech), lie, limbs and placenta. Lie and limbs
    are drawn again, for a slightly smaller fetus each time, until it is clear of wall and placenta. Raises ValueError
    when `seed` is negative.
    """
    if seed < 0:
        raise ValueError(f"seed must be at least 0, not {seed}")
    if seed == 0:
        towards = unit(np.array((-0.45, -0.62, 0.64)))
        rotation = lie(head_down=True, back_deg=-68.0, oblique_deg=-4.0, nod_deg=0.0)
        room, limbs = uterine_space(seed, towards), Limbs()
        return Pregnancy(seed, 1.0, rotation, _place(room, fetal_balls(limbs), rotation)[0], limbs, towards, room)
    generator = np.random.default_rng([seed, 22])
    size = float(np.clip(generator.normal(1.03, 0.04), 0.92, 1.1))
    site = PLACENTA_SITES[generator.choice(len(PLACENTA_SITES), p=[share for share, _ in PLACENTA_SITES])][1]
    towards = unit(np.array(site) + generator.normal(0.0, 0.15, 3))
    room = uterine_space(seed, towards)
    best: tuple[float, np.ndarray, np.ndarray, Limbs] | None = None
    for _ in range(_DRAWS):
        # of 200 draws the first whose limbs do not run into each other, the trunk or the cord, else those of seed 0
        angles_deg = (_LEG_DEG, _LEG_DEG, _ARM_DEG, _ARM_DEG)
        drawn = (Limbs(*(LimbPose(*generator.uniform(*ends)) for ends in angles_deg)) for _ in range(200))
        limbs = next(filter(untangled, drawn), Limbs())
        rotation = lie(
            head_down=bool(generator.random() < 0.67),
            back_deg=generator.uniform(-180.0, 180.0),
            oblique_deg=float(np.clip(generator.normal(0.0, 12.0), -30.0, 30.0)),
            nod_deg=generator.normal(0.0, 5.0),
        )
        origin, clearance = _place(room, size * fetal_balls(limbs), rotation)
        if best is None or clearance > best[0]:
            best = clearance, rotation, origin, limbs
        if clearance > CLEARANCE_MM:
            break
        size *= 0.995
    assert best is not None
    return Pregnancy(seed, size, *best[1:], towards, room)


def lie(head_down: bool, back_deg: float, oblique_deg: float, nod_deg: float) -> np.ndarray:
    """Columns are the fetus's left, back and head in the world.

    `back_deg` says where its back points: 0 to the mother's front, 90 to her left. Its long axis is turned by
    `oblique_deg` in her coronal and by `nod_deg` in her sagittal plane.
    """
    back = np.array([np.sin(np.deg2rad(back_deg)), -np.cos(np.deg2rad(back_deg)), 0.0])
    head = np.array([0.0, 0.0, -1.0 if head_down else 1.0])
    upright = np.stack([np.cross(back, head), back, head], axis=1)
    return Rotation.from_euler("xy", [nod_deg, oblique_deg], degrees=True).as_matrix() @ upright


def _place(room: FreeSpace, balls: np.ndarray, rotation: np.ndarray) -> tuple[np.ndarray, float]:
    """The origin that keeps balls (n, 4) farthest from wall and placenta, and how far: mm."""
    turned, radius = balls[:, :3] @ rotation.T, balls[:, 3]
    middle = room.first + 1.5 * np.array(room.clearance.shape) - (turned.min(axis=0) + turned.max(axis=0)) / 2.0
    best, most, step = middle, -np.inf, 8.0
    around = np.stack(np.meshgrid(*3 * [np.arange(-1, 2)], indexing="ij"), axis=-1).reshape(-1, 3)
    while step > 0.4:
        origins = best + step * around
        clearances = (room.clearance_at(turned + origins[:, None]) - radius).min(axis=1)
        if clearances.max() > most + 0.01:
            best, most = origins[int(np.argmax(clearances))], float(clearances.max())
        else:
            step /= 2.0
    return best, most
