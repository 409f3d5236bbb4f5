"""The path tracer as anybody would write it first: one ray at a time, in plain Python, through every triangle.

`transport/advance.py` does the same for all rays of a frame at once, compiled, with Embree. A test finds equal echoes
with both, tests/ultrasound/test_plain_tracing.py. The reasons of the constants are in `transport/bounce.py`, and the
equations in docs/simulator.md, sections 5 and 6. Left out here are the illumination, `depth_mode=time_of_flight`, and
that a smaller part of the reflected rays is followed where there are more than 16 on a scanline.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ablate.anatomy import Scene, Tissue
from ablate.ultrasound.media import loss_db_mm
from ablate.ultrasound.transport.bounce import (
    FARTHEST_MM,
    IN_BEAM_MM,
    MOST_ASIDE_DB,
    RECEIVE_SIGMA_MM,
    REVERBERATION_SHARE,
    ROULETTE_REFLECTIONS,
    SHARED_FROM_GROWTH,
    SMALLEST_REFLECTION,
    SPLIT_REFLECTIONS,
)
from ablate.ultrasound.transport.rays import Drawn

_BEYOND_MM = 1e-5  # a ray looks for its next surface from here on


@dataclass(frozen=True)
class Ray:
    """A ray at its last surface, or at the probe; vectors are (3,) float64."""

    origin: np.ndarray
    direction: np.ndarray
    inside: frozenset[int]  # the structures that it is inside of
    weight: float = 1.0  # two-way amplitude without losses
    growth: float = 1.0  # of the weights of all rays that come of a reflected one
    path_mm: float = 0.0
    loss_db: float = 0.0  # one way
    interfaces: int = 0
    reflections: int = 0


class Echo(NamedTuple):
    """What an element receives from a surface, along one ray."""

    depth_mm: float
    amplitude: float
    clutter: bool  # of a ray that had been reflected before, or had left its beam


@dataclass(frozen=True)
class Scanline:
    """The element that sends and receives, the axis along which it does so, and how deep and faint it is followed."""

    element: np.ndarray
    axis: np.ndarray
    frequency_mhz: float
    depth_mm: float
    roulette_db: float  # level at which Russian roulette begins


def trace(scene: Scene, line: Scanline, first: Ray, draw: Callable[[int], Drawn]) -> list[Echo]:
    """The echoes of a ray and of all rays that come of it.

    Parameters
    ----------
    scene : Scene
        What it travels through.
    line : Scanline
        What it belongs to.
    first : Ray
        The ray as it leaves the probe.
    draw : callable
        Random numbers of this ray, given how many interfaces it has met.
    """
    echoes: list[Echo] = []
    under_way = [first]
    while under_way:
        ray = under_way.pop()
        hit = first_surface(scene, ray, reach(line, ray))
        if hit is None:
            continue
        distance_mm, structure, normal = hit
        before = tissue_at(scene, ray.inside)
        ray = replace(
            ray,
            origin=ray.origin + distance_mm * ray.direction,
            path_mm=ray.path_mm + distance_mm,
            loss_db=ray.loss_db + distance_mm * loss_db_mm(before, line.frequency_mhz),
        )
        crossed = ray.inside ^ {structure}  # whatever the mesh's winding says
        behind = tissue_at(scene, crossed)
        if (before.speed_m_s, before.impedance_mrayl) == (behind.speed_m_s, behind.impedance_mrayl):
            under_way.append(replace(ray, inside=crossed))
            continue
        drawn = draw(ray.interfaces)
        surface = scene.structures[structure].tissue
        back, onward, pressure = scatter(ray.direction, normal, before, behind, surface.roughness, drawn)
        thickness_mm = drawn.thickness * surface.thickness_mm  # how far behind its surface a structure reflects
        thickness_db = thickness_mm * loss_db_mm(before, line.frequency_mhz)
        depth_mm, loss_db, aside_db, clutter = way_back(line, first, ray)
        loss_db += 2 * thickness_db
        if depth_mm + thickness_mm < line.depth_mm:
            to_element = line.element - ray.origin
            cosine = max(float(back @ to_element) / float(np.linalg.norm(to_element)), 0.0)
            amplitude = ray.weight * abs(pressure) * cosine**surface.specularity * 10 ** (-(loss_db + aside_db) / 20)
            if amplitude > 0:
                echoes.append(Echo(depth_mm + thickness_mm, amplitude, clutter))
        if depth_mm >= line.depth_mm:
            continue
        faint_db = loss_db + min(aside_db, MOST_ASIDE_DB) + line.roulette_db
        back_weight, onward_weight, growth = share(ray, pressure, drawn, faint_db)
        ray = replace(ray, interfaces=ray.interfaces + 1, growth=growth)
        if back_weight > 0:
            reflected = replace(ray, direction=back, weight=back_weight, reflections=ray.reflections + 1)
            path_mm, one_way_db = ray.path_mm + 2 * thickness_mm, ray.loss_db + 2 * thickness_db
            under_way.append(replace(reflected, path_mm=path_mm, loss_db=one_way_db))
        if onward_weight > 0:
            under_way.append(replace(ray, direction=onward, weight=onward_weight, inside=crossed))
    return echoes


def tissue_at(scene: Scene, inside: frozenset[int]) -> Tissue:
    """Where structures overlap, the last one owns the point."""
    return scene.structures[max(inside)].tissue if inside else scene.background


def reach(line: Scanline, ray: Ray) -> float:
    """How far a ray is followed, mm: to the end of the image; a reflected one not out of its scanline's cylinder."""
    if ray.reflections == 0:
        return line.depth_mm - ray.path_mm
    outside = across(ray.origin - line.element, line.axis)
    ahead = across(ray.direction, line.axis)
    a, b, c = ahead @ ahead, outside @ ahead, outside @ outside - FARTHEST_MM**2
    leaves_mm = (np.sqrt(b * b - a * c) - b) / a if c < 0 else 0.0
    return float(min(2 * line.depth_mm - ray.path_mm, leaves_mm))  # down and up again


