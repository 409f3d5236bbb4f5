"""How seeds and random generators follow from a seed of the configuration and from what is drawn."""

from enum import IntEnum

import numpy as np

# A prime above the number of noise draws of a frame, and of seeds that a study takes from 0 on: frames, draws and
# scatterers never share a seed.
_STRIDE = 1_000_003


class Drawn(IntEnum):
    """What is drawn once for a data set or a run; each has a random stream of its own."""

    frames = 1
    split = 2
    label_order = 7


def generator_for(seed: int, drawn: Drawn) -> np.random.Generator:
    """The random generator of something that is drawn once."""
    return np.random.default_rng([seed, int(drawn)])


def crop_generator(seed: int, step: int, index: int) -> np.random.Generator:
    """The random generator of one crop, number `index` of the batch of a training step."""
    return np.random.default_rng([seed, step, index])


def resimulation_seed(seed: int) -> int:
    """Seed, of the scatterers or of the paths, with which a data set's frames are simulated again."""
    return seed + _STRIDE


def noise_seeds(frames: np.ndarray, draw: int) -> np.ndarray:
    """Seeds of the generator's noise, (k,) int64, for frames of a data set and the number of a noise draw."""
    return np.asarray(frames, np.int64) * _STRIDE + draw
