"""Random numbers of the paths: a counter-based table, stratified over the rays of each scanline and layer.

A draw depends on (path seed, how many interfaces the ray has met, ray) and on nothing else, so that what is left
out of a scene does not shift the rest. A ray and the one that it sent back share theirs, on different ways. Each number
is stratified (Latin hypercube): of the n rays of one scanline and layer exactly one falls into each n-th of [0, 1), in
an order that is permuted anew at each interface. Of the few rays that meet more interfaces than the table has rows,
each number is a hash of the same three; strata are of no use where no two rays of a group meet the same surface.
"""

import math
from collections.abc import Callable
from threading import Lock

import numpy as np

from ablate.ultrasound.compiled import compiled

#: Interfaces that the table serves.
MAX_ROWS = 64
#: Columns of a row of draws.
CHOICE, THICKNESS, LOG_U, COS_AZIMUTH, SIN_AZIMUTH, SURVIVAL = range(6)
COLUMNS = 6

_GAMMA, _MIX_1, _MIX_2 = (np.uint64(x) for x in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB))


def stratified(generator: np.random.Generator, groups: int, rays: int, dimensions: int) -> np.ndarray:
    """Uniform numbers, each stratified over the rays of a group, (dimensions, groups, rays) float32 in [0, 1)."""
    shape = (dimensions, groups, rays)
    order = np.argsort(generator.random(shape, np.float32), axis=-1).astype(np.float32)
    within = generator.random(shape, np.float32)
    return np.minimum((order + within) / np.float32(rays), np.float32(1 - 2**-24))


def progressive(generator: np.random.Generator, groups: int, rays: int, dimensions: int) -> np.ndarray:
    """The same for groups of which only the first rays may be traced: any first 2^m of them are stratified, too.

    From 2^m rays to twice as many, each of the 2^m intervals is halved, and the new rays fill the empty halves in a
    random order. Every single number is uniform, so the mean over the first rays is unbiased, however many they are.
    """
    cells = np.zeros((dimensions, groups, 1), np.int64)
    found = generator.random((dimensions, groups, 1), np.float32)
    while found.shape[-1] < rays:
        n = found.shape[-1]
        cells = np.minimum((found * (2 * n)).astype(np.int64), 2 * n - 1)
        order = np.argsort(generator.random(cells.shape, np.float32), axis=-1)
        empty = np.take_along_axis(cells ^ 1, order, axis=-1)
        new = (empty + generator.random(cells.shape, np.float32)) / np.float32(2 * n)
        found = np.concatenate([found, new.astype(np.float32)], axis=-1)
    return np.minimum(found[..., :rays], np.float32(1 - 2**-24))


@compiled
def _mixed(key: np.uint64) -> np.uint64:
    """One step of SplitMix64 (Steele, Lea and Flood 2014): neighbouring keys give unrelated numbers."""
    key += _GAMMA
    key = (key ^ (key >> np.uint64(30))) * _MIX_1
    key = (key ^ (key >> np.uint64(27))) * _MIX_2
    return key ^ (key >> np.uint64(31))


@compiled
def unstratified(path_seed: np.uint64, interfaces: int, number: int, row: np.ndarray) -> np.ndarray:
    """Draws of a ray, by its number, that has met more interfaces than the table serves: fills and returns `row`."""
    key = _mixed(_mixed(path_seed) ^ (np.uint64(number) << np.uint64(32) | np.uint64(interfaces)))
    for column in range(COLUMNS):
        key = _mixed(key)
        row[column] = np.float32(key >> np.uint64(40)) * np.float32(2.0**-24)
    radius = math.sqrt(-2 * math.log(1 - row[THICKNESS]))
    row[THICKNESS] = radius * abs(math.cos(2 * math.pi * row[SIN_AZIMUTH]))
    azimuth = 2 * math.pi * row[COS_AZIMUTH]
    row[COS_AZIMUTH], row[SIN_AZIMUTH] = math.cos(azimuth), math.sin(azimuth)
    row[LOG_U] = math.log(max(row[LOG_U], 1e-30))
    return row


Spread = Callable[[np.random.Generator, int, int, int], np.ndarray]


class Draws:
    """Draws for all rays of a simulator, made as they are needed and kept; a group is one scanline of one layer.

    `spread` makes the stratified numbers: `stratified`, or `progressive` where not all rays of a group are traced.
    """

    def __init__(self, path_seed: int, groups: int, rays: int, spread: Spread = stratified) -> None:
        self._spread = spread
        self.seed, self._groups, self._rays = np.uint64(path_seed % 2**64), groups, rays
        self._table = np.empty((MAX_ROWS, groups * rays, COLUMNS), np.float32)
        self._made = 0
        self._making = Lock()

    def aperture(self) -> np.ndarray:
        """Where in the aperture each ray starts, (2, groups, rays) float32 in [0, 1)."""
        return self._spread(self._generator(0), self._groups, self._rays, 2)

    def table(self, interfaces: int) -> np.ndarray:
        """Draws of all rays, (MAX_ROWS, groups * rays, COLUMNS) float32; the rows for so many interfaces are filled.

        Columns: uniform choice, |normal|, log of a uniform, cosine and sine of a uniform angle, uniform.
        """
        with self._making:
            while self._made < min(interfaces, MAX_ROWS):
                self._table[self._made] = self._row(self._made)
                self._made += 1
        return self._table

    def _row(self, number: int) -> np.ndarray:
        generator = self._generator(number + 1)
        u = self._spread(generator, self._groups, self._rays, 3).reshape(3, -1)
        row = np.empty((u.shape[1], COLUMNS), np.float32)
        angle = np.float32(2 * np.pi) * u[2]
        row[:, CHOICE] = u[0]
        row[:, THICKNESS] = np.abs(generator.standard_normal(u.shape[1], np.float32))
        row[:, LOG_U] = np.log(np.maximum(u[1], 1e-30))
        row[:, COS_AZIMUTH], row[:, SIN_AZIMUTH] = np.cos(angle), np.sin(angle)
        row[:, SURVIVAL] = generator.random(u.shape[1], np.float32)
        return row

    def _generator(self, counter: int) -> np.random.Generator:
        return np.random.Generator(np.random.Philox(key=np.array([self.seed, counter], np.uint64)))
