"""Monte-Carlo transport: rays that meet surfaces, echo there, and are reflected or transmitted.

The weight of a ray is a two-way amplitude. It is reflected with probability R = R_p^2, else transmitted, and its
weight stays: the expectation through an interface is then 1 - R = t12 t21, and off it R_p R_p, both exactly what a
pulse keeps on its way there and back.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ablate.ultrasound import draws as column
from ablate.ultrasound.bundle import Bundle
from ablate.ultrasound.draws import Draws
from ablate.ultrasound.embree import Geometry, Hits
from ablate.ultrasound.interfaces import (
    dot,
    facing,
    mirrored,
    pressure_reflection,
    refracted,
    rough_normal,
    transmission_cosine,
)
from ablate.ultrasound.media import Media
from ablate.ultrasound.ownership import next_step, owner, toggle
from ablate.ultrasound.rays import Descent, Echoes, Rays, piece, start_rays

Record = TypeVar("Record", Echoes, Descent)

#: From this many reflections on, half of the rays end at each further one and the others count twice.
PATIENT_REFLECTIONS = 3

#: A scanline listens along its axis: echoes of reflected rays fall off with the distance from it as a Gaussian of
#: this standard deviation (assumed). Twice the aperture, so that reverberation between layers is hardly touched.
LISTENING_MM = 6.0


@dataclass(frozen=True)
class Surroundings:
    """What rays travel through.

    Attributes
    ----------
    geometry : Geometry
    media : Media
    tissue_of_owner : (structures + 1,) uint8
    draws : Draws
    depth_mm : float
        Of the image; an echo that would be drawn deeper is not followed.
    faintest_db : float
        Reflected rays whose two-way amplitude is under this are ended by roulette.
    """

    geometry: Geometry
    media: Media
    tissue_of_owner: np.ndarray
    draws: Draws
    depth_mm: float
    faintest_db: float


@dataclass(frozen=True)
class Scattered:
    """What a surface makes of rays that meet it: directions back and onward (n, 3), and R_p (n,)."""

    back: np.ndarray
    onward: np.ndarray
    pressure: np.ndarray


def trace(around: Surroundings, bundle: Bundle) -> tuple[Echoes, Descent]:
    """Follow all rays of a frame until they are deeper than the image.

    Parameters
    ----------
    around : Surroundings
    bundle : Bundle

    Returns
    -------
    Echoes, Descent
    """
    media = around.media
    elements, axes = bundle.starts.astype(np.float32), bundle.directions.astype(np.float32)
    rays = start_rays(bundle, around.tissue_of_owner)
    echoes, descent = [_no_echoes()], [piece(rays, media)]
    while rays.number.size:
        ways = np.where(rays.reflections > 0, np.float32(2), np.float32(1))  # a turned ray goes down and up again
        left_mm = (ways * np.float32(around.depth_mm) - rays.shown_mm) / media.stretch[rays.medium]
        beyond = rays.origin + rays.step_mm[:, None] * rays.direction
        hits = around.geometry.closest(beyond, rays.direction, left_mm)
        found = np.flatnonzero(hits.structure >= 0)
        rays, hits = rays.take(found), hits.take(found)
        rays.advance(hits.distance_mm + rays.step_mm, media)
        fresh = (hits.structure != rays.structure) | (hits.triangle != rays.triangle)  # a plane is met only once
        rays.structure, rays.triangle = hits.structure, hits.triangle
        rays.step_mm = next_step(rays.step_mm, fresh, around.geometry)
        inside = np.where(fresh[:, None], toggle(rays.inside, hits.structure), rays.inside)
        medium = np.where(fresh, around.tissue_of_owner[owner(inside)], rays.medium)
        met = media.differs[rays.medium, medium]

        across = np.flatnonzero(~met)  # nothing to see: go straight on
        changed = across[(medium[across] != rays.medium[across]) & (rays.reflections[across] == 0)]
        rays.inside[across], rays.medium[across] = inside[across], medium[across]
        descent.append(piece(rays.take(changed), media))

        at = np.flatnonzero(met)
        if at.size:
            meeting = rays.take(at)
            direct = np.flatnonzero(meeting.reflections == 0)
            heard, alive = _meet(meeting, hits.take(at), inside[at], medium[at], (elements, axes), around)
            echoes.append(heard)
            descent.append(piece(meeting.take(direct), media, ended=meeting.reflections[direct] > 0))
            rays.put(at, meeting)
            if not alive.all():
                rays = rays.take(np.delete(np.arange(len(met)), at[~alive]))
    return _joined(echoes), _joined(descent)


def _meet(
    rays: Rays,
    hits: Hits,
    inside: np.ndarray,
    medium: np.ndarray,
    scanlines: tuple[np.ndarray, np.ndarray],
    around: Surroundings,
) -> tuple[Echoes, np.ndarray]:
    """Echo at an interface, then reflect or transmit: changes `rays`; also returns which of them go on."""
    media = around.media
    drawn = around.draws.at(rays.interfaces, rays.number)
    surface = around.tissue_of_owner[hits.structure + 1]
    scattered = _scatter(rays, hits, medium, surface, drawn, media)
    thickness = drawn[:, column.THICKNESS] * media.thickness_mm[surface] if media.thick else np.float32(0)

    group = rays.number // around.draws.rays
    elements, axes = scanlines
    to_element = elements[group] - rays.origin
    way_back = np.maximum(np.sqrt(dot(to_element, to_element)), np.float32(1e-6))
    reflected = rays.reflections > 0
    # A reflected ray's way back to its element is not its way there; its loss is taken in proportion to length.
    back = np.where(reflected, way_back / np.maximum(rays.path_mm, np.float32(1e-6)), np.float32(1))
    middle_mm = rays.shown_mm * (1 + back) / 2
    depth_mm = middle_mm + thickness * media.stretch[rays.medium]
    two_way_db = rays.loss_db * (1 + back) + 2 * thickness * media.loss_db_mm[rays.medium]
    lobe = np.maximum(dot(scattered.back, to_element) / way_back, 0) ** media.specularity[surface]
    amplitude = rays.weight * np.abs(scattered.pressure) * lobe * 10 ** (-two_way_db / 20)
    off_axis_2 = np.maximum(way_back**2 - dot(to_element, axes[group]) ** 2, 0)
    amplitude *= np.where(reflected, np.exp(-0.5 * off_axis_2 / LISTENING_MM**2), np.float32(1))
    heard = np.flatnonzero((amplitude > 0) & (depth_mm < around.depth_mm))
    echoes = Echoes(group[heard], depth_mm[heard], amplitude[heard], reflected[heard])

    turned = drawn[:, column.CHOICE] < scattered.pressure**2
    if media.thick:  # into the surface's thickness and out again
        rays.lengthen(2 * thickness * turned, media)
    rays.direction = np.where(turned[:, None], scattered.back, scattered.onward)
    rays.inside = np.where(turned[:, None], rays.inside, inside)
    rays.medium = np.where(turned, rays.medium, medium)
    rays.interfaces += 1
    rays.reflections += turned
    survives = _roulette(rays, turned, two_way_db, drawn[:, column.SURVIVAL], around.faintest_db)
    return echoes, survives & (middle_mm < around.depth_mm)


def _scatter(
    rays: Rays, hits: Hits, medium: np.ndarray, surface: np.ndarray, drawn: np.ndarray, media: Media
) -> Scattered:
    """Reflect and refract about a rough normal, or about the surface's own where the rough one cannot be."""
    flat = facing(hits.normal, rays.direction)
    if not media.rough:
        return _about(rays.direction, flat, rays.medium, medium, media)[0]
    normal = rough_normal(
        flat,
        drawn[:, column.LOG_U],
        drawn[:, column.COS_AZIMUTH],
        drawn[:, column.SIN_AZIMUTH],
        media.lobe_exponent[surface],
    )
    scattered, cos_i, total = _about(rays.direction, normal, rays.medium, medium, media)
    wrong = (cos_i <= 0) | (dot(scattered.back, flat) <= 0) | (~total & (dot(scattered.onward, flat) >= 0))
    redo = np.flatnonzero(wrong)
    if redo.size:
        again, _, _ = _about(rays.direction[redo], flat[redo], rays.medium[redo], medium[redo], media)
        scattered.back[redo], scattered.onward[redo] = again.back, again.onward
        scattered.pressure[redo] = again.pressure
    return scattered


