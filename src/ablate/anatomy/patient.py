"""Which patient a seed stands for: how large the fetus is, how it lies, its limbs, and where the placenta is."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from ablate.anatomy.fetal_body import body_balls
from ablate.anatomy.fetal_frame import curl
from ablate.anatomy.fetal_limbs import SIDES, LimbPose, Limbs, arm_capsules, flesh_spheres, leg_capsules
from ablate.anatomy.free_space import FreeSpace, uterine_space
from ablate.anatomy.placenta import unit

CLEARANCE_MM = 2.0  # of fluid that a drawn fetus keeps from wall and placenta, where it can
NAVEL_IN_TRUNK = (0.0, -36.0, -27.0)
_DRAWS = 40
#: Share of pregnancies and direction from the middle of the uterus: placenta in front, behind, fundal, left, right.
PLACENTA_SITES = (
    (0.36, (0.1, -0.85, 0.45)),
    (0.34, (-0.1, 0.85, 0.45)),
    (0.14, (0.0, -0.3, 0.95)),
    (0.08, (0.85, -0.2, 0.45)),
    (0.08, (-0.85, -0.2, 0.45)),
)


@dataclass(frozen=True, eq=False)
class Patient:
    """One mother and fetus.

    Attributes
    ----------
    seed : int
        Of the surface displacements.
    size : float
        Factor on every length of the fetus; 1 is the table's 22 weeks.
    rotation : (3, 3) float
        Columns are the fetus's left, back and head in the world.
    origin : (3,) float, mm
        Where the fetal origin lies in the world.
    limbs : Limbs
    placenta : (3,) float
        Unit direction of the placenta's middle; see `placenta_field`.
    uterus : FreeSpace
        The space between its wall and the placenta.
    """

    seed: int
    size: float
    rotation: np.ndarray
    origin: np.ndarray
    limbs: Limbs
    placenta: np.ndarray
    uterus: FreeSpace

    def to_world(self, points: np.ndarray) -> np.ndarray:
        """From fetal axes (..., 3) to the mother's (..., 3), mm."""
        return self.size * np.asarray(points) @ self.rotation.T + self.origin

    def balls(self) -> np.ndarray:
        """Balls that about fill the fetus in the world: centre and radius, (n, 4), mm."""
        balls = fetal_balls(self.limbs)
        return np.column_stack([self.to_world(balls[:, :3]), self.size * balls[:, 3]])


@cache
def draw_patient(seed: int) -> Patient:
    """The patient of a seed.

    Seed 0 is the picture-book case: head down, its left side and its back to the probe, placenta high in front.
    Others vary in size (about 0.93 to 1.03), presentation (a third breech), lie, limbs and placenta: lies and limbs
    are drawn until the fetus keeps clear of wall and placenta, every time a little smaller.

    Raises
    ------
    ValueError
        When `seed` is negative.
    """
    if seed < 0:
        raise ValueError(f"seed must be at least 0, not {seed}")
    if seed == 0:
        towards = unit(np.array((-0.45, -0.62, 0.64)))
        rotation = lie(head_down=True, back_deg=-68.0, oblique_deg=-4.0, nod_deg=0.0)
        room, limbs = uterine_space(seed, towards), Limbs()
        return Patient(seed, 1.0, rotation, _place(room, fetal_balls(limbs), rotation)[0], limbs, towards, room)
    generator = np.random.default_rng([seed, 22])
    size = float(np.clip(generator.normal(1.03, 0.04), 0.92, 1.1))
    site = PLACENTA_SITES[generator.choice(len(PLACENTA_SITES), p=[share for share, _ in PLACENTA_SITES])][1]
    towards = unit(np.array(site) + generator.normal(0.0, 0.15, 3))
    room = uterine_space(seed, towards)
    best: tuple[float, np.ndarray, np.ndarray, Limbs] | None = None
    for _ in range(_DRAWS):
        limbs = _draw_limbs(generator)
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
    return Patient(seed, size, *best[1:], towards, room)


