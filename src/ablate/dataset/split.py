"""Which frames are taken, which of them train, validate and test, and the seeds of what is drawn for them."""

from collections import defaultdict
from collections.abc import Sequence
from enum import IntEnum, StrEnum
from itertools import count

import numpy as np

from ablate.setting import naming

# A prime above the number of noise draws of a frame, and of seeds that a study takes from 0 on: frames, draws and
# scatterers never share a seed.
_STRIDE = 1_000_003


class Drawn(IntEnum):
    """What is drawn once for a data set or a run; with the seed, each has a random stream of its own."""

    frames = 1
    split = 2
    label_order = 7


def resimulation_seed(seed: int) -> int:
    """Seed, of the scatterers or of the paths, with which a data set's frames are simulated again."""
    return seed + _STRIDE


def noise_seeds(frames: np.ndarray, draw: int) -> np.ndarray:
    """Seeds of the generator's noise, (k,) int64, for frames of a data set and the number of a noise draw."""
    return np.asarray(frames, np.int64) * _STRIDE + draw


class Part(IntEnum):
    """Value stored in the data set's `split` array."""

    train = 0
    validation = 1
    test = 2


class SplitBy(StrEnum):
    """`site` keeps all frames of a probe site on one side; `frame` draws frames freely, as the paper did.

    With `both`, half of the test frames are of probe sites of their own, and the other half and the validation frames
    are drawn freely from those of all other sites.
    """

    site = "site"
    frame = "frame"
    both = "both"


def equally_spaced(frames: np.ndarray, count: int) -> np.ndarray:
    """At most `count` of some frames, the first and the last among them."""
    return frames[np.linspace(0, len(frames) - 1, min(count, len(frames))).round().astype(int)]


def choose_frames(sites: Sequence[int] | np.ndarray, frames: int, seed: int) -> np.ndarray:
    """Increasing indices, (frames,) int64, of poses as equally spread over the sites as the number allows.

    `sites`, (n,) int, is the site of every candidate pose.
    """
    site = np.asarray(sites)
    order = np.random.default_rng([seed, Drawn.frames]).permutation(len(site))
    counters: defaultdict[int, count[int]] = defaultdict(count)
    rank = [next(counters[s]) for s in site[order]]  # how many poses of the same site come before, in that order
    return np.sort(order[np.argsort(rank, kind="stable")[:frames]])


def split_frames(
    sites: Sequence[int] | np.ndarray, by: SplitBy, validation: float, test: float, seed: int
) -> np.ndarray:
    """Draw the part of every frame.

    Parameters
    ----------
    sites : (n,) int
        Of each frame.
    by : SplitBy
        What is drawn, sites or frames.
    validation, test : float
        Fractions of the sites (or frames), of which each part gets at least one; half of `test` each with `both`.
    seed : int

    Returns
    -------
    (n,) uint8 of `Part`

    Raises
    ------
    ValueError
        When nothing is left to train on.
    """
    if SplitBy(by) is SplitBy.both:
        return _split_by_both(np.asarray(sites), validation, test, seed)
    member = np.asarray(sites) if SplitBy(by) is SplitBy.site else np.arange(len(sites))
    units = np.unique(member)
    n_validation = max(1, round(validation * len(units)))
    n_test = max(1, round(test * len(units)))
    if n_validation + n_test >= len(units):
        raise ValueError(
            f"dataset.split={by}: {len(units)} {by}s cannot be split into train, validation and test; "
            "ask for more frames or sites" + (", or for dataset.split=frame" if by == SplitBy.site else "")
        )
    order = np.random.default_rng([seed, Drawn.split]).permutation(units)
    part = np.full(len(member), Part.train, np.uint8)
    part[np.isin(member, order[:n_test])] = Part.test
    part[np.isin(member, order[n_test : n_test + n_validation])] = Part.validation
    return part


def _split_by_both(sites: np.ndarray, validation: float, test: float, seed: int) -> np.ndarray:
    """Split by site for half of the test frames, and then what is left by frame."""
    part = np.full(len(sites), Part.test, np.uint8)
    with naming("dataset.split=both: "):
        by_site = split_frames(sites, SplitBy.site, test / 2, test / 2, seed)
        rest = np.flatnonzero(by_site != Part.test)
        share = len(sites) / len(rest)
        part[rest] = split_frames(sites[rest], SplitBy.frame, validation * share, test / 2 * share, seed)
    return part