def _about(
    direction: np.ndarray, normal: np.ndarray, before: np.ndarray, after: np.ndarray, media: Media
) -> tuple[Scattered, np.ndarray, np.ndarray]:
    """Mirror, Snell and Fresnel about given normals; also cos i and where the reflection is total."""
    cos_i = -dot(direction, normal)
    if media.refracts:
        speed_1, speed_2 = media.speed_m_s[before], media.speed_m_s[after]
        cos_t = transmission_cosine(cos_i, speed_1, speed_2)
        onward = refracted(direction, normal, cos_i, cos_t, speed_2 / speed_1)
    else:
        cos_t, onward = cos_i, direction.copy()
    pressure = pressure_reflection(media.impedance_mrayl[before], media.impedance_mrayl[after], cos_i, cos_t)
    return Scattered(mirrored(direction, normal, cos_i), onward, pressure), cos_i, cos_t == 0


def _roulette(
    rays: Rays, turned: np.ndarray, two_way_db: np.ndarray, uniform: np.ndarray, faintest_db: float
) -> np.ndarray:
    """End faint or often turned rays without bias: survivors' weights grow by what their chance was."""
    level_db = 20 * np.log10(np.maximum(rays.weight, np.float32(1e-30))) - two_way_db
    chance = np.minimum(np.float32(1), 10 ** ((level_db - faintest_db) / 20))
    chance = np.where(turned & (rays.reflections > PATIENT_REFLECTIONS), np.minimum(chance, 0.5), chance)
    chance = np.where(rays.reflections > 0, chance, np.float32(1)).astype(np.float32)
    rays.weight = rays.weight / np.maximum(chance, np.float32(1e-30))
    return uniform < chance


def _no_echoes() -> Echoes:
    nothing = np.empty(0, np.float32)
    return Echoes(np.empty(0, np.int32), nothing, nothing, np.empty(0, bool))


def _joined(parts: list[Record]) -> Record:
    columns = zip(*(vars(part).values() for part in parts), strict=True)
    return type(parts[0])(*(np.concatenate(column) for column in columns))