def lie(head_down: bool, back_deg: float, oblique_deg: float, nod_deg: float) -> np.ndarray:
    """Columns are the fetus's left, back and head in the world.

    Parameters
    ----------
    head_down : bool
    back_deg : float
        Where its back points: 0 to the mother's front, 90 to her left.
    oblique_deg : float
        Of its long axis in her coronal plane.
    nod_deg : float
        Of its long axis in her sagittal plane.
    """
    back = np.array([np.sin(np.deg2rad(back_deg)), -np.cos(np.deg2rad(back_deg)), 0.0])
    head = np.array([0.0, 0.0, -1.0 if head_down else 1.0])
    upright = np.stack([np.cross(back, head), back, head], axis=1)
    return Rotation.from_euler("xy", [nod_deg, oblique_deg], degrees=True).as_matrix() @ upright


def fetal_balls(limbs: Limbs) -> np.ndarray:
    """Balls that about fill the fetus, in fetal axes: centre and radius, (n, 4)."""
    legs = [flesh_spheres(leg_capsules(limbs.leg(side))) for side in SIDES]
    arms = [flesh_spheres(arm_capsules(limbs.arm(side))) for side in SIDES]
    return np.concatenate([body_balls(), *legs, *arms])


def _place(room: FreeSpace, balls: np.ndarray, rotation: np.ndarray) -> tuple[np.ndarray, float]:
    """The origin that keeps balls (n, 4) farthest from wall and placenta, and how far: mm."""
    turned, radius = balls[:, :3] @ rotation.T, balls[:, 3]

    def clearance(origins: np.ndarray) -> np.ndarray:
        return (room.at(turned + origins[:, None]) - radius).min(axis=1)

    middle = room.low + 1.5 * np.array(room.clearance.shape) - (turned.min(axis=0) + turned.max(axis=0)) / 2.0
    best, most, step = middle, -np.inf, 8.0
    around = np.stack(np.meshgrid(*3 * [np.arange(-1, 2)], indexing="ij"), axis=-1).reshape(-1, 3)
    while step > 0.4:
        origins = best + step * around
        found = clearance(origins)
        if found.max() > most + 0.01:
            best, most = origins[int(np.argmax(found))], float(found.max())
        else:
            step /= 2.0
    return best, most


def _draw_limbs(generator: np.random.Generator) -> Limbs:
    """Limbs that do not run into each other, the trunk or the cord; the picture-book ones if none is found."""

    def leg_pose() -> LimbPose:
        return LimbPose(*generator.uniform((95.0, 8.0, 100.0, 5.0), (130.0, 24.0, 148.0, 30.0)))

    def arm_pose() -> LimbPose:
        return LimbPose(*generator.uniform((10.0, 0.0, 50.0, 5.0), (60.0, 20.0, 125.0, 40.0)))

    for _ in range(200):
        limbs = Limbs(leg_pose(), leg_pose(), arm_pose(), arm_pose())
        if untangled(limbs):
            return limbs
    return Limbs()


def untangled(limbs: Limbs) -> bool:
    """Whether no limb runs through another one, the trunk, the head, or the place of the cord at the navel."""
    navel = np.array([[*curl(np.array([NAVEL_IN_TRUNK]))[0], 6.0]])
    fixed = np.concatenate([body_balls(), navel])
    lower, whole = [], []
    for side in SIDES:
        for capsules in (leg_capsules(limbs.leg(side)), arm_capsules(limbs.arm(side))):
            lower.append(flesh_spheres(capsules[1:]))
            whole.append(flesh_spheres(capsules))
    pairs = [(lower[i], fixed) for i in range(4)]
    pairs += [(whole[i][4:], navel) for i in (0, 2)]
    pairs += [(lower[i], whole[j]) for i in range(4) for j in range(4) if i != j]
    return all(_gap(first, second) > 0.0 for first, second in pairs)


def _gap(first: np.ndarray, second: np.ndarray) -> float:
    """The least distance between the surfaces of two sets of balls, (n, 4) and (m, 4)."""
    apart = np.linalg.norm(first[:, None, :3] - second[None, :, :3], axis=2)
    return float((apart - first[:, None, 3] - second[None, :, 3]).min())
