"""How strong scatterers are: the level at their place, and a texture, a slow variation within a tissue."""

import math
from functools import cache

import numpy as np
from scipy.ndimage import fourier_gaussian

from ablate.ultrasound.compiled import Arrays, compiled, exponential
from ablate.ultrasound.imaging.scatterers import mix_seed

_TEXTURE_SIDE = 64  # voxels of the periodic volume of smooth noise that is stretched for each tissue
_TEXTURE_SMOOTHING = 1.2  # voxels; the correlation then falls to 1/e over twice that
_VOXELS_PER_LENGTH = 2 * _TEXTURE_SMOOTHING
_TEXTURE_SEED = 7


@cache
def texture_volume() -> np.ndarray:
    """Periodic Gaussian noise, of unit variance when interpolated, (side + 1, ...) float32.

    The first planes are repeated at the end, so that interpolation needs no wrapping.
    """
    generator = np.random.Generator(np.random.Philox(key=[_TEXTURE_SEED, 0]))
    noise = generator.standard_normal((_TEXTURE_SIDE,) * 3)
    smooth = np.fft.ifftn(fourier_gaussian(np.fft.fftn(noise), _TEXTURE_SMOOTHING)).real
    neighbours = math.exp(-1 / (2 * _TEXTURE_SMOOTHING) ** 2)  # correlation of adjacent voxels
    interpolated = (2 / 3 + neighbours / 3) ** 1.5  # standard deviation left, on average, between voxels
    smooth = (smooth - smooth.mean()) / (smooth.std() * interpolated)
    return np.pad(smooth, (0, 1), mode="wrap").astype(np.float32)


def texture_start(seed: int) -> np.ndarray:
    """Where in the volume the texture of a scatterers' seed begins, (3,), in lengths of the texture."""
    generator = np.random.Generator(np.random.Philox(key=[_TEXTURE_SEED, int(mix_seed(seed))]))
    return generator.random(3) * (_TEXTURE_SIDE / _VOXELS_PER_LENGTH)


@compiled
def texture_db(volume: np.ndarray, x: float, y: float, z: float, contrast: float) -> float:
    """Gain of the scatterers' amplitude at a point, of unit mean power over a tissue.

    g, from `texture_volume`, is normal with unit variance; the gain contrast * g has mean power exp(2 a^2), a =
    contrast ln(10) / 20, which is taken off again.

    Parameters
    ----------
    volume : (side + 1, side + 1, side + 1) float32
        That of `texture_volume`.
    x, y, z : float
        The point, in lengths of the texture.
    contrast : float
        Standard deviation of the gain, dB.

    Returns
    -------
    float
        dB.
    """
    a, b, c = _turned(x), _turned(y), _turned(z)
    i, j, k = np.uint64(a), np.uint64(b), np.uint64(c)
    a, b, c = a - i, b - j, c - k
    g, one = 0.0, np.uint64(1)
    for di in range(2):
        for dj in range(2):
            p, q = i + np.uint64(di), j + np.uint64(dj)
            here, there = volume[p, q, k], volume[p, q, k + one]
            g += (a if di else 1 - a) * (b if dj else 1 - b) * (here + c * (there - here))
    return contrast * g - contrast * contrast * (math.log(10) / 20)


@compiled
def _turned(lengths: float) -> float:
    """Where in the periodic volume a number of texture lengths lies, in voxels, at least 0 and below its side."""
    turns = lengths * (_VOXELS_PER_LENGTH / _TEXTURE_SIDE)
    return min((turns - math.floor(turns)) * _TEXTURE_SIDE, _TEXTURE_SIDE - 1e-6)


@compiled
def insonify(amplitude: np.ndarray, node_db: np.ndarray, lines: Arrays, textures: Arrays, begin: int, end: int) -> None:
    """Fill the amplitudes of some groups from levels at nodes and the texture.

    The level is taken to coarse samples, with the texture added there, and interpolated between them.

    Parameters
    ----------
    amplitude : (groups, samples) float
        Is filled, from row `begin` to before `end`.
    node_db : (groups, nodes) float64
        Levels from the first sample to the last.
    lines : tuple of array
        Starts and directions, (groups, 3), ranges in mm and tissues, (groups, samples).
    textures : tuple of array
        Three inverse lengths and the contrast of each tissue, (tissues, 4); the volume; where in it the texture begins,
        (3,) lengths; the numbers of the coarse samples.
    begin, end : int
        The groups.
    """
    samples, places = amplitude.shape[1], len(textures[3])
    level, first, factor = np.empty((3, places + 1))
    begins = np.empty(places + 1, np.int64)
    for row in range(begin, end):
        _coarse_levels(level, node_db, row, lines, textures)
        _between_coarse(level, samples, begins, first, factor)
        for place in range(places):
            value = first[place]
            for sample in range(begins[place], begins[place + 1]):
                amplitude[row, sample] = value
                value *= factor[place]


@compiled
def _coarse_levels(level: np.ndarray, node_db: np.ndarray, row: int, lines: Arrays, textures: Arrays) -> None:
    """Fill the levels of the coarse samples of a line, (places + 1,), the last one twice, nepers."""
    starts, directions, ranges_mm, tissues = lines
    tissue_levels, volume, begins_at, coarse = textures
    nodes, places = node_db.shape[1], len(coarse)
    for place in range(places):
        node = place * ((nodes - 1) / max(places - 1, 1))
        below = min(int(node), max(nodes - 2, 0))
        above = min(below + 1, nodes - 1)
        decibels = node_db[row, below] + (node - below) * (node_db[row, above] - node_db[row, below])
        tissue = tissues[row, coarse[place]]
        if tissue_levels[tissue, 3] != 0:
            r = ranges_mm[row, coarse[place]]
            x = (starts[row, 0] + directions[row, 0] * r) * tissue_levels[tissue, 0] + begins_at[0]
            y = (starts[row, 1] + directions[row, 1] * r) * tissue_levels[tissue, 1] + begins_at[1]
            z = (starts[row, 2] + directions[row, 2] * r) * tissue_levels[tissue, 2] + begins_at[2]
            decibels += texture_db(volume, x, y, z, tissue_levels[tissue, 3])
        level[place] = decibels * (math.log(10) / 20)
    level[places] = level[places - 1]


@compiled
def _between_coarse(level: np.ndarray, samples: int, begins: np.ndarray, first: np.ndarray, factor: np.ndarray) -> None:
    """Fill, from coarse sample to coarse sample: the first sample, its amplitude, and the factor to each next one."""
    places = len(level) - 1
    apart = (samples - 1) / max(places - 1, 1)
    for place in range(places):
        rise = (level[place + 1] - level[place]) / max(apart, 1e-9)
        begins[place] = math.ceil(place * apart - 1e-9)
        first[place] = level[place] + rise * (begins[place] - place * apart)
        factor[place] = rise
    begins[places] = samples
    for place in range(places):
        first[place], factor[place] = exponential(first[place]), exponential(factor[place])
