"""A generator on the fastest engine that this machine has: it is exported while it is already in use.

The process that exports imports this file, so it imports little.
"""

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
from ablate.training import Engine, OpenEngine, TrainingPrecision, generate, missing_for, open_exported

_LOG = logging.getLogger(__name__)
_FRAMES_BEFORE = 5  # of one size, before it is worth an export
_KEPT = 3  # sizes: an open file takes some hundred MB of memory


class FastGenerator:
    """Renders with torch, and with OpenVINO from the moment that the generator has been exported for a frame's size.

    A process of its own exports, so that frames go on meanwhile. Without the extra `export` torch renders all frames.
    One thread uses it at a time.
    """

    def __init__(self, generator: Generator) -> None:
        self.generator = generator
        self._exports = missing_for(Engine.exported, torch.device("cpu")) is None
        self._rendered: Counter[tuple[int, int]] = Counter()
        self._opened: dict[tuple[int, int], OpenEngine] = {}
        self._export: tuple[tuple[int, int], SpawnProcess] | None = None
        self._folder = Path(mkdtemp(prefix="ablate-view-"))
        finalize(self, rmtree, self._folder, ignore_errors=True)

    def render(self, maps: Mapping[str, Tensor], mask: Tensor, seed: Tensor) -> np.ndarray:
        """Render (H, W) uint8 from maps (1, 1, H, W), a mask (H, W) and the seed of the noise, (1,) int64."""
        size = (mask.shape[0], mask.shape[1])
        self._rendered[size] += 1
        if self._exports and size not in self._opened and self._rendered[size] > _FRAMES_BEFORE:
            self._advance_export(size)
        if (opened := self._opened.get(size)) is None:
            return generate(self.generator, maps, mask, seed, TrainingPrecision.fp32)[0]
        return decode_grey_levels(opened(maps, seed)[0, 0], mask).numpy()

    def _advance_export(self, size: tuple[int, int]) -> None:
        """Start an export if none runs, and open the file of one that has ended."""
        if self._export is None:
            content = pickle.dumps((_export, (self.generator, self._path(size), *size)))
            process = get_context("spawn").Process(target=work_for_parent, args=(content,), daemon=True)
            with interrupts_blocked():
                process.start()
            self._export = size, process
            return
        exported, process = self._export
        if process.is_alive():
            return
        self._export = None
        if process.exitcode == 0:
            while len(self._opened) >= _KEPT:
                self._opened.pop(next(iter(self._opened)))
            self._opened[exported] = open_exported(self.generator, self._path(exported), TrainingPrecision.fp32)
        else:
            self._exports = False
            _LOG.warning("the generator could not be exported and is rendered by torch, which is slower")

    def _path(self, size: tuple[int, int]) -> Path:
        return Path(self._folder, f"{size[0]}x{size[1]}.onnx")


def _export(generator: Generator, path: Path, height: int, width: int) -> None:
    torch.set_num_threads(1)
    try:
        export_onnx(generator, path, height, width)
    except Exception as error:
        raise SystemExit(f"{type(error).__name__}: {' '.join(str(error).split())}") from error
