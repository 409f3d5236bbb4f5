"""A generator on the fastest engine that this machine has: torch, then OpenVINO once a file for it has been written."""

import logging
import pickle
from collections import Counter
from collections.abc import Mapping
from multiprocessing import get_context
from multiprocessing.context import SpawnProcess
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from weakref import finalize

import numpy as np
import torch
from torch import Tensor

from ablate.dataset import decode_grey_levels
from ablate.dataset.processes import interrupts_blocked, work_for_parent
from ablate.networks import Generator, export_onnx
from ablate.threads import without_teams
from ablate.training import Engine, OpenEngine, TrainingPrecision, generate, missing_for, open_exported

_LOG = logging.getLogger(__name__)
_FRAMES_BEFORE = 5  # of one size, before it is worth an export
_KEPT = 3  # sizes: an open file takes some hundred MB of memory
_Size = tuple[int, int]


class FastGenerator:
    """Renders with torch; fast frames with OpenVINO, once the generator has been exported for their size.

    A process of its own exports, so that frames go on meanwhile. Without the extra `export` torch renders all frames.
    One thread uses it at a time.
    """

    def __init__(self, generator: Generator) -> None:
        self.generator = generator
        self._exports = missing_for(Engine.exported, torch.device("cpu")) is None
        self._rendered: Counter[_Size] = Counter()
        self._opened: dict[_Size, OpenEngine] = {}
        self._running: dict[_Size, SpawnProcess] = {}  # the export of a size, one at a time
        self._folder = Path(mkdtemp(prefix="ablate-view-"))
        finalize(self, _end, self._running, self._folder)

    def render(self, maps: Mapping[str, Tensor], mask: Tensor, seed: Tensor, fast: bool) -> np.ndarray:
        """Render a frame.

        Parameters
        ----------
        maps : mapping of str to (1, 1, H, W) Tensor
            What the generator reads, by name; of a segmentation (1, labels, H, W).
        mask : (H, W) bool Tensor
            The fan.
        seed : (1,) int64 Tensor
            Of the noise.
        fast : bool
            Whether the image may come from OpenVINO.

        Returns
        -------
        (H, W) uint8
        """
        size = (mask.shape[0], mask.shape[1])
        self._rendered[size] += 1
        if self._exports and size not in self._opened and self._rendered[size] > _FRAMES_BEFORE:
            self._advance_export(size)
        opened = self._opened.get(size)
        if opened is None or not fast:
            return generate(self.generator, maps, mask, seed, TrainingPrecision.fp32)[0]
        with without_teams():
            return decode_grey_levels(opened(maps, seed)[0, 0], mask).numpy()

    def _advance_export(self, size: _Size) -> None:
        """Start an export if none runs, and open the file of one that has ended."""
        if not self._running:
            content = pickle.dumps((export_onnx, (self.generator, self._path(size), *size)))
            process = get_context("spawn").Process(target=work_for_parent, args=(content,), daemon=True)
            with interrupts_blocked():
                process.start()
            self._running[size] = process
            return
        ((exported, process),) = self._running.items()
        if process.is_alive():
            return
        self._running.clear()
        if process.exitcode == 0:
            while len(self._opened) >= _KEPT:
                self._opened.pop(next(iter(self._opened)))
            self._opened[exported] = open_exported(self.generator, self._path(exported))
        else:
            self._exports = False
            _LOG.warning("the generator could not be exported and is rendered by torch, which is slower")

    def _path(self, size: _Size) -> Path:
        return Path(self._folder, f"{size[0]}x{size[1]}.onnx")


def _end(running: Mapping[_Size, SpawnProcess], folder: Path) -> None:
    for process in running.values():
        process.kill()
        process.join()
    rmtree(folder, ignore_errors=True)
