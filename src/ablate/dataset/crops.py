"""Batches for training: random crops that depend on nothing but (seed, step, index in the batch)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset

from ablate.dataset.pairs import Pairs

_IN_MEMORY_BYTES = 1 << 30
_TRIES = 50


@dataclass(frozen=True)
class CropSettings:
    """How training batches are cut.

    Attributes
    ----------
    size : int
        Side of the square crop, px; the part of it beyond the frame is filled as outside the fan.
    batch_size : int
    fan_fraction : float
        A crop is drawn again until at least this share of it lies in the fan; it always touches the fan.
    flip : bool
        Mirror half of the crops left to right, which the physics allows.
    seed : int
    """

    size: int = 512
    batch_size: int = 4
    fan_fraction: float = 0.0
    flip: bool = False
    seed: int = 0


class Crops(Dataset[dict[str, torch.Tensor]]):
    """Batch number `step` of an endless training run, as a dict of tensors.

    Item `step` holds `segmentation`, `image` and, where the pairs are read with them, `attenuation` and `low`:
    (N, 1, size, size) float32 in [-1, 1], outside the fan -1 (attenuation in [0, 1], outside 0); `mask`,
    (N, 1, size, size) float32; and `noise_seed`, (N,) int64.

    Parameters
    ----------
    pairs : Pairs
    frames : (k,) int
        Frames to draw from.
    maps : frozenset of str
        Which of `attenuation` and `low` to include.
    values : (labels,) float32
        From `label_values`.
    settings : CropSettings

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
    ) -> None:
        if settings.batch_size > len(frames):
            raise ValueError(f"training.batch_size={settings.batch_size}: more than the {len(frames)} training frames")
        self.pairs, self.frames, self.values, self.settings = pairs, np.asarray(frames), values, settings
        self.names = ("segmentation", "high", *sorted(maps & {"attenuation", "low"}))
        self.mask = pairs.mask()
        bytes_needed = len(frames) * self.mask.size * (len(self.names) + 1)
        self._held = None if bytes_needed > _IN_MEMORY_BYTES else {n: pairs.read(n, frames) for n in self.names}

    def __getitem__(self, step: int) -> dict[str, torch.Tensor]:
        samples = [self._sample(step, index) for index in range(self.settings.batch_size)]
        return {k: torch.stack([s[k] for s in samples]) for k in samples[0]}

    def _sample(self, step: int, index: int) -> dict[str, torch.Tensor]:
        rng = np.random.default_rng([self.settings.seed, step, index])
        item = int(rng.integers(len(self.frames)))
        corner = self._window(rng)
        mirror = self.settings.flip and bool(rng.integers(2))
        mask = self._cut(self.mask, corner, mirror)
        sample = {"mask": mask.astype(np.float32)}
        for name in self.names:
            cut = self._cut(self._map(name, item), corner, mirror)
            if name == "segmentation":
                cut = self.values[cut]
            elif name != "attenuation":
                cut = np.where(mask, cut.astype(np.float32) / 127.5 - 1, np.float32(-1))
            sample["image" if name == "high" else name] = cut.astype(np.float32)
        tensors = {k: torch.from_numpy(np.ascontiguousarray(v))[None] for k, v in sample.items()}
        tensors["noise_seed"] = torch.tensor(int(rng.integers(2**62)))
        return tensors

    def _map(self, name: str, item: int) -> np.ndarray:
        if self._held is not None:
            return self._held[name][item]
        return self.pairs.read(name, [self.frames[item]])[0]

    def _window(self, rng: np.random.Generator) -> tuple[int, int]:
        """Top left corner of a crop with enough of the fan in it; where none is found, of the best one seen."""
        (height, width), size = self.mask.shape, self.settings.size
        best, best_share = (0, 0), -1.0
        for _ in range(_TRIES):
            corner = int(rng.integers(max(height - size, 0) + 1)), int(rng.integers(max(width - size, 0) + 1))
            share = self.mask[corner[0] : corner[0] + size, corner[1] : corner[1] + size].mean()
            if share > best_share:
                best, best_share = corner, share
            if share > 0 and share >= self.settings.fan_fraction:
                break
        return best

    def _cut(self, image: np.ndarray, corner: tuple[int, int], mirror: bool) -> np.ndarray:
        (row, column), size = corner, self.settings.size
        cut = image[row : row + size, column : column + size]
        if cut.shape != (size, size):
            cut = np.pad(cut, ((0, size - cut.shape[0]), (0, size - cut.shape[1])))
        return cut[:, ::-1] if mirror else cut


class _Steps:
    """Sampler of the steps from `start` to `stop`, so that a resumed run sees what it would have seen."""

    def __init__(self, start: int, stop: int) -> None:
        self.start, self.stop = start, stop

    def __iter__(self) -> Iterator[int]:
        return iter(range(self.start, self.stop))

    def __len__(self) -> int:
        return max(0, self.stop - self.start)


def crop_loader(crops: Crops, start: int, stop: int, workers: int = 0) -> DataLoader[dict[str, torch.Tensor]]:
    """Batches of the steps `start` to `stop - 1`, one a step, in order."""
    return DataLoader(
        crops,
        batch_size=None,
        sampler=_Steps(start, stop),
        num_workers=workers,
        persistent_workers=workers > 0,
        pin_memory=torch.cuda.is_available(),
    )
