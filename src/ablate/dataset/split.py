"""Which frames train, validate and test."""

from collections.abc import Sequence
from enum import IntEnum, StrEnum

import numpy as np

from ablate.dataset.seeds import Drawn, generator_for


class Part(IntEnum):
    """Value stored in the data set's `split` array."""

    train = 0
    validation = 1
    test = 2


class SplitBy(StrEnum):
    """`site` keeps all frames of a probe site on one side; `frame` draws frames freely, as the paper did."""

    site = "site"
    frame = "frame"


def equally_spaced(frames: np.ndarray, count: int) -> np.ndarray:
    """At most `count` of some frames, the first and the last among them."""
    return frames[np.linspace(0, len(frames) - 1, min(count, len(frames))).round().astype(int)]


def choose_frames(sites: Sequence[int] | np.ndarray, frames: int, seed: int) -> np.ndarray:
    """Increasing indices, (frames,) int64, of poses as equally spread over the sites as the number allows.

    `sites`, (n,) int, is the site of every candidate pose.

    Raises
    ------
    ValueError
        When `frames` is below one or above the number of candidates.
    """
    site = np.asarray(sites)
    if not 1 <= frames <= len(site):
        raise ValueError(
            f"dataset.frames={frames}: allowed are 1 to {len(site)}, the poses that the probe sites offer; "
            "more sites or orientations: dataset.grid=[heights,angles,tilts,rolls]"
        )
    rng = generator_for(seed, Drawn.frames)
    order = rng.permutation(len(site))
    rank = np.empty(len(site), np.int64)  # how many poses of the same site come before, in that order
    for s in np.unique(site):
        members = order[site[order] == s]
        rank[members] = np.arange(len(members))
    position = np.argsort(order)
    return np.sort(np.lexsort((position, rank))[:frames])


def split_frames(
    sites: Sequence[int] | np.ndarray, by: SplitBy, validation: float, test: float, seed: int
) -> np.ndarray:
    """`Part` of every frame, (n,) uint8, from its site, (n,) int.

    `validation` and `test` are fractions of the sites (or frames), of which each gets at least one.

    Raises
    ------
    ValueError
        When the fractions leave nothing to train on, or there are fewer than three sites (or frames).
    """
    site = np.asarray(sites)
    units = np.unique(site) if by is SplitBy.site else np.arange(len(site))
    member = site if by is SplitBy.site else np.arange(len(site))
    if not (0 < validation < 1 and 0 < test < 1 and validation + test < 1):
        raise ValueError(f"dataset.validation={validation} and dataset.test={test}: each above 0 and together below 1")
    n_validation, n_test = (max(1, round(f * len(units))) for f in (validation, test))
    if n_validation + n_test >= len(units):
        raise ValueError(
            f"dataset.split={by}: {len(units)} {by}s cannot be split into train, validation and test; "
            "ask for more frames or sites"
        )
    order = generator_for(seed, Drawn.split).permutation(units)
    part = np.full(len(site), Part.train, np.uint8)
    part[np.isin(member, order[:n_test])] = Part.test
    part[np.isin(member, order[n_test : n_test + n_validation])] = Part.validation
    return part
