"""Which pregnancy a seed stands for: size, lie and limbs of the fetus, uterus and placenta, and the fluid."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, cached_property
from operator import itemgetter

import numpy as np
from scipy.ndimage import binary_erosion, map_coordinates
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from skimage.measure import marching_cubes

from ablate.anatomy.fetal.body import NAVEL_IN_TRUNK, LimbPose, Limbs, curl, fetal_balls, flesh_field, untangled
from ablate.anatomy.fetal.mother import THICKNESS_MM, Uterus, placenta_field
from ablate.anatomy.fetal.shapes import Field, capsule, unit

PITCH_MM = 4.0  # of the grid of clearances
#: Least and largest height of the deepest pocket of fluid without the cord; the clinical range is 20 to 80 mm.
POCKET_MM = (28.0, 72.0)
SINK_MM = 5.0  # of the fetus to the mother's back
FOLD_MM = 16.0  # radius of the ball that cannot reach the folds which the wall spans
DEEPEST_Y_MM = 20.0  # of the fetus: it ends in front of the mother's spine, 150 mm under her skin
_LIES, _UTERI = 30, 5  # drawn at most
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
HEAD_DOWN_SHARE, BREECH_SHARE = 0.5, 0.32  # of pregnancies of 22 weeks (assumed); the others lie across


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

    def with_distances(self) -> FreeSpace:
        """The same space; within it the clearance is the true distance to its border."""
        corners, faces, _, _ = marching_cubes(self.clearance, 0.0)
        surface = self.first + PITCH_MM * np.concatenate([corners, corners[faces].mean(axis=1)])
        free, clearance = self.clearance > 0.0, self.clearance.copy()
        clearance[free] = cKDTree(surface).query(self.points[free])[0]
        return replace(self, clearance=clearance)

    def deepest_pocket_mm(self) -> float:
        """Longest vertical line of the mother on her back (along y) in fluid that is 8 mm wide around it."""
        wide = binary_erosion(self.clearance > 0.0, np.ones((3, 1, 3)))
        run, deepest = np.zeros(wide[:, 0].shape), 0.0
        for layer in np.moveaxis(wide, 1, 0):
            run = (run + PITCH_MM) * layer
            deepest = max(deepest, float(run.max()))
        return deepest


@dataclass(frozen=True, eq=False)
class Pregnancy:
    """One mother and fetus."""

    size: float  # factor on every length of the fetus; 1 is the table's 22 weeks
    rotation: np.ndarray  # (3, 3): columns are the fetus's left, back and head in the world
    origin: np.ndarray  # (3,): the fetal origin in the world, mm
    limbs: Limbs
    uterus: Uterus
    fluid: FreeSpace  # between wall, placenta and fetus

    def to_world(self, points: np.ndarray) -> np.ndarray:
        """From fetal axes (..., 3) to the mother's (..., 3), mm."""
        return self.size * np.asarray(points) @ self.rotation.T + self.origin


