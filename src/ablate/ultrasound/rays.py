"""Monte-Carlo transport: rays that meet surfaces, echo there, and are reflected or transmitted.

The weight of a ray is a two-way amplitude. It is reflected with probability R = R_p^2, else transmitted, and its
weight stays: the expectation through an interface is then 1 - R = t12 t21, and off it R_p R_p, both exactly what a
pulse keeps on its way there and back.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

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
from ablate.ultrasound.ownership import owner, toggle

#: Loss that stands for "no sound at all", dB: finite, so that no sum or interpolation of it is NaN.
SILENT_DB = 1e9
#: From this many reflections on, half of the rays end at each further one and the others count twice.
PATIENT_REFLECTIONS = 3


@dataclass
class Rays:
    """Rays under way; one row a ray, float32 unless said otherwise."""

    number: np.ndarray  # int32, of all rays of the frame
    origin: np.ndarray  # (n, 3) mm
    direction: np.ndarray  # (n, 3)
    inside: np.ndarray  # (n, words) uint32
    medium: np.ndarray  # int32, index of the tissue
    path_mm: np.ndarray  # geometric length so far
    shown_mm: np.ndarray  # the same as displayed
    loss_db: np.ndarray  # one way
    weight: np.ndarray
    interfaces: np.ndarray  # int32, met so far
    reflections: np.ndarray  # int32
    structure: np.ndarray  # int32, of the last hit
    triangle: np.ndarray  # int32

    def take(self, chosen: np.ndarray) -> Rays:
        return Rays(*(getattr(self, field.name)[chosen] for field in fields(self)))


@dataclass(frozen=True)
class Echoes:
    """What came back from surfaces; depths in displayed mm, amplitudes per ray."""

    group: np.ndarray
    depth_mm: np.ndarray
    amplitude: np.ndarray
    reflected: np.ndarray


@dataclass(frozen=True)
class Descent:
    """Loss along the rays that were never reflected, as pieces of straight lines: loss_db + slope (z - shown).

    Every ray has a first piece at 0; a piece lasts until the ray's next one. Within a ray, depth never falls.
    """

    ray: np.ndarray
    shown_mm: np.ndarray
    loss_db: np.ndarray
    slope_db_mm: np.ndarray


def trace(
    geometry: Geometry,
    media: Media,
    tissue_of_owner: np.ndarray,
    bundle: Bundle,
    draws: Draws,
    depth_mm: float,
    faintest_db: float,
) -> tuple[Echoes, Descent]:
    """Follow all rays of a frame until they are deeper than the image.

    Parameters
    ----------
    geometry : Geometry
    media : Media
    tissue_of_owner : (structures + 1,) uint8
    bundle : Bundle
    draws : Draws
    depth_mm : float
    faintest_db : float
        Reflected rays with a two-way amplitude under this are ended by roulette.

    Returns
    -------
    Echoes, Descent
    """
    rays = _start(bundle, tissue_of_owner)
    descent = [_piece(rays, media)]
    echoes: list[tuple[np.ndarray, ...]] = []
    step = np.float32(0)  # beyond the surface just met; its length is part of the way
    while rays.number.size:
        way = np.where(rays.reflections > 0, np.float32(2 * depth_mm), np.float32(depth_mm)) - rays.shown_mm
        beyond = rays.origin + step * rays.direction
        hits = geometry.closest(beyond, rays.direction, way / media.stretch[rays.medium])
        found = np.flatnonzero(hits.structure >= 0)
        if not found.size:
            break
        rays, hits = rays.take(found), hits.take(found)
        _advance(rays, hits.distance_mm + step, media)
        fresh = (hits.structure != rays.structure) | (hits.triangle != rays.triangle)
        rays.structure, rays.triangle = hits.structure, hits.triangle
        inside = np.where(fresh[:, None], toggle(rays.inside, hits.structure), rays.inside)
        medium = np.where(fresh, tissue_of_owner[owner(inside)], rays.medium)
        met = media.differs[rays.medium, medium]
        across = np.flatnonzero(~met)
        _cross(rays, across, inside, medium, media, descent)
        at = np.flatnonzero(met)
        alive = np.ones(len(fresh), bool)
        if at.size:
            alive[at] = _meet(
                rays,
                at,
                hits.take(at),
                inside[at],
                medium[at],
                media,
                tissue_of_owner,
                bundle,
                draws,
                depth_mm,
                faintest_db,
                echoes,
                descent,
            )
        step = np.float32(geometry.step_mm)
        if not alive.all():
            rays = rays.take(alive)
    return _gather_echoes(echoes), Descent(*(np.concatenate(part) for part in zip(*descent, strict=True)))


def _start(bundle: Bundle, tissue_of_owner: np.ndarray) -> Rays:
    n = len(bundle.origins)

    def filled(value: float, kind: type) -> np.ndarray:
        return np.full(n, value, kind)

    return Rays(
        number=np.arange(n, dtype=np.int32),
        origin=bundle.origins.copy(),
        direction=bundle.ray_directions.copy(),
        inside=bundle.inside.copy(),
        medium=tissue_of_owner[owner(bundle.inside)].astype(np.int32),
        path_mm=filled(0, np.float32),
        shown_mm=filled(0, np.float32),
        loss_db=filled(0, np.float32),
        weight=filled(1, np.float32),
        interfaces=filled(0, np.int32),
        reflections=filled(0, np.int32),
        structure=filled(-1, np.int32),
        triangle=filled(-1, np.int32),
    )


def _piece(rays: Rays, media: Media) -> tuple[np.ndarray, ...]:
    slope = media.loss_db_mm[rays.medium] / media.stretch[rays.medium]
    return rays.number, rays.shown_mm, rays.loss_db, slope


def _advance(rays: Rays, distance_mm: np.ndarray, media: Media) -> None:
    """Move every ray along its way."""
    rays.origin += distance_mm[:, None] * rays.direction
    rays.path_mm += distance_mm
    rays.shown_mm += distance_mm * media.stretch[rays.medium]
    rays.loss_db += distance_mm * media.loss_db_mm[rays.medium]


def _cross(rays: Rays, chosen: np.ndarray, inside: np.ndarray, medium: np.ndarray, media: Media, descent: list) -> None:
    """Go straight on through surfaces that neither reflect nor refract."""
    changed = chosen[(medium[chosen] != rays.medium[chosen]) & (rays.reflections[chosen] == 0)]
    rays.inside[chosen], rays.medium[chosen] = inside[chosen], medium[chosen]
    if changed.size:
        descent.append(_piece(rays.take(changed), media))


def _meet(
    all_rays: Rays, at: np.ndarray, hits: Hits, inside: np.ndarray, medium: np.ndarray, media: Media,
    tissue_of_owner: np.ndarray, bundle: Bundle, draws: Draws, depth_mm: float, faintest_db: float,
    echoes: list, descent: list,
) -> np.ndarray:  # fmt: skip
    """Echo at an interface, then reflect or transmit; writes back into `all_rays`, returns who lives on."""
    rays = all_rays.take(at)
    drawn = draws.at(rays.interfaces, rays.number)
    surface = tissue_of_owner[hits.structure + 1]
    before, after = rays.medium, medium
    flat = facing(hits.normal, rays.direction)
    normal = flat
    if media.rough:
        normal = rough_normal(
            flat, drawn[:, column.LOG_U], drawn[:, column.COS_AZIMUTH], drawn[:, column.SIN_AZIMUTH],
            media.lobe_exponent[surface],
        )  # fmt: skip
    bounce, onward, pressure, wrong = _scatter(rays.direction, normal, flat, before, after, media)
    if media.rough and (redo := np.flatnonzero(wrong)).size:
        bounce[redo], onward[redo], pressure[redo], _ = _scatter(
            rays.direction[redo], flat[redo], flat[redo], before[redo], after[redo], media
        )
    thickness = drawn[:, column.THICKNESS] * media.thickness_mm[surface] if media.thick else np.float32(0)

    group = rays.number // bundle.rays
    to_element = bundle.starts[group].astype(np.float32) - rays.origin
    way_back = np.maximum(np.sqrt(dot(to_element, to_element)), 1e-6)
    reflected = rays.reflections > 0
    # A reflected ray's way back to its element differs from its way there; its loss is scaled by the length.
    back = np.where(reflected, way_back / np.maximum(rays.path_mm, 1e-6), 1)
    mean_shown = rays.shown_mm * (1 + back) / 2
    depth = mean_shown + thickness * media.stretch[before]
    two_way_db = rays.loss_db * (1 + back) + 2 * thickness * media.loss_db_mm[before]
    lobe = np.maximum(dot(bounce, to_element) / way_back, 0) ** media.specularity[surface]
    amplitude = rays.weight * np.abs(pressure) * lobe * 10 ** (-two_way_db / 20)
    heard = np.flatnonzero((amplitude > 0) & (depth < depth_mm))
    echoes.append((group[heard], depth[heard], amplitude[heard], reflected[heard]))

    turned = drawn[:, column.CHOICE] < pressure * pressure
    rays.direction = np.where(turned[:, None], bounce, onward)
    rays.inside = np.where(turned[:, None], rays.inside, inside)
    rays.medium = np.where(turned, before, after)
    rays.path_mm += 2 * thickness * turned  # into the surface's thickness and out again
    rays.shown_mm += 2 * thickness * turned * media.stretch[before]
    rays.loss_db += 2 * thickness * turned * media.loss_db_mm[before]
    rays.interfaces += 1
    rays.reflections += turned
    direct = np.flatnonzero(~reflected)
    if direct.size:
        number, shown, loss, slope = _piece(rays.take(direct), media)
        ended = turned[direct]
        descent.append((number, shown, np.where(ended, SILENT_DB, loss), np.where(ended, 0, slope)))
    alive = mean_shown < depth_mm
    level_db = 20 * np.log10(np.maximum(rays.weight, 1e-30)) - two_way_db
    chance = np.where(rays.reflections > 0, np.minimum(1, 10 ** ((level_db - faintest_db) / 20)), 1)
    chance = np.where(turned & (rays.reflections > PATIENT_REFLECTIONS), np.minimum(chance, 0.5), chance)
    alive &= drawn[:, column.SURVIVAL] < chance
    rays.weight = (rays.weight / np.maximum(chance, 1e-30)).astype(np.float32)
    for field in fields(rays):
        getattr(all_rays, field.name)[at] = getattr(rays, field.name)
    return alive


def _scatter(
    direction: np.ndarray, normal: np.ndarray, flat: np.ndarray, before: np.ndarray, after: np.ndarray,
    media: Media,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Directions of reflection and transmission, R_p, and whether either is on the wrong side of the surface."""
    cos_i = -dot(direction, normal)
    if media.refracts:
        speed_1, speed_2 = media.speed_m_s[before], media.speed_m_s[after]
        cos_t = transmission_cosine(cos_i, speed_1, speed_2)
        onward = refracted(direction, normal, cos_i, cos_t, speed_2 / speed_1)
    else:
        cos_t, onward = cos_i, direction.copy()
    pressure = pressure_reflection(media.impedance_mrayl[before], media.impedance_mrayl[after], cos_i, cos_t)
    bounce = mirrored(direction, normal, cos_i)
    wrong = (cos_i <= 0) | (dot(bounce, flat) <= 0) | ((cos_t > 0) & (dot(onward, flat) >= 0))
    return bounce, onward, pressure, wrong


def _gather_echoes(parts: list[tuple[np.ndarray, ...]]) -> Echoes:
    if not parts:
        nothing = np.empty(0, np.float32)
        return Echoes(nothing.astype(np.int64), nothing, nothing, nothing.astype(bool))
    return Echoes(*(np.concatenate(part) for part in zip(*parts, strict=True)))
