"""Generators that can be picked: those of finished runs, and those that come with the package.

What the viewer knows of a run's folder stands here alone.
"""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ablate import pretrained
from ablate.anatomy import Tissue, load_tissues
from ablate.dataset import label_values
from ablate.pretrained import OUTSIDE, Renderer, values_of
from ablate.setting import naming
from ablate.settings.study import StudySettings
from ablate.study.training import Training, trainings_in
from ablate.training import load_generator, read_checkpoint
from ablate.ultrasound import Probe, SimulatorSettings
from ablate.user_code import check_named
from ablate.viewer.fast_generator import FastGenerator
from ablate.viewer.session import ViewerState
from ablate.viewer.trained import Trained

_LOG = logging.getLogger(__name__)
_SHIPPED = Path("pretrained")
#: Picked in place of a generator: S, A and the lattice of scatterers in closed form.
FORMULA = _SHIPPED / "formula"
#: How a network of the user's own is named on the command line of the viewer.
_NAMED_BY = "variant=custom model.target"


def pickable(folder: Path) -> dict[str, Path]:
    """What `open_generator` opens, by name: the runs of a folder, of SA2H first, those of the package, the formula.

    A run is named by its study, variant and seed; the folder may be a run, a study or a folder of studies.
    """
    found = [Training(folder), *(one for place in (folder, *sorted(folder.glob("*/"))) for one in trainings_in(place))]
    usable = [training for training in found if training.is_trained and training.checkpoint.exists()]
    usable.sort(key=lambda training: training.label != StudySettings.reference)
    named = {f"{training.folder.parent.name}: {training.name}": training.folder.resolve() for training in usable}
    shipped = sorted(pretrained.NAMES, key=lambda name: name != StudySettings.reference)
    named |= {f"comes with ablate: {name}": _SHIPPED / name for name in shipped}
    return named | {"comes with ablate: the formula": FORMULA}


def is_shipped(picked: Path) -> bool:
    """Whether this is a generator that comes with the package."""
    return picked.parent == _SHIPPED


def trained_at(picked: Path) -> int:
    """When the weights of a run were written, ns; 0 of a generator that comes with the package."""
    checkpoint = Training(picked).checkpoint
    return checkpoint.stat().st_mtime_ns if checkpoint.exists() else 0


def first_fitting(
    offered: Mapping[str, Path], tissues: Sequence[Tissue], state: ViewerState, custom: str | None = None
) -> tuple[Path, ...]:
    """The first generator that was trained with the probe, the pixels and the tissues of a state; or nothing.

    Parameters
    ----------
    offered : mapping of str to Path
        As `pickable` gives them. One that cannot be opened is left out, and the log says why in one line.
    tissues : sequence of Tissue
        Of the scene.
    state : ViewerState
        What is to be seen.
    custom : str or None
        As of `open_generator`.
    """
    for picked in (one for one in offered.values() if one != FORMULA):
        try:
            reservation = open_generator(picked, tissues, custom).reservation(state)
        except Exception as error:  # whatever somebody wrote into the files of a run
            _LOG.warning("left out: %s", " ".join(str(error).split()))
            continue
        if not reservation:
            return (picked,)
    return ()


def open_generator(picked: Path, tissues: Sequence[Tissue], custom: str | None = None) -> Trained:
    """Load a generator, to look at a scene with these tissues.

    Tissues of unknown names have the values of their places in this scene's own order; those of known names but other
    properties have the values of the training. Where the data set of a run has been deleted, `tissues` are taken for
    those of the training.

    A run that has been deleted is an OSError, and one whose files are damaged a ValueError; so is one of a network of a
    user's own, unless `custom` is the dotted path of its class.
    """
    if is_shipped(picked):
        renderer = pretrained.load(picked.name)
        trained_on: Sequence[Tissue] = tuple(load_tissues().values())
        scene_values = label_values(tissues, StudySettings.encoding)
        is_known = True
    else:
        run = Training(picked)
        if not run.is_trained:
            raise FileNotFoundError(f"this run is gone: {picked} is {run.state} {run.why}".rstrip())
        is_known = run.data_set.exists
        trained_on = run.data_set.tissues if is_known else tissues
        encoding = run.settings.encoding, run.settings.label_seed
        scene_values = label_values(tissues, *encoding)
        renderer = _renderer_of(run, values_of(trained_on, label_values(trained_on, *encoding)), custom)
    unknown = _not_trained_on(renderer, trained_on, tissues)
    if not is_known:
        unknown = "its data set is gone: labels are taken for those of this scene"
    return Trained(renderer, FastGenerator(renderer.generator), _values(renderer, tissues, scene_values), unknown)


def _renderer_of(run: Training, values: Mapping[str, tuple[float, ...]], custom: str | None) -> Renderer:
    """The generator of a run with the probe and the simulator of its frames."""
    checkpoint = read_checkpoint(run.checkpoint)
    with naming(f"{run.checkpoint}: not the checkpoint of a training: ", (AttributeError, KeyError, TypeError)):
        target = checkpoint["hyper_parameters"]["spec"].get("target")
        check_named(run.checkpoint, target, custom, _NAMED_BY)
        generator = load_generator(run.checkpoint, custom)
    probe, simulator = _frames_of(run)
    return Renderer(generator, values, probe, simulator, made={})


def _frames_of(run: Training) -> tuple[Probe, SimulatorSettings]:
    """Of the data set, where it is still there: its time gain and its sizes may follow from its frames."""
    probe, simulator = run.settings.probe, run.settings.simulator
    if not run.data_set.exists:
        return probe, simulator
    pairs = run.data_set.pairs
    rows, lines = pairs.beam_shape
    simulator = replace(simulator, time_gain_db=run.data_set.time_gain_db, image_shape=pairs.shape, scanlines=lines)
    return pairs.probe or probe, replace(simulator, axial_samples=rows * simulator.samples_per_row)


def _not_trained_on(renderer: Renderer, trained_on: Sequence[Tissue], tissues: Sequence[Tissue]) -> str:
    known = {tissue.name: tissue for tissue in trained_on if tissue.name in renderer.values}
    others = [tissue.name.replace("_", " ") for tissue in tissues if known.get(tissue.name) != tissue]
    return f"not trained on {', '.join(others)}" if others else ""


def _values(renderer: Renderer, tissues: Sequence[Tissue], scene_values: np.ndarray) -> np.ndarray:
    """What the generator reads for each label, (labels, channels) float32; of unknown tissues what the scene gives."""
    width = len(renderer.values[OUTSIDE])
    if scene_values.shape[1] != width:  # the encodings of both scenes have another number of channels
        scene_values = np.zeros((len(scene_values), width))
    scene_tissues = zip(tissues, scene_values[1:].tolist(), strict=True)
    values = [renderer.values.get(tissue.name, value) for tissue, value in scene_tissues]
    return np.array([renderer.values[OUTSIDE], *values], np.float32)
