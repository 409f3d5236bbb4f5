"""The umbilical cord: its way in loops from the navel to the placenta, and its jelly and vessels. World, mm."""

from itertools import pairwise, permutations

import numpy as np
from scipy.ndimage import distance_transform_edt, map_coordinates, maximum_filter
from skimage.graph import route_through_array

from ablate.anatomy.fetal.body import NAVEL_IN_TRUNK, curl
from ablate.anatomy.fetal.mother import REACH_DEG, Uterus, face_points, from_middle, placenta_field
from ablate.anatomy.fetal.pregnancy import PITCH_MM, FreeSpace, Pregnancy
from ablate.anatomy.fetal.shapes import Part, joined, unit
from ablate.anatomy.fetal.tubes import arc_length, frames, interpolated, smooth_path, tube

JELLY_MM = 4.5  # radius of the cord
WIND_MM = 26.0  # length of one turn of the arteries
VESSELS = ((0.0, 1.7, 1.6), (132.0, 2.6, 0.95), (228.0, 2.6, 0.95))  # angle (deg), from the middle, radius (mm)
WALL_MM = 0.3  # of a vessel
ROOM_MM = 0.5  # least distance between the cord and anything else
SPACING_MM = 4.0  # of the points that are moved
_ROOT_IN_TRUNK = ((0.0, -20.0, -27.0), (0.0, -27.0, -27.0))
_BLOCKED = 1e4


def cord_route(pregnancy: Pregnancy) -> tuple[np.ndarray, np.ndarray]:
    """Middle line of the cord, and where it meets the placenta.

    The shortest way through wide fluid is found, by way of up to three pockets far from everything, and then
    tightened: its points are pushed away from walls, fetus and other turns of the cord, and towards a straight line.
    Of the ways that touch nothing, the one through most pockets is taken. Returns the smooth path (n, 3), mm, from
    under the skin of the navel into the placenta, and its point on the placenta's fetal face, (3,), mm.
    """
    space = pregnancy.fluid
    root = pregnancy.to_world(curl(np.array([*_ROOT_IN_TRUNK, NAVEL_IN_TRUNK])))
    leave = root[2] + 10.0 * unit(root[2] - root[1])
    insertion, into = _insertion(pregnancy.uterus, space)
    arrive = insertion - 13.0 * into
    end = np.array([insertion, insertion + 6.0 * into])
    pockets = _pockets(space)
    best, least = np.empty((0, 3)), -np.inf
    for stops in [*permutations(pockets, 3), *permutations(pockets[:2]), *((pocket,) for pocket in pockets), ()]:
        shortest = _by_way_of(space, [leave, *stops, arrive])
        path = _relaxed(space, np.concatenate([root, shortest, end]))
        room = _room(space, path)
        if room > least:
            best, least = path, room
        if room > ROOM_MM:
            break
    return smooth_path(best, 4 * len(best)), insertion


def _insertion(uterus: Uterus, space: FreeSpace) -> tuple[np.ndarray, np.ndarray]:
    """A point near the middle of the placenta's face with much fluid before it, and the way inwards there."""
    turn = np.linspace(0.0, 2.0 * np.pi, 10, endpoint=False)
    polar = np.deg2rad(REACH_DEG) * np.repeat((0.1, 0.3, 0.45, 0.6), 10)
    directions = from_middle(uterus.placenta, polar, np.tile(turn, 4))
    points = face_points(uterus, placenta_field(uterus), directions)
    inwards = unit(directions / uterus.radii)
    room = np.minimum(space.clearance_at(points - 13.0 * inwards), 12.0)
    best = int(np.argmax(room - 6.0 * polar))
    return points[best], inwards[best]


def _pockets(space: FreeSpace) -> list[np.ndarray]:
    """At most three places of the fluid that are farthest from everything, 35 mm apart."""
    roomy = space.clearance * (space.clearance == maximum_filter(space.clearance, 7))
    order = np.argsort(roomy, axis=None)[::-1][:200]
    order = order[roomy.ravel()[order] > 1.6 * JELLY_MM]
    pockets: list[np.ndarray] = []
    for point in space.points.reshape(-1, 3)[order]:
        if len(pockets) < 3 and all(np.linalg.norm(point - other) > 35.0 for other in pockets):
            pockets.append(point)
    return pockets


