"""A trained generator with all that it needs to render a frame: its weights, its values of labels, and its setting."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ablate import dataset
from ablate.anatomy import Tissue, load_tissues
from ablate.networks import Generator, GeneratorSpec, Space, conditions, read_stored, stored_generator
from ablate.pretrained.other_settings import trained_with
from ablate.setting import did_you_mean, plain, settings_of
from ablate.training import TrainingPrecision, generate
from ablate.training.checkpoint import write_weights
from ablate.ultrasound import Beam, Frame, Probe, SimulatorSettings, scan_converter
from ablate.ultrasound.settings import probe_from
from ablate.user_code import UnnamedCodeError, check_named

#: The key of the values outside the fan.
OUTSIDE = ""
_FOLDER = Path(__file__).parent
_SIMULATOR = frozenset(one.name for one in settings_of(SimulatorSettings))
_LEAST_APART = 0.001  # of the pixels of two fans that are not the same
#: The generators that come with the package; the README.md beside them says how each was trained.
NAMES = tuple(sorted(path.stem for path in _FOLDER.glob("*.pt")))


@dataclass(frozen=True, eq=False)
class Renderer:
    """A trained generator and the setting that it was trained in.

    Attributes
    ----------
    values : mapping of str to tuple of float
        The values in [-1, 1] that the generator reads for each tissue, and `OUTSIDE` for those outside the fan.
    probe, simulator
        Of its training frames: `Simulator(scene, renderer.probe, renderer.simulator)` makes frames as they were. Frames
        of other settings are rendered, with a warning and not well: the generator has learnt the speckle and the gain
        of these.
    made : mapping of str to str
        Study, variant, seed and commit of the training.
    """

    generator: Generator
    values: Mapping[str, tuple[float, ...]]
    probe: Probe
    simulator: SimulatorSettings
    made: Mapping[str, str]

    def render(
        self,
        frame: Frame,
        tissues: Sequence[Tissue],
        seed: int = 0,
        precision: TrainingPrecision = TrainingPrecision.fp32,
    ) -> np.ndarray:
        """Render a frame from its maps, in the space that the generator works in; its image is not read.

        Parameters
        ----------
        frame : Frame
            One made elsewhere, which does not tell its probe and its settings, is refused only for another shape of the
            fan, and nothing is said of its settings.
        tissues : sequence of Tissue
            Behind the labels 1, 2, ... of the frame's segmentation, as `Scene.tissues`.
        seed : int
            Of noise by pixel. With `noise=body` the frame's own grain decides, of which `Simulator.grain` makes others.
        precision : TrainingPrecision
            Of the convolutions.

        Returns
        -------
        (H, W) uint8
            Grey levels, 0 outside the fan.

        Raises
        ------
        ValueError
            For a tissue or a probe that was not in the training.

        Warns
        -----
        UserWarning
            Where the settings of the frame change what the network sees: it names them, with their two values.
        """
        values = self._values_of_labels(tissues)
        largest_label = int(frame.segmentation.max(initial=0))
        if largest_label > len(tissues):
            raise ValueError(f"the frame has a label {largest_label}, and there are {len(tissues)} tissues")
        if frame.probe not in (None, self.probe):
            raise ValueError(f"the frame is one of {frame.probe}, the generator was trained with {self.probe}")
        space = self.generator.spec.space
        if frame.simulator is not None:
            said = trained_with((self.probe, self.simulator), (self.probe, frame.simulator), space)
            if said:
                warnings.warn(f"the generator was {said}: it renders this frame worse", UserWarning, stacklevel=2)
        if space is Space.beam and frame.beam is None:
            raise ValueError("the frame has no maps in beam space, which this generator reads: frame.beam is None")
        beam = frame.beam or Beam(frame.segmentation, frame.attenuation)  # which a generator of images does not read
        rows, lines = beam.segmentation.shape
        converter = scan_converter(self.probe, (rows, lines), (frame.mask.shape[0], frame.mask.shape[1]))
        if (converter.mask != frame.mask).mean() > _LEAST_APART:
            raise ValueError(f"the frame has another fan than the probe of the training, {self.probe}")
        maps = dataset.maps_read(
            conditions(self.generator.spec),
            space,
            (frame.segmentation, frame.attenuation, beam),
            self.probe,
            self.simulator.time_gain,
        )
        mask = np.ones((rows, lines), bool) if space is Space.beam else frame.mask
        inputs = dataset.network_inputs({name: value[None] for name, value in maps.items()}, values, mask)
        noise_seed = torch.tensor([seed], dtype=torch.int64)
        return generate(self.generator, inputs, torch.from_numpy(mask), noise_seed, precision, converter)[0]

    def _values_of_labels(self, tissues: Sequence[Tissue]) -> np.ndarray:
        """What the generator reads for the labels 0, 1, ..., (labels, channels) float32."""
        unknown = [tissue.name for tissue in tissues if tissue.name not in self.values]
        if unknown:
            trained_on = ", ".join(name for name in self.values if name != OUTSIDE)
            raise ValueError(f"tissue {unknown[0]!r}: the generator was trained on {trained_on}")
        values = np.asarray([self.values[OUTSIDE], *(self.values[tissue.name] for tissue in tissues)], np.float32)
        property_values = dataset.label_values(tissues, dataset.Encoding.properties)
        for tissue, expected, trained in zip(tissues, property_values[1:], values[1:], strict=True):
            if expected.shape == trained.shape and not np.allclose(expected, trained, atol=1e-4):
                raise ValueError(f"tissue {tissue.name!r}: its properties are not those of the training")
        return values


def values_of(tissues: Sequence[Tissue], values: np.ndarray) -> dict[str, tuple[float, ...]]:
    """`Renderer.values` from those of `label_values` for the labels of some tissues."""
    names = (OUTSIDE, *(tissue.name for tissue in tissues))
    return dict(zip(names, map(tuple, values.tolist()), strict=True))


def load(name: str | Path, custom: str | None = None) -> Renderer:
    """Load a trained generator, on the CPU: one of `NAMES`, or a file that `save` wrote.

    A file of somebody else runs no code. One of a network of its maker's own names a class, as
    `my_package.MyGenerator`, which is imported only if `custom` names it too.

    Raises
    ------
    ValueError
        For another name, where a file is not one of a trained generator, and where it names a class that `custom` does
        not name.

    Examples
    --------
    >>> import ablate
    >>> renderer = ablate.load("sa2h")
    >>> renderer.simulator.image_shape, renderer.probe.depth_mm, str(renderer.generator.spec.family)
    ((256, 355), 150.0, 'local')
    """
    path = _FOLDER / f"{name}.pt" if name in NAMES else Path(name)
    if not path.is_file():
        files = "files such as network.pt among the artifacts of a run in MLflow"
        raise ValueError(
            f"{name}: no trained generator, allowed are {', '.join(NAMES)} and {files}{did_you_mean(name, NAMES)}"
        )
    try:
        content: dict[str, Any] = read_stored(path)
        target = dict(content["spec"]).get("target")
        check_named(path, target, custom, "custom")
        renderer = _renderer_of(content)
        return _with_newer_tissues(renderer) if name in NAMES else renderer
    except UnnamedCodeError:
        raise
    except Exception as error:
        raise ValueError(f"{path}: not a file of a trained generator ({' '.join(str(error).split()):.200})") from error


def _renderer_of(content: Mapping[str, Any]) -> Renderer:
    """The renderer whose file holds this."""
    generator = stored_generator(GeneratorSpec(**content["spec"]), content["labels"], content["weights"])
    return Renderer(
        generator=generator.eval(),
        values={name: tuple(map(float, numbers)) for name, numbers in content["values"].items()},
        probe=probe_from(content["probe"]),
        # a setting that is no more, as files of earlier versions have, says nothing of frames made here
        simulator=SimulatorSettings(**{k: v for k, v in content["simulator"].items() if k in _SIMULATOR}),
        made=content["made"],
    )


def _with_newer_tissues(renderer: Renderer) -> Renderer:
    """The renderer with values for tissues that came into the built-in table after its training.

    A new tissue is read as its own properties or, where labels are read by their order, as the next darker one that was
    trained on.
    """
    table = list(load_tissues().values())
    own = values_of(table, dataset.label_values(table, dataset.Encoding.properties))
    values, darker = dict(renderer.values), renderer.values[OUTSIDE]
    for tissue in table:
        darker = renderer.values.get(tissue.name, darker)
        values.setdefault(tissue.name, own[tissue.name] if len(own[tissue.name]) == len(darker) else darker)
    return replace(renderer, values=values)


def save(renderer: Renderer, path: Path) -> None:
    """Write a trained generator to a file that `load` reads; the file holds no code."""
    content = {
        "spec": plain(renderer.generator.spec),
        "labels": renderer.generator.labels,
        "weights": renderer.generator.state_dict(),
        "values": {name: list(values) for name, values in renderer.values.items()},
        "probe": plain(renderer.probe),
        "simulator": plain(renderer.simulator),
        "made": dict(renderer.made),
    }
    write_weights(path, content)
