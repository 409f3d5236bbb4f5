"""Generators that can be picked: those of finished runs, and those that come with the package."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from ablate import pretrained
from ablate.anatomy import Tissue
from ablate.comparison.results import finished_runs
from ablate.dataset import label_values, network_inputs
from ablate.networks import conditions
from ablate.settings.study import StudySettings
from ablate.settings.values import build
from ablate.storage import read_json
from ablate.training import LAST, load_generator
from ablate.ultrasound import Probe, compensated_attenuation
from ablate.ultrasound.probe import pixel_size_mm
from ablate.viewer.exported import FastGenerator
from ablate.viewer.state import State

_SHIPPED = Path("pretrained")


def pickable(folder: Path) -> dict[str, Path]:
    """What `open_generator` opens, by name: the runs of a folder, then those of the package.

    A run is named by its study, variant and seed; the folder may be a run, a study or a folder of studies.
    """
    depths = ("*/*/seed*", "*/seed*", ".")
    found = sorted({path.parent.resolve() for depth in depths for path in folder.glob(f"{depth}/result.json")})
    studies = dict.fromkeys(path.parents[1] for path in found)
    runs = [run for study in studies for run in finished_runs(study) if run.folder.resolve() in found]
    named = {f"{run.folder.parents[1].name}: {run.name}": run.folder for run in runs if (run.folder / LAST).exists()}
    return named | {f"comes with ablate: {name}": _SHIPPED / name for name in pretrained.NAMES}


def is_shipped(picked: Path) -> bool:
    """Whether this is a generator that comes with the package."""
    return picked.parent == _SHIPPED


@dataclass(frozen=True, eq=False)
class Trained:
    """A generator with what it was trained on.

    `values`, (labels,) float32, is what it reads for each label of the scene that is looked at; `unknown` names the
    tissues of that scene that it was not trained on.
    """

    engine: FastGenerator
    probe: Probe
    tgc_db_cm_mhz: float
    image_shape: tuple[int, int]
    values: np.ndarray
    unknown: tuple[str, ...]

    @property
    def reads_low(self) -> bool:
        return "low" in self.reads

    @property
    def reads(self) -> tuple[str, ...]:
        return conditions(self.engine.generator.spec)

    def render(self, maps: Mapping[str, np.ndarray], mask: np.ndarray, probe: Probe, seed: int) -> np.ndarray:
        """The image, (H, W) uint8, from `segmentation`, `attenuation` and, where it reads it, `low`, (H, W) each.

        `mask`, (H, W) bool, is the fan.
        """
        read = {name: value[None] for name, value in maps.items()}
        if "compensated" in self.reads:
            read["compensated"] = compensated_attenuation(read["attenuation"], probe, self.tgc_db_cm_mhz)
        inputs = network_inputs(read, self.values, mask)
        return self.engine.render(inputs, torch.from_numpy(mask), torch.tensor([seed]))

    def reservation(self, state: State) -> str:
        """What this state has that the training had not; empty where nothing."""
        said = []
        if state.probe != self.probe:
            said.append(f"trained with {self.probe.depth_mm:g} mm at {self.probe.frequency_mhz:g} MHz")
        here = pixel_size_mm(state.probe, state.simulator.image_shape)
        there = pixel_size_mm(self.probe, self.image_shape)
        if not np.allclose(here, there, rtol=0.05):
            said.append(f"trained with pixels of {there[0]:.2f} mm, here they are {here[0]:.2f} mm")
        if self.unknown:
            said.append(f"not trained on {', '.join(name.replace('_', ' ') for name in self.unknown)}")
        return "; ".join(said)


def open_generator(picked: Path, tissues: Sequence[Tissue]) -> Trained:
    """Load a generator, to look at a scene with these tissues.

    Raises
    ------
    OSError, ValueError
        In a sentence, when the run has been deleted or its files are damaged.
    """
    if is_shipped(picked):
        shipped = pretrained.load(picked.name)
        values, unknown = _values(shipped.values, label_values(tissues, StudySettings.encoding), tissues)
        made_for = shipped.probe, shipped.tgc_db_cm_mhz, shipped.image_shape
        return Trained(FastGenerator(shipped.generator), *made_for, values, unknown)
    try:
        settings = build(StudySettings, read_json(picked / "spec.json")["settings"])
        data = str(read_json(picked / "result.json")["data"])
        generator = load_generator(picked / LAST)
    except FileNotFoundError as error:
        raise FileNotFoundError(f"this run is gone: {picked} has no {Path(str(error.filename)).name}") from error
    encoding = settings.encoding, settings.encoding_seed
    trained_on = _trained_tissues(picked.parents[2] / "data" / data / "about.json", tissues)
    known = dict(zip((t.name for t in trained_on), label_values(trained_on, *encoding)[1:].tolist(), strict=True))
    values, unknown = _values(known, label_values(tissues, *encoding), tissues)
    simulator = settings.simulator
    return Trained(
        FastGenerator(generator), settings.probe, simulator.tgc_db_cm_mhz, simulator.image_shape, values, unknown
    )


def _values(
    known: Mapping[str, float], own: np.ndarray, tissues: Sequence[Tissue]
) -> tuple[np.ndarray, tuple[str, ...]]:
    """What a network reads for each label, by the names of the tissues, and those that it does not know.

    These have the values of their places in this scene's own order.
    """
    of_scene = [known.get(tissue.name, value) for tissue, value in zip(tissues, own[1:], strict=True)]
    unknown = tuple(tissue.name for tissue in tissues if tissue.name not in known)
    return np.array([own[0], *of_scene], np.float32), unknown


def _trained_tissues(about: Path, otherwise: Sequence[Tissue]) -> Sequence[Tissue]:
    """The tissues of a data set; those of the scene that is looked at where the data set has been deleted."""
    try:
        return [build(Tissue, entry) for entry in read_json(about)["tissues"]]
    except FileNotFoundError:
        return otherwise
    except (KeyError, TypeError) as error:
        raise ValueError(f"{about} is damaged: {error}") from error