@cache
def draw_pregnancy(seed: int) -> Pregnancy:
    """The pregnancy of a seed.

    Seed 0 is the textbook case: head down, its left side and its back to the probe, placenta high in front.
    Others vary in size (0.92 to 1.08), presentation (half head down, a third breech, others across), lie, limbs,
    placenta, and the fat of the mother. The fetus lies on the wall or the placenta behind it and stretches the wall.
    Lie, limbs and uterus are drawn again until the deepest pocket of fluid is within `POCKET_MM`, else the nearest
    one is taken. Raises ValueError when `seed` is negative.
    """
    if seed < 0:
        raise ValueError(f"seed must be at least 0, not {seed}")
    generator = np.random.default_rng([seed, 22])
    size, fat_mm = 1.0, 15.0
    towards = unit(np.array((-0.45, -0.62, 0.64)))
    if seed > 0:
        size = float(np.clip(generator.normal(1.0, 0.04), 0.92, 1.08))
        fat_mm = float(np.clip(generator.normal(15.0, 4.0), 8.0, 24.0))
        site = PLACENTA_SITES[generator.choice(len(PLACENTA_SITES), p=[share for share, _ in PLACENTA_SITES])][1]
        towards = unit(np.array(site) + generator.normal(0.0, 0.15, 3))
    tried: list[tuple[float, Pregnancy]] = []
    for number in range(_LIES if seed > 0 else 1):
        turn = 0.618034 * (seed + number // 20) % 1.0  # golden ratio: few seeds have all presentations
        limbs, rotation = (Limbs(), lie(True, -68.0, -4.0, 0.0)) if seed == 0 else _drawn_lie(turn, generator)
        fetus = _Fetus(size, rotation, limbs)
        radii = np.ptp(fetus.ends, axis=0) / 2.0 + (6.0, -6.0, 6.0) - 12.0 * np.abs(rotation[:, 2])
        for _ in range(_UTERI):
            uterus = Uterus(seed, radii, towards, fat_mm)
            origin = fetus.settled(uterus)
            if tried and origin[1] + fetus.ends[1, 1] > DEEPEST_Y_MM:
                break
            uterus = replace(uterus, fetus=fetus.at(origin, fetus.flesh), hull=fetus.at(origin, fetus.hull))
            fluid = _space(uterus, origin + fetus.ends)
            pocket = fluid.deepest_pocket_mm()
            off = max(POCKET_MM[0] - pocket, pocket - POCKET_MM[1], 0.0)
            off += max(origin[1] + float(fetus.ends[1, 1]) - DEEPEST_Y_MM, 0.0)
            tried.append((off, Pregnancy(size, rotation, origin, limbs, uterus, fluid)))
            if off == 0.0:
                return replace(tried[-1][1], fluid=fluid.with_distances())
            radii = radii + (2.0 if pocket < POCKET_MM[0] else (0.0, -4.0, 0.0))
    nearest = min(tried, key=itemgetter(0))[1]
    return replace(nearest, fluid=nearest.fluid.with_distances())


def _drawn_lie(turn: float, generator: np.random.Generator) -> tuple[Limbs, np.ndarray]:
    """Limbs, the first of 200 draws that do not run into each other, the trunk or the cord, and a rotation."""
    angles_deg = (_LEG_DEG, _LEG_DEG, _ARM_DEG, _ARM_DEG)
    drawn = (Limbs(*(LimbPose(*generator.uniform(*ends)) for ends in angles_deg)) for _ in range(200))
    limbs = next(filter(untangled, drawn), Limbs())
    oblique = float(np.clip(generator.normal(0.0, 12.0), -30.0, 30.0))
    if turn > HEAD_DOWN_SHARE + BREECH_SHARE:
        oblique += 90.0 * generator.choice((-1.0, 1.0))
    return limbs, lie(turn < HEAD_DOWN_SHARE, generator.uniform(-180.0, 180.0), oblique, generator.normal(0.0, 5.0))


def lie(head_down: bool, back_deg: float, oblique_deg: float, nod_deg: float) -> np.ndarray:
    """Columns are the fetus's left, back and head in the world.

    Parameters
    ----------
    head_down : bool
        Whether its head points to the mother's feet.
    back_deg : float
        Where its back points: 0 to the mother's front, 90 to her left.
    oblique_deg, nod_deg : float
        How far its long axis is turned in her coronal and in her sagittal plane.

    Returns
    -------
    (3, 3) float
        A rotation.
    """
    back = np.array([np.sin(np.deg2rad(back_deg)), -np.cos(np.deg2rad(back_deg)), 0.0])
    head = np.array([0.0, 0.0, -1.0 if head_down else 1.0])
    upright = np.stack([np.cross(back, head), back, head], axis=1)
    return Rotation.from_euler("xy", [nod_deg, oblique_deg], degrees=True).as_matrix() @ upright


@dataclass(frozen=True, eq=False)
class _Fetus:
    """A fetus before it has its place."""

    size: float
    rotation: np.ndarray
    limbs: Limbs

    @cached_property
    def balls(self) -> np.ndarray:
        """Balls that about fill it, turned and of its size, about its own origin: (n, 4), mm."""
        balls = fetal_balls(self.limbs)
        return self.size * np.column_stack([balls[:, :3] @ self.rotation.T, balls[:, 3]])

    @cached_property
    def flesh(self) -> FreeSpace:
        """Distance to the flesh, in fetal axes."""
        balls = fetal_balls(self.limbs)
        middle, radius = balls[:, :3], balls[:, 3:] + 2.0 * THICKNESS_MM
        return _on_grid(flesh_field(self.limbs), (middle - radius).min(axis=0), (middle + radius).max(axis=0))

    @cached_property
    def hull(self) -> FreeSpace:
        """Distance to the flesh with its folds filled, and with room for the cord, in fetal axes."""
        flesh, navel = self.flesh, np.array(NAVEL_IN_TRUNK)
        start, end = curl(np.stack([navel, navel - (0.0, 18.0, 0.0)]))
        cord = capsule(start, end, 7.0, 7.0)
        taken = np.minimum(flesh.clearance, cord(*np.moveaxis(flesh.points, -1, 0)))
        grown = replace(flesh, clearance=(FOLD_MM - taken).astype(np.float32)).with_distances()
        return replace(flesh, clearance=np.minimum(flesh.clearance, FOLD_MM - grown.clearance))

    @property
    def ends(self) -> np.ndarray:
        """Lowest and highest corner of the box around it, (2, 3)."""
        middle, radius = self.balls[:, :3], self.balls[:, 3:]
        return np.stack([(middle - radius).min(axis=0), (middle + radius).max(axis=0)])

    def at(self, origin: np.ndarray, distance: FreeSpace) -> Field:
        """A distance, which is given in fetal axes, in the world."""

        def to_fetus(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
            away = np.stack(np.broadcast_arrays(x, y, z), axis=-1) - origin
            return self.size * distance.clearance_at(away @ (self.rotation / self.size))

        return to_fetus

    def settled(self, uterus: Uterus) -> np.ndarray:
        """Where it comes to rest, (3,) mm: `SINK_MM` behind where abdominal wall and placenta let it come in front."""
        middle = uterus.center - 0.5 * THICKNESS_MM * uterus.placenta - self.ends.mean(axis=0)
        origins = middle + np.arange(-40.0, 80.0, 1.0)[:, None] * (0.0, 1.0, 0.0)
        places = np.moveaxis(self.balls[:, :3] + origins[:, None], -1, 0)
        room = -uterus.in_wall()(*places) - uterus.thickness(*places) - self.balls[:, 3]
        return origins[np.argmax(room.min(axis=1) > 0.0)] + (0.0, SINK_MM, 0.0)


def _space(uterus: Uterus, ends: np.ndarray) -> FreeSpace:
    """The space between wall, placenta and fetus, which is between two corners (2, 3)."""
    cavity, disc, fetus = uterus.cavity(), placenta_field(uterus), uterus.fetus
    assert fetus is not None
    low, high = np.minimum(uterus.center - uterus.radii, ends[0]), np.maximum(uterus.center + uterus.radii, ends[1])
    around = THICKNESS_MM + 2.0 * PITCH_MM

    def free(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        return np.minimum(np.minimum(-cavity(x, y, z), disc(x, y, z)), fetus(x, y, z))

    return _on_grid(free, low - around, high + around)


def _on_grid(field: Field, low: np.ndarray, high: np.ndarray) -> FreeSpace:
    axes = [np.arange(low[i], high[i] + PITCH_MM, PITCH_MM, dtype=np.float32) for i in range(3)]
    return FreeSpace(low, field(*np.meshgrid(*axes, indexing="ij", sparse=True)).astype(np.float32))