def _by_way_of(space: FreeSpace, stops: list[np.ndarray]) -> np.ndarray:
    """Shortest way from stop to stop through wide fluid, which also avoids its own earlier parts; (n, 3) mm."""
    points = space.points
    clearance = space.clearance.copy()
    legs = []
    for start, end in pairwise(stops):
        spare = clearance - JELLY_MM - ROOM_MM
        cost = np.where(spare > 0.0, 1.0 + (6.0 / np.maximum(spare, 0.5)) ** 2, _BLOCKED)
        ends = [tuple(np.rint((p - space.first) / PITCH_MM).astype(int)) for p in (start, end)]
        cells = np.array(route_through_array(cost, *ends, geometric=True)[0])
        leg = points[tuple(cells.T)]
        legs.append(leg)
        passed = np.ones(clearance.shape, bool)
        passed[tuple(cells[np.linalg.norm(leg - end, axis=1) > 12.0].T)] = False
        clearance = np.minimum(clearance, distance_transform_edt(passed, PITCH_MM) - JELLY_MM)
    return np.concatenate(legs)


def _relaxed(space: FreeSpace, path: np.ndarray) -> np.ndarray:
    """The path tightened and pushed away from everything; its first two points and its last one stay. (n, 3) mm."""
    length = arc_length(path)
    is_new = np.r_[True, np.diff(length) > 1e-6]
    path, length = path[is_new], length[is_new]
    arc = np.linspace(0.0, length[-1], round(length[-1] / SPACING_MM))
    moving = interpolated(arc, length, path)
    slope = np.stack(np.gradient(space.clearance, PITCH_MM))
    far = np.abs(arc[:, None] - arc) > 5.0 * SPACING_MM
    free = ((arc > length[1] + 1.0) & (arc < length[-1] - 1.0))[:, None]
    inside = np.clip(np.minimum(arc - length[2], length[-2] - arc) / 14.0, 0.0, 1.0)[:, None]  # 0 at both ends
    for _ in range(150):
        pull = np.zeros_like(moving)
        pull[1:-1] = (moving[:-2] + moving[2:]) / 2.0 - moving[1:-1]
        bend = np.zeros_like(moving)
        bend[2:-2] = (4.0 * (moving[1:-3] + moving[3:-1]) - moving[:-4] - moving[4:]) / 6.0 - moving[2:-2]
        index = ((moving - space.first) / PITCH_MM).T
        away = np.stack([map_coordinates(part, index, order=1, mode="nearest") for part in slope], axis=1)
        narrow = np.clip(JELLY_MM + 3.0 - space.clearance_at(moving), 0.0, 6.0)[:, None]
        apart = moving[:, None] - moving
        distance = np.maximum(np.linalg.norm(apart, axis=2), 1e-6)
        push = np.where(far, np.clip(2.0 * JELLY_MM + 4.0 - distance, 0.0, 6.0), 0.0)
        aside = (push[:, :, None] * apart / distance[:, :, None]).sum(axis=1)
        moving = moving + free * (0.15 * pull + 0.35 * bend + 0.25 * inside * narrow * away + 0.15 * aside)
    return moving


def _room(space: FreeSpace, path: np.ndarray) -> float:
    """The least distance from the cord's surface to other things or to itself, mm; negative where it bends too much."""
    fine = smooth_path(path, 3 * len(path))
    arc = arc_length(fine)
    outside = (arc > 20.0) & (arc < arc[-1] - 21.0)
    from_others = float(space.clearance_at(fine[outside]).min()) - JELLY_MM
    far = np.abs(arc[:, None] - arc) > np.pi * JELLY_MM
    from_itself = float(np.linalg.norm(fine[:, None] - fine, axis=2)[far].min()) - 2.0 * JELLY_MM
    tangent = np.gradient(fine, arc, axis=0)
    sharpest = float(np.linalg.norm(np.gradient(tangent, arc, axis=0), axis=1).max())
    return min(from_others, from_itself, 1.0 / sharpest - 1.2 * JELLY_MM)


def umbilical_cord(scale: float, path: np.ndarray) -> list[Part]:
    """Jelly, vessel walls and blood of a cord whose middle line is `path` (n, 3), from the fetus to the placenta."""
    length = arc_length(path)
    arc = np.linspace(0.0, length[-1], max(24, round(length[-1] / min(1.1 * scale, 2.2))))
    path = interpolated(arc, length, path)
    first, second = frames(path, (0.0, 0.0, 1.0))
    walls, lumens = [], []
    for start_deg, off_axis_mm, radius in VESSELS:
        angle = (np.deg2rad(start_deg) + 2.0 * np.pi * arc / WIND_MM)[:, None]
        winding = path + off_axis_mm * (np.cos(angle) * first + np.sin(angle) * second)
        sides = max(3, round(12 / scale))
        walls.append(tube(winding[1:-1], np.full(len(path) - 2, radius + WALL_MM), sides))
        lumens.append(tube(winding[2:-2], np.full(len(path) - 4, radius), sides))
    jelly = joined([tube(path, np.full(len(path), JELLY_MM), max(5, round(20 / scale)))], "umbilical cord")
    return [
        Part(jelly, "wharton_jelly"),
        Part(joined(walls, "cord vessel walls"), "vessel_wall"),
        Part(joined(lumens, "cord vessels"), "blood"),
    ]
