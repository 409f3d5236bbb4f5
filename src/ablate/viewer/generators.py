"""Generators that can be picked, of finished runs and of the package, on the fastest engine that this machine has."""

import logging
import pickle
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing import get_context
from multiprocessing.context import SpawnProcess
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from weakref import finalize

import numpy as np
import torch
from torch import Tensor

from ablate import pretrained
from ablate.anatomy import Tissue, load_tissues
from ablate.dataset import decode_grey_levels, label_values, maps_read, network_inputs
from ablate.dataset.frame_maps import FrameMaps
from ablate.dataset.processes import interrupts_blocked, work_for_parent
from ablate.networks import Generator, Space, conditions, export_onnx
from ablate.pretrained import OUTSIDE, Renderer, values_of
from ablate.setting import identity, plain
from ablate.settings.study import StudySettings
from ablate.study.job import differences
from ablate.study.training import Training, trainings_in
from ablate.threads import without_teams
from ablate.training import Engine, OpenEngine, TrainingPrecision, generate, load_generator, missing_for, open_exported
from ablate.ultrasound import Probe, SimulatorSettings, scan_converter
from ablate.ultrasound.probe import pixel_size_mm
from ablate.viewer.session import State

_LOG = logging.getLogger(__name__)
_SHIPPED = Path("pretrained")
_FRAMES_BEFORE = 5  # of one size, before it is worth an export
_KEPT = 3  # sizes: an open file takes some hundred MB of memory
# Sizes, which are said otherwise; how exactly an image is computed; and what the viewer's own curve changes.
_NO_LOOK = frozenset({"image_shape", "scanlines", "axial_samples", "rays", "layers", "path_seed", "time_gain_db"})


def pickable(folder: Path) -> dict[str, Path]:
    """What `open_generator` opens, by name: the runs of a folder, of SA2H first, then those of the package.

    A run is named by its study, variant and seed; the folder may be a run, a study or a folder of studies.
    """
    found = [Training(folder), *(one for place in (folder, *sorted(folder.glob("*/"))) for one in trainings_in(place))]
    usable = [training for training in found if training.is_trained and training.checkpoint.exists()]
    usable.sort(key=lambda training: training.label != StudySettings.reference)
    named = {f"{training.folder.parent.name}: {training.name}": training.folder.resolve() for training in usable}
    return named | {f"comes with ablate: {name}": _SHIPPED / name for name in pretrained.NAMES}


def is_shipped(picked: Path) -> bool:
    """Whether this is a generator that comes with the package."""
    return picked.parent == _SHIPPED


class FastGenerator:
    """Renders with torch; fast frames with OpenVINO, once the generator has been exported for their size.

    A process of its own exports, so that frames go on meanwhile. Without the extra `export` torch renders all frames.
    One thread uses it at a time.
    """

    def __init__(self, generator: Generator) -> None:
        self.generator = generator
        self._exports = missing_for(Engine.exported, torch.device("cpu")) is None
        self._rendered: Counter[tuple[int, int]] = Counter()
        self._opened: dict[tuple[int, int], OpenEngine] = {}
        self._running: dict[tuple[int, int], SpawnProcess] = {}  # the export of a size, one at a time
        self._folder = Path(mkdtemp(prefix="ablate-view-"))
        finalize(self, _end, self._running, self._folder)

    def render(self, maps: Mapping[str, Tensor], mask: Tensor, seed: Tensor, fast: bool) -> np.ndarray:
        """Render (H, W) uint8 from maps (1, 1, H, W), a mask (H, W) and the seed of the noise, (1,) int64."""
        size = (mask.shape[0], mask.shape[1])
        self._rendered[size] += 1
        if self._exports and size not in self._opened and self._rendered[size] > _FRAMES_BEFORE:
            self._advance_export(size)
        if (opened := self._opened.get(size)) is None or not fast:
            return generate(self.generator, maps, mask, seed, TrainingPrecision.fp32)[0]
        with without_teams():
            return decode_grey_levels(opened(maps, seed)[0, 0], mask).numpy()

    def _advance_export(self, size: tuple[int, int]) -> None:
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

    def _path(self, size: tuple[int, int]) -> Path:
        return Path(self._folder, f"{size[0]}x{size[1]}.onnx")


def _end(running: Mapping[tuple[int, int], SpawnProcess], folder: Path) -> None:
    for process in running.values():
        process.kill()
        process.join()
    rmtree(folder, ignore_errors=True)