def across(vector: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """The part of a vector that is perpendicular to an axis."""
    return vector - (vector @ axis) * axis


def first_surface(scene: Scene, ray: Ray, reach_mm: float) -> tuple[float, int, np.ndarray] | None:
    """Distance, structure and unit normal of the first triangle that a ray meets (Moeller and Trumbore 1997)."""
    found = None
    for number, structure in enumerate(scene.structures):
        corner, second, third = np.moveaxis(np.asarray(structure.mesh.triangles), 1, 0)
        one, two, from_corner = second - corner, third - corner, ray.origin - corner
        p, q = np.cross(ray.direction, two), np.cross(from_corner, one)
        determinant = (one * p).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = (from_corner * p).sum(axis=1) / determinant
            v = (q @ ray.direction) / determinant
            distance = (q * two).sum(axis=1) / determinant
        met = (u >= 0) & (v >= 0) & (u + v <= 1) & (distance > _BEYOND_MM) & (distance < reach_mm)
        if met.any():
            nearest = int(np.argmin(np.where(met, distance, np.inf)))
            reach_mm = float(distance[nearest])
            found = reach_mm, number, np.asarray(structure.mesh.face_normals[nearest])
    return found


def scatter(
    direction: np.ndarray, normal: np.ndarray, before: Tissue, behind: Tissue, roughness: float, drawn: Drawn
) -> tuple[np.ndarray, np.ndarray, float]:
    """Directions of the reflected and of the transmitted ray, and the reflection coefficient R_p of pressure."""
    normal = -normal if normal @ direction > 0 else normal
    cos_tilt = np.exp(drawn.log_u * roughness / (1 + roughness))  # a power-cosine lobe of normals
    sin_tilt = np.sqrt(max(1 - cos_tilt**2, 0.0))
    one_side, other_side = frame_about(normal)
    tilted = cos_tilt * normal + sin_tilt * (drawn.cos_azimuth * one_side + drawn.sin_azimuth * other_side)
    for facet in (tilted, normal):  # the surface's own where a direction is on the wrong side of it
        cos_i = -float(direction @ facet)
        back = direction + 2 * cos_i * facet
        ratio = behind.speed_m_s / before.speed_m_s
        sine_squared = ratio**2 * (1 - cos_i**2)  # Snell's law
        total = sine_squared >= 1
        cos_t = np.sqrt(max(1 - sine_squared, 0.0))
        onward = ratio * direction + (ratio * cos_i - cos_t) * facet
        if cos_i > 0 and back @ normal > 0 and (total or onward @ normal < 0):
            break
    one, two = before.impedance_mrayl * cos_t, behind.impedance_mrayl * cos_i
    return back, onward, 1.0 if total else float((two - one) / (two + one))


def frame_about(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors that are perpendicular to a normal and to each other (Duff et al. 2017)."""
    x, y, z = normal
    sign = np.copysign(1.0, z)
    a = -1 / (sign + z)
    one = np.array([1 + sign * x * x * a, sign * x * y * a, -sign * x])
    return one, np.array([x * y * a, sign + y * y * a, -y])


def way_back(line: Scanline, first: Ray, ray: Ray) -> tuple[float, float, float, bool]:
    """Of an echo: depth in mm; how much fainter it is for the loss and for its direction, dB; whether it is clutter."""
    if ray.reflections == 0:  # back on the same way; one that surfaces bent out of its beam is out of phase
        aside_mm = float(np.linalg.norm(across(ray.origin - first.origin, first.direction)))
        clutter = aside_mm >= IN_BEAM_MM
        aside_db = 10 / np.log(10) * (aside_mm / IN_BEAM_MM) ** 2 if clutter else 0.0
        return ray.path_mm, 2 * ray.loss_db, aside_db, clutter
    straight_mm = float(np.linalg.norm(line.element - ray.origin))
    ways = 1 + straight_mm / ray.path_mm
    aside_mm = float(np.linalg.norm(across(ray.origin - line.element, line.axis)))
    aside_db = 10 / np.log(10) * (aside_mm / RECEIVE_SIGMA_MM) ** 2
    return ray.path_mm * ways / 2, ray.loss_db * ways, aside_db, True


def share(ray: Ray, pressure: float, drawn: Drawn, faint_db: float) -> tuple[float, float, float]:
    """Weights of the reflected and of the transmitted ray, 0 where there is none, and the growth of both."""
    back, through, growth = abs(pressure), 1 - pressure**2, ray.growth
    reflects = back >= SMALLEST_REFLECTION
    if ray.reflections > 0 and reflects:
        through = 1 - back if growth >= SHARED_FROM_GROWTH else through
        growth *= back + through
    back, through = ray.weight * back, ray.weight * through
    if ray.reflections <= SPLIT_REFLECTIONS:  # both go on
        followed = REVERBERATION_SHARE if ray.reflections == 0 else 1.0
        back = roulette(back, drawn.choice, faint_db, followed) if reflects else 0.0
        if ray.reflections > 0:
            through = roulette(through, drawn.survival, faint_db, 1.0)
        return back, through, growth
    probability = abs(pressure) if reflects else 0.0
    if drawn.choice < probability:
        followed = 0.5 if ray.reflections >= ROULETTE_REFLECTIONS else 1.0
        return roulette(back / probability, drawn.survival, faint_db, followed), 0.0, growth
    return 0.0, roulette(through / (1 - probability), drawn.survival, faint_db, 1.0), growth


def roulette(weight: float, luck: float, faint_db: float, at_most: float) -> float:
    """End a faint ray at random, or give it the weight of those that ended: the mean stays."""
    survival = min(weight * 10 ** (-faint_db / 20), at_most)
    return weight / survival if luck < survival else 0.0
