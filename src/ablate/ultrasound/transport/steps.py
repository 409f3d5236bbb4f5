"""Steps that every walker of a ray takes: look ahead, cross the surface that it meets, see what lies on both sides.

A ray is a row of an array of RAY or of LINE: functions are compiled for the fields that they are given. Sets of
structures are as in `line_walk`.
"""

import math

import numpy as np

from ablate.ultrasound.compiled import Vector, compiled, step
from ablate.ultrasound.media import Media, Medium, Surface
from ablate.ultrasound.surfaces.embree import PACKET, Asked, Hit, Packet, ask_together, closest_of, hit_of
from ablate.ultrasound.transport.bounce import IN_BEAM_MM, aside
from ablate.ultrasound.transport.rays import Ray
from ablate.ultrasound.transport.scattering import Interface, along


@step
def origin_of(ray: Ray) -> Vector:
    """Where a ray looks for its next surface from."""
    return float(ray.origin[0]), float(ray.origin[1]), float(ray.origin[2])


@step
def direction_of(ray: Ray) -> Vector:
    """Its direction, of unit length."""
    return float(ray.direction[0]), float(ray.direction[1]), float(ray.direction[2])


@step
def look_ahead(embree: tuple[int, Asked], ray: Ray) -> Hit:
    """The next surface of a ray, within its reach, by the geometry's address and room to ask for it."""
    address, asked = embree
    return closest_of(address, asked, origin_of(ray), direction_of(ray), ray.reach_mm)


@compiled
def direct_rays(rays: np.ndarray, n: int) -> int:
    """How many of the rays are direct: they come first."""
    for i in range(n):
        if rays[i].reflections > 0:
            return i
    return n


@step
def next_hit(embree: tuple[int, Asked, Packet], rays: np.ndarray, i: int, together: int) -> Hit:
    """The next surface of a ray; one of the first rays is asked for with its neighbours, at the first of their packet.

    Parameters
    ----------
    embree : tuple of int, Asked and Packet
        As in `advance.advance`.
    rays : (n,) RAY
        All that advance.
    i : int
        The ray's number.
    together : int
        How many of the first rays are asked for in packets; 0 where a processor has none.
    """
    address, asked, packet = embree
    if i >= together:
        return look_ahead((address, asked), rays[i])
    if i % PACKET == 0:
        ask_together(address, packet, rays, i, min(PACKET, together - i))
    return hit_of(packet, i % PACKET)


@step
def length_ahead(ray: Ray, hit: Hit) -> float:
    """From a ray's last surface to its next one, mm; infinite where there is none."""
    return hit.distance_mm + ray.step_mm if hit.structure >= 0 else math.inf


@step
def goes_astray(ray: Ray, hit: Hit, start: Vector, straight: Vector) -> bool:
    """Whether a ray is out of its beam before its next surface or the end of its reach: it is farthest off at an end.

    Bone bends rays out of the body. Such a ray loses nothing in the anechoic background and would fill the shadow
    behind the bone, so it insonifies no scanline there that is in the body.

    Parameters
    ----------
    ray : Ray
        As it looks for its next surface.
    hit : Hit
        That surface.
    start, straight : tuple of three float
        Of the ray's straight way: mm, and a unit vector.
    """
    to_mm = hit.distance_mm if hit.structure >= 0 else ray.reach_mm
    origin = origin_of(ray)
    end = along(origin, direction_of(ray), to_mm)
    return max(aside(origin, start, straight), aside(end, start, straight)) > IN_BEAM_MM**2


@step
def medium_of(media: Media, tissue: int) -> Medium:
    """What a ray needs of the tissue that it is in."""
    return Medium(float(media.loss_db_mm[tissue]), float(media.stretch[tissue]), media.anechoic[tissue])


@step
def surface_of(media: Media, tissue: int) -> Surface:
    """What a ray needs of the surface of a structure of this tissue."""
    return Surface(media.lobe_exponent[tissue], media.specularity[tissue], media.thickness_mm[tissue])


@step
def interface_of(media: Media, tissue: int, beyond: int) -> Interface:
    """The surface between two tissues."""
    return Interface(
        float(media.speed_m_s[tissue]),
        float(media.speed_m_s[beyond]),
        float(media.impedance_mrayl[tissue]),
        float(media.impedance_mrayl[beyond]),
        media.refracts,
    )


@step
def is_fresh(ray: Ray, hit: Hit) -> bool:
    """Whether a surface is another than the last one: a plane is met only once."""
    return hit.structure != ray.structure or hit.triangle != ray.triangle


@step
def move_up(ray: Ray, hit: Hit, medium: Medium, least_step_mm: float) -> float:
    """Put a ray at the surface that it has met.

    Parameters
    ----------
    ray : Ray
        Is changed.
    hit : Hit
        The surface.
    medium : Medium
        What it went through.
    least_step_mm : float
        From a surface to where the search for the next one begins.

    Returns
    -------
    float
        How far beyond this surface it is to look for the next one, mm. Twice as far each time that it has not got away,
        from the same triangle or from one as near: it would run along a surface in steps of a tenth of a micrometre.
    """
    away = is_fresh(ray, hit) and hit.distance_mm > ray.step_mm
    step_mm = least_step_mm if away else max(2 * ray.step_mm, least_step_mm)
    length_mm = hit.distance_mm + ray.step_mm
    ray.path_mm += length_mm
    ray.displayed_mm += length_mm * medium.stretch
    ray.loss_db += length_mm * medium.loss_db_mm
    ray.structure = hit.structure
    ray.triangle = hit.triangle
    ray.step_mm = step_mm
    return step_mm
