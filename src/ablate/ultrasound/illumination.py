"""How strongly each scanline of each layer is insonified at each depth, from the rays that were never reflected."""

from __future__ import annotations

import math

import numpy as np
import torch

from ablate.ultrasound.rays import Descent
from ablate.ultrasound.slices import fill_rows, first_sample

#: Depths at which the rays' mean is taken; between them it is interpolated in dB.
NODES = 256
#: Levels below this are silence, dB: far under any display, far above the smallest float32.
SILENCE_DB = -600.0
_GROUPS_AT_A_TIME = 64  # so that the rays of a chunk stay in the processor's cache


def node_count(samples: int) -> int:
    """Number of depths that the illumination is computed at."""
    return min(samples, NODES)


def illumination_db(
    descent: Descent, groups: int, rays: int, first_mm: float, last_mm: float, nodes: int
) -> torch.Tensor:
    """Mean over the rays of a group of weight x 10^(-2 loss / 20), in dB.

    The loss of a ray is exact at every node; the mean is a log-sum-exp, so thousands of dB do no harm.

    Parameters
    ----------
    descent : Descent
    groups, rays : int
    first_mm, last_mm : float
        Depths of the first and the last node.
    nodes : int

    Returns
    -------
    (groups, nodes) float32 tensor, dB, at least `SILENCE_DB`
    """
    spacing = (last_mm - first_mm) / max(nodes - 1, 1) or 1.0
    first = np.maximum(first_sample(descent.shown_mm, first_mm, spacing), 0)
    at_first = descent.loss_db + descent.slope_db_mm * (np.float32(first_mm) - descent.shown_mm)
    line = np.stack([at_first, descent.slope_db_mm * np.float32(spacing)], axis=-1)
    order = np.argsort(descent.ray, kind="stable")
    ray, first, line = descent.ray[order], first[order], line[order].astype(np.float32)
    chunk = _GROUPS_AT_A_TIME * rays
    node = torch.arange(nodes, dtype=torch.float32)
    levels = []
    for begin in range(0, groups * rays, chunk):
        end = min(begin + chunk, groups * rays)
        a, b = np.searchsorted(ray, (begin, end))
        lines = fill_rows(ray[a:b] - begin, first[a:b], line[a:b], (end - begin, nodes))
        loss = torch.from_numpy(lines).reshape(-1, rays, nodes, 2)
        levels.append(_mean_level_db(loss[..., 0] + loss[..., 1] * node))
    return torch.cat(levels)


def _mean_level_db(loss_db: torch.Tensor) -> torch.Tensor:
    """Level of the mean amplitude over dim 1 of (groups, rays, nodes), two-way from one-way losses."""
    least = loss_db.amin(dim=1, keepdim=True)
    relative = torch.exp((least - loss_db).clamp_(min=-300) * (2 * math.log(10) / 20))
    level = 20 * torch.log10(relative.mean(dim=1)) - 2 * least[:, 0]
    return level.clamp_(min=SILENCE_DB)