@dataclass(frozen=True, eq=False)
class Trained:
    """A generator, ready to render frames of a scene.

    `values`, (labels, channels) float32, is what it reads for each label of the scene; `unknown` says which tissues of
    the scene it was not trained on, and is empty if there are none.
    """

    renderer: Renderer
    engine: FastGenerator
    values: np.ndarray
    unknown: str

    @property
    def reads(self) -> tuple[str, ...]:
        return conditions(self.renderer.generator.spec)

    @property
    def space(self) -> Space:
        return self.renderer.generator.spec.space

    def render(
        self, maps: FrameMaps, low: np.ndarray | None, mask: np.ndarray, probe: Probe, seed: int, fast: bool
    ) -> np.ndarray:
        """Render (H, W) uint8 from S and A, (H, W) each, the maps in beam space, and L in the space of the generator.

        `mask`, (H, W) bool, is the fan. A `fast` image may come from OpenVINO.
        """
        space, converter = self.space, None
        read = maps_read(self.reads, space, maps, probe, self.renderer.simulator.time_gain)
        if low is not None:
            read["low"] = low
        if space is Space.beam:
            rows, lines = maps[2].segmentation.shape
            converter = scan_converter(probe, (rows, lines), (mask.shape[0], mask.shape[1]))
            mask = np.ones((rows, lines), bool)
        inputs = network_inputs({name: value[None] for name, value in read.items()}, self.values, mask)
        image = self.engine.render(inputs, torch.from_numpy(mask), torch.tensor([seed]), fast)
        return image if converter is None else converter.to_image(image)

    def reservation(self, state: State) -> str:
        """Say in what a state differs from the training; empty if it does not."""
        reservations, probe = [], self.renderer.probe
        unlike = differences(_look(probe, self.renderer.simulator), _look(state.probe, state.simulator))
        if told := ", ".join(f"{key}={there}" for key, there, _ in unlike if there is not None):
            reservations.append(f"trained with {told}")
        if state.simulator.time_gain_db not in (None, self.renderer.simulator.time_gain_db):
            reservations.append("trained with another time gain")
        shown = pixel_size_mm(state.probe, state.simulator.image_shape)
        trained = pixel_size_mm(probe, self.renderer.simulator.image_shape)
        if not np.allclose(shown, trained, rtol=0.05):
            size = "{0[0]:.2f} x {0[1]:.2f} mm".format
            reservations.append(f"trained with pixels of {size(trained)}, here they are {size(shown)}")
        (rows, lines), (own, others) = self.renderer.simulator.beam_shape, state.simulator.beam_shape
        if self.space is Space.beam and (own, others) != (rows, lines):
            reservations.append(f"trained with {rows} rows of {lines} scanlines, here they are {own} of {others}")
        return "; ".join([*reservations, self.unknown] if self.unknown else reservations)


def _look(probe: Probe, simulator: SimulatorSettings) -> dict[str, object]:
    """The values of a probe, and of a simulator those that images look different with."""
    return plain(probe) | {key: value for key, value in identity(simulator).items() if key not in _NO_LOOK}


def trained_at(picked: Path) -> int:
    """When the weights of a run were written, ns; 0 of a generator that comes with the package."""
    checkpoint = Training(picked).checkpoint
    return checkpoint.stat().st_mtime_ns if checkpoint.exists() else 0


def first_fitting(offered: Mapping[str, Path], tissues: Sequence[Tissue], state: State) -> tuple[Path, ...]:
    """The first generator that was trained with the probe, the pixels and the tissues of a state; or nothing."""
    for picked in offered.values():
        with suppress(OSError, ValueError, KeyError):
            if not open_generator(picked, tissues).reservation(state):
                return (picked,)
    return ()


def open_generator(picked: Path, tissues: Sequence[Tissue]) -> Trained:
    """Load a generator, to look at a scene with these tissues.

    Tissues of unknown names have the values of their places in this scene's own order; those of known names but other
    properties have the values of the training. Where the data set of a run has been deleted, `tissues` are taken for
    those of the training. A run that has been deleted is an OSError, and one whose files are damaged a ValueError.
    """
    if is_shipped(picked):
        renderer, own = pretrained.load(picked.name), label_values(tissues, StudySettings.encoding)
        trained_on, is_known = tuple(load_tissues().values()), True
    else:
        run = Training(picked)
        if not run.is_trained:
            raise FileNotFoundError(f"this run is gone: {picked} is {run.state} {run.why}".rstrip())
        settings, data = run.settings, run.data_set
        trained_on, is_known = data.tissues if data.exists else tuple(tissues), data.exists
        encoding = settings.encoding, settings.label_seed
        levels, own = label_values(trained_on, *encoding), label_values(tissues, *encoding)
        probe, simulator = settings.probe, settings.simulator
        if data.exists:
            pairs, (rows, lines) = data.pairs, data.pairs.beam_shape
            probe, curve = pairs.probe or probe, data.time_gain_db
            simulator = replace(simulator, time_gain_db=curve, image_shape=pairs.shape, scanlines=lines)
            simulator = replace(simulator, axial_samples=rows * simulator.samples_per_row)
        renderer = Renderer(load_generator(run.checkpoint), values_of(trained_on, levels), probe, simulator, made={})
    of_training = {tissue.name: tissue for tissue in trained_on if tissue.name in renderer.values}
    others = [tissue.name.replace("_", " ") for tissue in tissues if of_training.get(tissue.name) != tissue]
    unknown = f"not trained on {', '.join(others)}" if others else ""
    if not is_known:
        unknown = "its data set is gone: labels are taken for those of this scene"
    width = len(renderer.values[OUTSIDE])
    if own.shape[1] != width:  # the encodings of both scenes have another number of channels
        own = np.zeros((len(own), width))
    known = [renderer.values.get(t.name, value) for t, value in zip(tissues, own[1:].tolist(), strict=True)]
    values = np.array([renderer.values[OUTSIDE], *known], np.float32)
    return Trained(renderer, FastGenerator(renderer.generator), values, unknown)
