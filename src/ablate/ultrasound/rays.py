"""Rays under way, what they travel through, and what they bring back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ablate.ultrasound.bundle import Bundle
from ablate.ultrasound.media import Media
from ablate.ultrasound.ownership import owners


class Rays(NamedTuple):
    """Rays under way, one row a ray; lengths in mm. A tuple, so that compiled code can take it.

    Attributes
    ----------
    number : (n,) int32
        Of the ray that left the probe, among all of the frame; one that was sent back has its sender's.
    origin, direction : (n, 3) float32
        From where the next surface is looked for: `step_mm` beyond the last one.
    inside : (n, words) uint32
        The structures that it is inside of.
    medium : (n,) int32
        Index of the tissue that it goes through.
    path_mm, shown_mm, loss_db : (n,) float64
        Up to the last surface: length, length as displayed, loss one way.
    weight : (n,) float64
        Two-way amplitude without losses.
    interfaces, reflections : (n,) int32
        How many it has met, and how many turned it back.
    structure, triangle : (n,) int32
        Of the last surface.
    step_mm, reach_mm : (n,) float32
        From the last surface to `origin`, and how far from there the next one may be.
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
    reach_mm: np.ndarray


class View(NamedTuple):
    """What rays travel through, and who listens; a tuple, so that compiled code can take it.

    Attributes
    ----------
    media : Media
    tissue_of_owner : (structures + 1,) uint8
    elements, axes : (groups, 3) float64, mm
        Where each scanline begins, and where it looks.
    rays : int
        Of each group.
    path_seed : uint64
    depth_mm : float
        Of the image; an echo that would be drawn deeper is not followed.
    faintest_db : float
        Reflected rays whose two-way amplitude is under this are ended by roulette.
    step_mm : float
        Beyond a surface that was met.
    """

    media: Media
    tissue_of_owner: np.ndarray
    elements: np.ndarray
    axes: np.ndarray
    rays: int
    path_seed: np.uint64
    depth_mm: float
    faintest_db: float
    step_mm: float


@dataclass(frozen=True)
class Echoes:
    """What came back from surfaces.

    Attributes
    ----------
    group : (n,) int32
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


def start_rays(bundle: Bundle, chosen: slice, view: View) -> Rays:
    """Some rays of a frame, at the probe."""
    inside = bundle.inside[chosen].copy()
    n = len(inside)
    medium = view.tissue_of_owner[owners(inside)].astype(np.int32)
    return Rays(
        number=np.arange(chosen.start, chosen.start + n, dtype=np.int32),
        origin=bundle.origins[chosen].copy(),
        direction=bundle.ray_directions[chosen].copy(),
        inside=inside,
        medium=medium,
        path_mm=np.zeros(n),
        shown_mm=np.zeros(n),
        loss_db=np.zeros(n),
        weight=np.ones(n),
        interfaces=np.zeros(n, np.int32),
        reflections=np.zeros(n, np.int32),
        structure=np.full(n, -1, np.int32),
        triangle=np.full(n, -1, np.int32),
        step_mm=np.zeros(n, np.float32),
        reach_mm=np.float32(view.depth_mm) / view.media.stretch[medium],
    )


def with_room(rays: Rays, rows: int) -> Rays:
    """The same rays with at least so many rows; those added are not initialised."""
    more = rows - len(rays.number)
    return rays if more <= 0 else Rays(*(np.concatenate([c, np.empty((more, *c.shape[1:]), c.dtype)]) for c in rays))
