"""Batches for training: random crops that depend on nothing but (seed, step, index in the batch)."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch

from ablate.dataset.encoding import decode_attenuation, encode_grey_levels, grain_channels
from ablate.networks.spec import GRAIN, OF_POSITION, OF_SURFACES, Space, map_channels
from ablate.setting import Checked, setting

if TYPE_CHECKING:
    from ablate.dataset.pairs import Pairs  # only here: frames that are read otherwise need no Zarr

_TRIES = 50


@dataclass(frozen=True)
class CropSettings(Checked):
    """How training batches are cut.

    A crop is a square of `size` px, or a whole frame if `size` is 0; the part of it beyond the frame is filled as
    outside the fan. It is drawn again until at least the share `fan_fraction` of it lies in the fan, and it always
    touches the fan. `flip` mirrors half of the crops left to right, which the physics allows.
    """

    size: int = setting(512, least=0)
    batch_size: int = setting(4, least=1)
    fan_fraction: float = setting(0.0, least=0, most=1)
    flip: bool = False
    seed: int = setting(0, least=0)
    space: Space = Space.image


class Crops:
    """Batch number `step` of an endless training run, as a dict of tensors.

    Item `step` holds `segmentation`, (N, channels, h, w) float32 in [-1, 1]; `target` and the other `maps`,
    (N, 1, h, w) float32 in [-1, 1], outside the fan -1 (attenuation and interfaces in [0, 1], outside 0), of which
    `grain` has four channels; `mask`, (N, 1, h, w) float32; and `noise_seed`, (N,) int64.

    Parameters
    ----------
    pairs : Pairs
        The data set.
    frames : (k,) int
        Numbers of the frames from which crops are drawn.
    maps : frozenset of str
        Maps that a batch holds besides segmentation and target.
    values : (labels, channels) float32
        Of `label_values`.
    settings : CropSettings
        How crops are cut.
    in_memory_bytes : int
        As many frames as fit into it are kept in memory, as `Pairs.stored` has them: Zarr takes longer to find a frame
        than the crop is cut in.

    Raises
    ------
    ValueError
        When a batch is larger than the number of frames.
    """

    def __init__(
        self,
        pairs: Pairs,
        frames: np.ndarray,
        maps: frozenset[str],
        values: np.ndarray,
        settings: CropSettings,
        in_memory_bytes: int = 1 << 30,
    ) -> None:
        if settings.batch_size > len(frames):
            raise ValueError(f"training.batch_size={settings.batch_size}: more than the {len(frames)} training frames")
        self.pairs = pairs
        self.frames = np.asarray(frames)
        self.values = values
        self.settings = settings
        self.mask = pairs.mask(settings.space)
        self.size = (settings.size, settings.size) if settings.size else self.mask.shape
        positions = pairs.positions(settings.space) if maps & OF_POSITION else {}
        self.positions = {name: positions[name] for name in sorted(maps & OF_POSITION)}
        self.names = ("segmentation", "target", *sorted(maps - {"segmentation", "target"} - OF_POSITION))
        self._kept = in_memory_bytes // sum(self._stored(name, frames[0]).nbytes for name in self.names)
        self._in_memory = {name: self._stored(name, self.frames[: self._kept]) for name in self.names}

    def _stored(self, name: str, frames: np.ndarray) -> np.ndarray:
        if name == GRAIN:
            grain = self.pairs.read(name, np.atleast_1d(frames), self.settings.space)
            return grain if np.ndim(frames) else grain[0]
        return self.pairs.stored(name, frames, self.settings.space)

    def __getitem__(self, step: int) -> dict[str, torch.Tensor]:
        count = self.settings.batch_size
        labels = self.values.shape[1]
        channels = {name: map_channels(name, labels) for name in ("mask", *self.names, *self.positions)}
        arrays = {name: np.empty((count, several, *self.size), np.float32) for name, several in channels.items()}
        seeds = [self._fill(arrays, step, index) for index in range(count)]
        batch = {name: torch.from_numpy(array) for name, array in arrays.items()}
        batch["noise_seed"] = torch.tensor(seeds)
        return batch

    def _fill(self, batch: dict[str, np.ndarray], step: int, index: int) -> int:
        """Cut crop `index` of a batch into its place; returns its noise seed."""
        rng = np.random.default_rng([self.settings.seed, step, index])
        item = int(rng.integers(len(self.frames)))
        corner = self._window(rng)
        mirror = self.settings.flip and bool(rng.integers(2))
        mask = self._cut(self.mask, corner, mirror)
        batch["mask"][index, 0] = mask
        for name, whole in self.positions.items():
            cut = self._cut(whole, corner, mirror)
            batch[name][index, 0] = -cut if mirror and name == "lateral" else cut
        for name in self.names:  # in place: temporary arrays of this size cost more than the arithmetic
            frame = self._in_memory[name][item] if item < self._kept else self._stored(name, self.frames[item])
            cut = self._cut(frame, corner, mirror)
            place = batch[name][index, 0]
            if name == "segmentation":
                for channel, values in enumerate(self.values.T):
                    np.take(values, cut, out=batch[name][index, channel])
            elif name == GRAIN:
                batch[name][index] = grain_channels(cut)
            elif cut.dtype == np.uint16:  # attenuation
                decode_attenuation(cut, out=place)
            elif name in OF_SURFACES:
                np.divide(cut, np.float32(255), out=place)
            else:
                encode_grey_levels(cut, out=place)
                np.copyto(place, -1, where=~mask)
        return int(rng.integers(2**62))

    def _window(self, rng: np.random.Generator) -> tuple[int, int]:
        """Top left corner of a crop with enough of the fan in it; where none is found, of the best one seen."""
        rows, columns = (max(whole - side, 0) for whole, side in zip(self.mask.shape, self.size, strict=True))
        least = max(1.0, self.settings.fan_fraction * self.size[0] * self.size[1])
        best = (0, 0)
        best_count = -1
        for _ in range(_TRIES):
            row = int(rng.integers(rows + 1))
            column = int(rng.integers(columns + 1))
            count = int(np.count_nonzero(self.mask[row : row + self.size[0], column : column + self.size[1]]))
            if count > best_count:
                best = (row, column)
                best_count = count
            if count >= least:
                break
        if best_count == 0:  # a fan of a few pixels: a window about one of them
            inside = np.argwhere(self.mask)
            row, column = inside[rng.integers(len(inside))].tolist()
            top = min(max(row - self.size[0] // 2, 0), rows)
            left = min(max(column - self.size[1] // 2, 0), columns)
            best = (top, left)
        return best

    def _cut(self, image: np.ndarray, corner: tuple[int, int], mirror: bool) -> np.ndarray:
        row, column = corner
        height, width = self.size
        cut = image[row : row + height, column : column + width]
        if cut.shape[:2] != self.size:
            beyond = ((0, height - cut.shape[0]), (0, width - cut.shape[1]))
            cut = np.pad(cut, beyond + ((0, 0),) * (cut.ndim - 2))
        return cut[:, ::-1] if mirror else cut


class CropLoader:
    """Batches of the steps `start` to `stop - 1`, one a step, in order; a resumed run sees what it would have seen.

    `workers` batches are prepared ahead, each in a thread; 0 prepares each when it is asked for. Decoding leaves other
    threads free to run, and nothing has to be copied from one process to another.
    """

    def __init__(self, crops: Crops, start: int, stop: int, workers: int = 0) -> None:
        self.crops = crops
        self.steps = range(start, stop)
        self.workers = workers

    def __iter__(self) -> Iterator[dict[str, torch.Tensor]]:
        batches = self._ahead() if self.workers else map(self.crops.__getitem__, self.steps)
        pinned = torch.cuda.is_available()
        for batch in batches:
            yield {name: values.pin_memory() for name, values in batch.items()} if pinned else batch

    def _ahead(self) -> Iterator[dict[str, torch.Tensor]]:
        """Give each batch when it is ready, while the next ones are being made."""
        pool = ThreadPoolExecutor(self.workers + 1)  # one for the batch that is waited for
        try:
            pending: deque[Future[dict[str, torch.Tensor]]] = deque()
            for step in self.steps:
                pending.append(pool.submit(self.crops.__getitem__, step))
                if len(pending) > self.workers:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)
