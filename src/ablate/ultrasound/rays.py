"""Rays under way, and what they bring back."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from ablate.ultrasound.bundle import Bundle
from ablate.ultrasound.media import Media
from ablate.ultrasound.ownership import owner

#: Loss that stands for "no sound at all", dB: finite, so that no sum or interpolation of it is NaN.
SILENT_DB = 1e9


@dataclass
class Rays:
    """Rays under way, one row a ray; lengths in mm.

    Attributes
    ----------
    number : (n,) int32
        Among all rays of the frame.
    origin, direction : (n, 3) float32
        Where the ray last met a surface, and where it goes from there.
    inside : (n, words) uint32
        The structures that it is inside of.
    medium : (n,) int32
        Index of the tissue that it goes through.
    path_mm, shown_mm, loss_db : (n,) float32
        So far: length, length as displayed, loss one way.
    weight : (n,) float32
        Two-way amplitude without losses.
    interfaces, reflections : (n,) int32
        How many it has met, and how many turned it back.
    structure, triangle : (n,) int32
        Of the last surface.
    step_mm : (n,) float32
        How far beyond it the ray goes before it looks for the next; that length is part of its way.
    """

    number: np.ndarray
    origin: np.ndarray
    direction: np.ndarray
    inside: np.ndarray
    medium: np.ndarray
    path_mm: np.ndarray
    shown_mm: np.ndarray
    loss_db: np.ndarray
    weight: np.ndarray
    interfaces: np.ndarray
    reflections: np.ndarray
    structure: np.ndarray
    triangle: np.ndarray
    step_mm: np.ndarray

    def take(self, chosen: np.ndarray) -> Rays:
        """Copies of some rays, by index or mask."""
        return Rays(*(getattr(self, name)[chosen] for name in _FIELDS))

    def put(self, chosen: np.ndarray, others: Rays) -> None:
        """Replace some rays, by index."""
        for name in _FIELDS:
            getattr(self, name)[chosen] = getattr(others, name)

    def advance(self, distance_mm: np.ndarray, media: Media) -> None:
        """Move every ray along its way."""
        self.origin += distance_mm[:, None] * self.direction
        self.lengthen(distance_mm, media)

    def lengthen(self, distance_mm: np.ndarray, media: Media) -> None:
        """Add to every ray's way without moving it."""
        self.path_mm += distance_mm
        self.shown_mm += distance_mm * media.stretch[self.medium]
        self.loss_db += distance_mm * media.loss_db_mm[self.medium]


_FIELDS = tuple(field.name for field in fields(Rays))


@dataclass(frozen=True)
class Echoes:
    """What came back from surfaces.

    Attributes
    ----------
    group : (n,) int
        Scanline and layer.
    depth_mm : (n,) float32
        As displayed.
    amplitude : (n,) float32
        Of one ray: to be divided by the rays of a group.
    reflected : (n,) bool
        Whether the ray had been reflected before.
    """

    group: np.ndarray
    depth_mm: np.ndarray
    amplitude: np.ndarray
    reflected: np.ndarray


@dataclass(frozen=True)
class Descent:
    """Loss along the rays that were never reflected, as pieces of straight lines: loss_db + slope (z - shown).

    Every ray has a first piece at 0; a piece lasts until the ray's next one. Within a ray, depth never falls.

    Attributes
    ----------
    ray : (n,) int32
    shown_mm, loss_db, slope_db_mm : (n,) float32
        One way, per displayed mm; `SILENT_DB` from where a ray is turned back.
    """

    ray: np.ndarray
    shown_mm: np.ndarray
    loss_db: np.ndarray
    slope_db_mm: np.ndarray


def start_rays(bundle: Bundle, tissue_of_owner: np.ndarray) -> Rays:
    """All rays of a frame, at the probe."""
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
        step_mm=filled(0, np.float32),
    )


def piece(rays: Rays, media: Media, ended: np.ndarray | None = None) -> Descent:
    """How the loss of each ray goes on from where it is; silent where it has `ended`, (n,) bool."""
    loss = rays.loss_db.copy()
    slope = media.loss_db_mm[rays.medium] / media.stretch[rays.medium]
    if ended is not None:
        loss[ended], slope[ended] = SILENT_DB, 0
    return Descent(rays.number, rays.shown_mm, loss, slope)
