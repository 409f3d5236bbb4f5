"""A trained generator with all that it needs to render a frame: its weights, its values of labels, and its setting."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ablate.anatomy import Tissue
from ablate.dataset import network_inputs
from ablate.networks import Generator, GeneratorSpec, conditions
from ablate.setting import plain
from ablate.storage import written_whole
from ablate.training import TrainingPrecision, generate
from ablate.ultrasound import Frame, Probe, compensated_attenuation
from ablate.ultrasound.settings import probe_from

_FOLDER = Path(__file__).parent
#: The generators that come with the package; the README.md beside them says how each was trained.
NAMES = tuple(sorted(path.stem for path in _FOLDER.glob("*.pt")))


@dataclass(frozen=True, eq=False)
class Renderer:
    """A trained generator and the setting that it was trained in.

    Attributes
    ----------
    values : mapping of str to float
        The value in [-1, 1] that the generator reads for each tissue.
    probe, tgc, image_shape
        Of its training frames. Frames of another size in pixels or millimetres are rendered, but not well: the
        generator has learnt the speckle of these.
    made : mapping of str to str
        Study, variant, seed and commit of the training.
    """

    generator: Generator
    values: Mapping[str, float]
    probe: Probe
    tgc: float | tuple[float, ...]
    image_shape: tuple[int, int]
    made: Mapping[str, str]

    def render(self, frame: Frame, tissues: Sequence[Tissue], seed: int = 0) -> np.ndarray:
        """Render a frame from its segmentation and its attenuation map; its image is not read.

        Parameters
        ----------
        tissues : sequence of Tissue
            Behind the labels 1, 2, ... of the frame's segmentation, as `Scene.tissues`.
        seed : int
            Of the noise: another seed gives other speckle.

        Returns
        -------
        (H, W) uint8
            Grey levels, 0 outside the fan.

        Raises
        ------
        ValueError
            For a tissue that the generator was not trained on.

        Examples
        --------
        >>> import numpy as np
        >>> from ablate.anatomy import load_tissues
        >>> from ablate.ultrasound import ConvexProbe, fan_mask
        >>> mask = fan_mask(ConvexProbe(), (64, 89))
        >>> nothing = np.zeros((64, 89), np.uint8)
        >>> frame = Frame(mask.astype(np.uint8), 0.5 * mask.astype(np.float32), nothing, mask, nothing)
        >>> image = load("sa2h").render(frame, [load_tissues()["soft_tissue"]])
        >>> image.shape, image.dtype, bool((image[~mask] == 0).all())
        ((64, 89), dtype('uint8'), True)
        """
        unknown = [tissue.name for tissue in tissues if tissue.name not in self.values]
        if unknown:
            raise ValueError(f"tissue {unknown[0]!r}: the generator was trained on {', '.join(self.values)}")
        values = np.asarray([-1.0, *(self.values[tissue.name] for tissue in tissues)], np.float32)
        maps = {
            "segmentation": frame.segmentation[None],
            "attenuation": frame.attenuation[None],
            "compensated": compensated_attenuation(frame.attenuation[None], self.probe, self.tgc),
        }
        read = {name: maps[name] for name in conditions(self.generator.spec)}
        inputs, mask = network_inputs(read, values, frame.mask), torch.from_numpy(frame.mask)
        noise_seed = torch.tensor([seed], dtype=torch.int64)
        return generate(self.generator, inputs, mask, noise_seed, TrainingPrecision.fp32)[0]


def load(name: str | Path) -> Renderer:
    """Load a trained generator, on the CPU: one of `NAMES`, or a file that `save` wrote.

    Raises
    ------
    ValueError
        For another name, and where a file is not one of a trained generator.

    Examples
    --------
    >>> import ablate
    >>> renderer = ablate.load("sa2h")
    >>> renderer.image_shape, renderer.probe.depth_mm, str(renderer.generator.spec.family)
    ((256, 355), 150.0, 'local')
    """
    path = _FOLDER / f"{name}.pt" if name in NAMES else Path(name)
    if not path.is_file():
        raise ValueError(f"{name}: no trained generator, allowed are {', '.join(NAMES)} and files that `save` wrote")
    try:
        content: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
        generator = Generator(GeneratorSpec(**content["spec"]))
        generator.load_state_dict(content["weights"])
        setting = (content["values"], probe_from(content["probe"]), content["tgc"])
        return Renderer(generator.eval(), *setting, tuple(content["image_shape"]), content["made"])
    except Exception as error:
        raise ValueError(f"{path}: not a file of a trained generator ({' '.join(str(error).split()):.200})") from error


def save(renderer: Renderer, path: Path) -> None:
    """Write a trained generator to a file that `load` reads; the file holds no code.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     save(load("sa2h"), Path(folder, "mine.pt"))
    ...     load(Path(folder, "mine.pt")).made["variant"]
    'sa2h'
    """
    content = {
        "spec": plain(renderer.generator.spec),
        "weights": renderer.generator.state_dict(),
        "values": dict(renderer.values),
        "probe": plain(renderer.probe),
        "tgc": renderer.tgc,
        "image_shape": list(renderer.image_shape),
        "made": dict(renderer.made),
    }
    with written_whole(path) as partial:
        torch.save(content, partial)
