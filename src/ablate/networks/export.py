"""A generator as an ONNX file, for OpenVINO, ONNX Runtime and TensorRT."""

import json
import logging
import warnings
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ablate.extras import installing
from ablate.networks.generator import Generator, copied
from ablate.networks.spec import Space, conditions, map_channels
from ablate.storage import written_whole

OPSET = 18


def export_onnx(generator: Generator, path: Path, height: int, width: int, places: np.ndarray | None = None) -> None:
    """Write a generator, in evaluation mode, as one ONNX file for frames of one size, batch 1, float32.

    The inputs are named. First come the maps of `conditions(generator.spec)`, (1, 1, H, W) each but for the channels of
    the segmentation and of the grain. The noise fields of `generator.noise_sizes(height, width)` follow: standard
    normal numbers, for example of `generator.draw_noise`, or zeros to switch the noise off. The output `image` is
    (1, 1, H, W) in [-1, 1], not masked, in the space that the generator works in; with `places` the file also contains
    the scan conversion, and the output is the image, -1 outside the fan. The metadata hold the specification as JSON
    under `spec`, and the number of channels of the segmentation under `labels`.

    Parameters
    ----------
    generator : Generator
        Its device makes no difference to the file.
    path : Path
        Replaced when the new file is whole.
    height, width : int
        Size of a frame, px, for which a runtime plans its memory. Any is allowed: the file contains the padding.
    places : (image height, image width, 2) float32, optional
        Where the pixels of the image lie in the frame, `ScanConverter.places`.

    Raises
    ------
    ImportError
        If the extra `export` is not installed.
    ValueError
        If there are places and the generator works on images.
    """
    try:
        import onnx
        import onnxscript  # noqa: F401 (torch's exporter is written in it)
    except ImportError as error:
        raise ImportError(f"export needs the package {error.name}: {installing('export')}") from error
    if places is not None and generator.spec.space is not Space.beam:
        raise ValueError(f"places: allowed with model.space=beam, not {generator.spec.space}")
    device = next(generator.parameters()).device
    frame = _Frame(copied(generator), height, width, places).to(device).eval()
    map_shapes = [(1, map_channels(name, generator.labels), height, width) for name in frame.maps]
    noise_shapes = [(1, 1, *size) for size in frame.sizes.values()]
    arguments = tuple(torch.zeros(shape, device=device) for shape in (*map_shapes, *noise_shapes))
    names = [*frame.maps, *frame.sizes]
    for package in ("torch.onnx", "onnxscript"):  # they tell of optional packages, and of weights that stay split
        logging.getLogger(package).setLevel(logging.ERROR)
    with warnings.catch_warnings(), torch.no_grad():
        warnings.filterwarnings("ignore", message=".*LeafSpec.*", category=FutureWarning)  # the exporter's own call
        program = torch.onnx.export(
            frame, arguments, input_names=names, output_names=["image"], opset_version=OPSET, dynamo=True, verbose=False
        )
    assert program is not None
    model = program.model_proto
    metadata = {"spec": json.dumps(asdict(generator.spec)), "labels": str(generator.labels)}
    onnx.helper.set_model_props(model, metadata)
    onnx.checker.check_model(model, full_check=True)
    with written_whole(path) as partial:
        onnx.save(model, partial)


class _Frame(nn.Module):
    """The generator as a function of tensors: first its maps, then its noise fields."""

    places: Tensor | None
    fan: Tensor

    def __init__(self, generator: Generator, height: int, width: int, places: np.ndarray | None) -> None:
        super().__init__()
        self.generator = generator
        self.maps = conditions(generator.spec)
        self.sizes = generator.noise_sizes(height, width)
        self.register_buffer("places", None)
        self.register_buffer("fan", None)
        if places is not None:
            self.places = torch.from_numpy(np.nan_to_num(places))[None]
            self.fan = torch.from_numpy(~np.isnan(places[..., 0])).float()

    def forward(self, *tensors: Tensor) -> Tensor:
        """Render (1, 1, H, W), of the frame or of the image."""
        count = len(self.maps)
        maps = dict(zip(self.maps, tensors[:count], strict=True))
        noise = dict(zip(self.sizes, tensors[count:], strict=True))
        frame = self.generator.render(maps, noise)
        if self.places is None:
            return frame
        image = F.grid_sample(frame, self.places, padding_mode="border", align_corners=True)
        return self.fan * (image + 1) - 1
