"""Rays where they are needed: a few for every scanline and layer, and more where the image would be wrong without them.

Two halves of a few rays each are traced for every group. How far they differ tells how much one ray varies, and from
that follows how many rays each group gets, so that the whole frame is as exact as `SimulatorSettings.tolerance` asks
with as few rays as possible (Neyman's allocation: in proportion to the standard deviation; cf. Mattausch and Goksel,
"Monte-Carlo ray-tracing for realistic interactive ultrasound simulation", 2016). The same seed gives the same rays.

A number of rays that depended on the group's own first rays would bias it: a group that happens to miss a bright echo
would look as if it needed no more (Kirk and Arvo, "Unbiased sampling techniques for image synthesis", 1991). So a group
is judged by its neighbours, whose draws are independent of its own. Echoes and illumination are then unbiased. The
power of reverberation, which is a product of two groups' rays, keeps a bias of second order in the error of the first
rays. One scanline in one layer has no neighbour, and gets all rays.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter

from ablate.ultrasound.transport.tracing import Paths, trace

#: Rays of each of the two halves that are traced first.
HALF = 2
_NEIGHBOUR_LINES = 3  # to either side, in all layers
_LEVEL_NODES = 9  # over which the level shown is averaged


class Shown(NamedTuple):
    """What is seen of rays at the nodes of each group, as amplitude after the time gain, and in how many lines."""

    echo: np.ndarray  # (groups, nodes): of an echo of amplitude 1
    scatterers: np.ndarray  # (groups, nodes): of scatterers under an illumination of 1
    floor: float  # what disappears in the noise of the display
    overlap: float  # sum of squares of the shares that one scanline has in those around it
    scanlines: int


def trace_to_tolerance(
    paths: Paths, shown: Shown, tolerance: float, send: Callable[[np.ndarray], None]
) -> tuple[np.ndarray, np.ndarray]:
    """The echoes of as many rays as each group needs, (n,) ECHO, and these numbers, (groups,); accumulates `nodes`.

    `send` lets rays leave the probe, by their numbers in the frame.
    """
    groups, rays, nodes = len(paths.bundle.starts), paths.view.rays, paths.nodes
    number = np.arange(groups * rays) % rays
    if groups == 1 or rays <= 2 * HALF:
        send(np.arange(len(number)))
        return trace(paths), np.full(groups, rays)
    send(np.flatnonzero(number < 2 * HALF))
    count, echoes, seen = nodes.amplitude.shape[1], [], []
    for first in (0, HALF):
        own = nodes._replace(amplitude=np.zeros_like(nodes.amplitude))
        echoes.append(trace(paths._replace(nodes=own), first, np.full(groups, first + HALF)))
        nodes.amplitude[:] += own.amplitude
        direct = echoes[-1][~echoes[-1]["reflected"]]  # reverberation is spread too wide to be seen by group
        node = np.rint((direct["depth_mm"] - nodes.first_mm) / nodes.spacing_mm).astype(np.int64)
        place = direct["group"].astype(np.int64) * count + np.clip(node, 0, count - 1)
        received = np.bincount(place, direct["amplitude"], minlength=groups * count).reshape(groups, count)
        seen.append((received * shown.echo + own.amplitude * shown.scatterers) / HALF)
    counts = rays_needed(seen[0], seen[1], shown, tolerance, rays)
    send(np.flatnonzero((number >= 2 * HALF) & (number < np.repeat(counts, rays))))
    return np.concatenate([*echoes, trace(paths, 2 * HALF, counts)]), counts


def rays_needed(a: np.ndarray, b: np.ndarray, shown: Shown, tolerance: float, most: int) -> np.ndarray:
    """How many rays each group gets, (groups,) int, from what is seen of the halves of its first rays, (groups, nodes).

    The error of a sample is relative to what is shown there, all layers together, and to the noise of the display; it
    counts as ln(1 + error). With s_g what one ray of group g adds to it, root mean square over depth, a frame of L
    scanlines has the error sqrt(o / L sum s_g^2 / n_g), o the overlap of scanlines. The sum of n_g is smallest at this
    tolerance t for n_g = s_g o (sum s) / (L t^2).
    """
    lines = shown.scanlines
    level = (a + b).reshape(-1, lines, a.shape[-1]).sum(axis=0) / 2
    level = uniform_filter(level, (2 * _NEIGHBOUR_LINES + 1, _LEVEL_NODES), mode="nearest") + shown.floor
    relative = np.abs(a - b).reshape(-1, lines, a.shape[-1]) / level  # its mean square is 2 s^2 / HALF
    shown_error = np.log1p(relative)  # the display is logarithmic; else one bright echo in the dark takes all rays
    variance = HALF / 2 * np.square(shown_error).mean(axis=-1)
    # the mean of the groups around each one, itself left out
    reach = np.arange(lines)
    first, last = np.maximum(reach - _NEIGHBOUR_LINES, 0), np.minimum(reach + _NEIGHBOUR_LINES + 1, lines)
    summed = np.concatenate([[0.0], np.cumsum(variance.sum(axis=0))])
    around = (summed[last] - summed[first])[None] - variance
    deviation = np.sqrt(np.maximum(around, 0.0) / (len(variance) * (last - first) - 1))
    wanted = deviation * deviation.sum() * shown.overlap / (lines * tolerance**2)
    return np.clip(np.ceil(wanted), 2 * HALF, most).astype(np.int64).ravel()
