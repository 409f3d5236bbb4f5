"""A trained generator with all that it needs to render a frame: its weights, its values of labels, and its setting."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ablate import dataset
from ablate.anatomy import Tissue
from ablate.networks import Generator, GeneratorSpec, Space, conditions
from ablate.setting import plain
from ablate.storage import written_whole
from ablate.training import TrainingPrecision, check_class, generate
from ablate.ultrasound import Beam, Frame, Probe, SimulatorSettings, scan_converter
from ablate.ultrasound.settings import probe_from

#: The key of the values outside the fan.
OUTSIDE = ""
_FOLDER = Path(__file__).parent
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
        of other settings are rendered, but not well: the generator has learnt the speckle and the gain of these.
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

        Returns grey levels, (H, W) uint8, 0 outside the fan. A ValueError for a tissue or a probe that was not in the
        training. A frame made elsewhere does not tell its probe, and is refused only for another shape of the fan.

        Parameters
        ----------
        tissues : sequence of Tissue
            Behind the labels 1, 2, ... of the frame's segmentation, as `Scene.tissues`.
        seed : int
            Of the noise: another seed gives other speckle.
        """
        unknown = [tissue.name for tissue in tissues if tissue.name not in self.values]
        if unknown:
            trained_on = ", ".join(name for name in self.values if name != OUTSIDE)
            raise ValueError(f"tissue {unknown[0]!r}: the generator was trained on {trained_on}")
        values = np.asarray([self.values[OUTSIDE], *(self.values[tissue.name] for tissue in tissues)], np.float32)
        own = dataset.label_values(tissues, dataset.Encoding.properties)
        for tissue, here, known in zip(tissues, own[1:], values[1:], strict=True):
            if here.shape == known.shape and not np.allclose(here, known, atol=1e-4):
                raise ValueError(f"tissue {tissue.name!r}: its properties are not those of the training")
        if (largest := int(frame.segmentation.max(initial=0))) > len(tissues):
            raise ValueError(f"the frame has a label {largest}, and there are {len(tissues)} tissues")
        if frame.probe not in (None, self.probe):
            raise ValueError(f"the frame is one of {frame.probe}, the generator was trained with {self.probe}")
        space, mask = self.generator.spec.space, frame.mask
        beam = frame.beam or Beam(frame.segmentation, frame.attenuation)  # which a generator of images does not read
        if space is Space.beam and frame.beam is None:
            raise ValueError("the frame has no maps in beam space, which this generator reads: frame.beam is None")
        rows, lines = beam.segmentation.shape
        converter = scan_converter(self.probe, (rows, lines), (mask.shape[0], mask.shape[1]))
        if (converter.mask != mask).mean() > _LEAST_APART:
            raise ValueError(f"the frame has another fan than the probe of the training, {self.probe}")
        mask = np.ones((rows, lines), bool) if space is Space.beam else mask
        maps = frame.segmentation, frame.attenuation, beam
        read = dataset.maps_read(conditions(self.generator.spec), space, maps, self.probe, self.simulator.time_gain)
        inputs = dataset.network_inputs({name: value[None] for name, value in read.items()}, values, mask)
        noise_seed = torch.tensor([seed], dtype=torch.int64)
        return generate(self.generator, inputs, torch.from_numpy(mask), noise_seed, precision, converter)[0]


def values_of(tissues: Sequence[Tissue], values: np.ndarray) -> dict[str, tuple[float, ...]]:
    """`Renderer.values` from those of `label_values` for the labels of some tissues."""
    names = (OUTSIDE, *(tissue.name for tissue in tissues))
    return dict(zip(names, map(tuple, values.tolist()), strict=True))


def load(name: str | Path, custom: str | None = None) -> Renderer:
    """Load a trained generator, on the CPU: one of `NAMES`, or a file that `save` wrote.

    Where the network is a class of the user's, `custom` is its dotted path: nothing is imported that only the file
    names.

    Raises
    ------
    ValueError
        For another name, and where a file is not one of a trained generator.

    Examples
    --------
    >>> import ablate
    >>> renderer = ablate.load("sa2h")
    >>> renderer.simulator.image_shape, renderer.probe.depth_mm, str(renderer.generator.spec.family)
    ((256, 355), 150.0, 'local')
    """
    path = _FOLDER / f"{name}.pt" if name in NAMES else Path(name)
    if not path.is_file():
        raise ValueError(f"{name}: no trained generator, allowed are {', '.join(NAMES)} and files that `save` wrote")
    try:
        content: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
        check_class(content["spec"]["target"], custom)
        generator = Generator(GeneratorSpec(**content["spec"]), content["labels"])
        generator.load_state_dict(content["weights"])
        values = {name: tuple(of_tissue) for name, of_tissue in content["values"].items()}
        frames = probe_from(content["probe"]), SimulatorSettings(**content["simulator"])
        return Renderer(generator.eval(), values, *frames, content["made"])
    except Exception as error:
        raise ValueError(f"{path}: not a file of a trained generator ({' '.join(str(error).split()):.200})") from error


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
    torch.save(content, held := BytesIO())  # to a path, a full disk is a RuntimeError
    with written_whole(path) as partial:
        partial.write_bytes(held.getbuffer())
