"""Generators that can be picked: those of finished runs, and those that come with the package."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from ablate import pretrained
from ablate.anatomy import Tissue
from ablate.dataset import label_values, network_inputs
from ablate.networks import conditions
from ablate.pretrained import Renderer
from ablate.runs.run import Run, State
from ablate.settings.study import StudySettings
from ablate.training import load_generator
from ablate.ultrasound import Probe, compensated_attenuation
from ablate.ultrasound.probe import pixel_size_mm
from ablate.viewer.exported import FastGenerator
from ablate.viewer.state import State as ViewState

_SHIPPED = Path("pretrained")


def pickable(folder: Path) -> dict[str, Path]:
    """What `open_generator` opens, by name: the runs of a folder, then those of the package.

    A run is named by its study, variant and seed; the folder may be a run, a study or a folder of studies.
    """
    folders = sorted({path.resolve() for path in (folder, *folder.glob("*/seed*"), *folder.glob("*/*/seed*"))})
    runs = [run for run in map(Run, folders) if run.state is State.finished and run.checkpoint.exists()]
    named = {f"{run.folder.parents[1].name}: {run.name}": run.folder for run in runs}
    return named | {f"comes with ablate: {name}": _SHIPPED / name for name in pretrained.NAMES}


def is_shipped(picked: Path) -> bool:
    """Whether this is a generator that comes with the package."""
    return picked.parent == _SHIPPED


@dataclass(frozen=True, eq=False)
class Trained:
    """A generator, ready to render frames of a scene.

    `values`, (labels,) float32, is what it reads for each label of the scene; `unknown` names the tissues of the scene
    that it was not trained on.
    """

    renderer: Renderer
    engine: FastGenerator
    values: np.ndarray
    unknown: tuple[str, ...]

    @property
    def reads(self) -> tuple[str, ...]:
        return conditions(self.renderer.generator.spec)

    def render(self, maps: Mapping[str, np.ndarray], mask: np.ndarray, probe: Probe, seed: int) -> np.ndarray:
        """Render (H, W) uint8 from `segmentation`, `attenuation` and, where it reads it, `low`, (H, W) each.

        `mask`, (H, W) bool, is the fan.
        """
        batch = {name: value[None] for name, value in maps.items()}
        if "compensated" in self.reads:
            batch["compensated"] = compensated_attenuation(batch["attenuation"], probe, self.renderer.tgc_db_cm_mhz)
        inputs = network_inputs(batch, self.values, mask)
        return self.engine.render(inputs, torch.from_numpy(mask), torch.tensor([seed]))

    def reservation(self, state: ViewState) -> str:
        """Say in what a state differs from the training; empty if it does not."""
        reservations, probe = [], self.renderer.probe
        if state.probe != probe:
            reservations.append(f"trained with {probe.depth_mm:g} mm at {probe.frequency_mhz:g} MHz")
        shown = pixel_size_mm(state.probe, state.simulator.image_shape)
        trained = pixel_size_mm(probe, self.renderer.image_shape)
        if not np.allclose(shown, trained, rtol=0.05):
            reservations.append(f"trained with pixels of {trained[0]:.2f} mm, here they are {shown[0]:.2f} mm")
        if self.unknown:
            reservations.append(f"not trained on {', '.join(name.replace('_', ' ') for name in self.unknown)}")
        return "; ".join(reservations)


def open_generator(picked: Path, tissues: Sequence[Tissue]) -> Trained:
    """Load a generator, to look at a scene with these tissues.

    Tissues that the generator was not trained on have the values of their places in this scene's own order.

    Raises
    ------
    OSError, ValueError
        In a sentence, when the run has been deleted or its files are damaged.
    """
    if is_shipped(picked):
        renderer, own = pretrained.load(picked.name), label_values(tissues, StudySettings.encoding)
    else:
        renderer, own = _renderer_of_run(picked, tissues)
    known = [renderer.values.get(tissue.name, value) for tissue, value in zip(tissues, own[1:], strict=True)]
    unknown = tuple(tissue.name for tissue in tissues if tissue.name not in renderer.values)
    return Trained(renderer, FastGenerator(renderer.generator), np.array([own[0], *known], np.float32), unknown)


def _renderer_of_run(folder: Path, tissues: Sequence[Tissue]) -> tuple[Renderer, np.ndarray]:
    """The generator of a run with its setting, and the values that its encoding gives to `tissues`.

    Where its data set has been deleted, `tissues` are taken for those that it was trained on.
    """
    run = Run(folder)
    if run.state is not State.finished:
        raise FileNotFoundError(f"this run is gone: {folder} is {run.state} {run.why}".rstrip())
    settings, generator = run.settings, load_generator(run.checkpoint)
    trained_on = run.data_set.tissues if run.data_set.exists else tuple(tissues)
    encoding, simulator = (settings.encoding, settings.encoding_seed), settings.simulator
    levels = label_values(trained_on, *encoding)[1:].tolist()
    values = {tissue.name: level for tissue, level in zip(trained_on, levels, strict=True)}
    renderer = Renderer(generator, values, settings.probe, simulator.tgc_db_cm_mhz, simulator.image_shape, {})
    return renderer, label_values(tissues, *encoding)
