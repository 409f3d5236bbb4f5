"""The grid of probe sites of a scene, with other counts."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ablate.anatomy import SiteGrid


def resample_grid(grid: SiteGrid, counts: Sequence[int] | None) -> SiteGrid:
    """The same ranges with other counts of heights, angles, tilts and rolls, equally spaced; None keeps the grid.

    A count of one keeps the middle of its range; one below is a ValueError.
    """
    if counts is None:
        return grid
    if len(counts) != 4 or min(counts) < 1:
        raise ValueError(f"dataset.grid={list(counts)}: four counts of at least 1 (heights, angles, tilts, rolls)")

    def spread(values: Sequence[float], count: int) -> tuple[float, ...]:
        lower, upper = min(values), max(values)
        if count == 1:
            return ((lower + upper) / 2,)
        return tuple(float(v) for v in np.linspace(lower, upper, count))

    heights, angles, tilts, rolls = counts
    return replace(
        grid,
        heights_mm=spread(grid.heights_mm, heights),
        angles_deg=spread(grid.angles_deg, angles),
        tilts_deg=spread(grid.tilts_deg, tilts),
        rolls_deg=spread(grid.rolls_deg, rolls),
    )
