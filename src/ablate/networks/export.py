"""A generator as an ONNX file: what OpenVINO, ONNX Runtime and TensorRT take."""

from __future__ import annotations

import json
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

import torch
from torch import Tensor, nn

from ablate.networks.generator import Generator
from ablate.networks.spec import conditions

OPSET = 18
OUTPUT = "image"


def export_onnx(generator: Generator, path: Path, height: int, width: int) -> None:
    """Write a generator as one ONNX file for frames of one size, batch 1, float32.

    The inputs are (1, 1, H, W) each, by name: the maps of `conditions(generator.spec)`, then the noise fields of
    `generator.noise_sizes(height, width)`, for which `generator.draw_noise` or any standard normal numbers serve
    (zeros switch the noise off). The only output, `image`, is (1, 1, H, W) in [-1, 1], not masked. The file's
    metadata hold the specification as JSON under `spec`.

    Parameters
    ----------
    generator : Generator
        On any device; it is not changed.
    path : Path
        Replaced when the new file is whole.
    height, width : int
        Of a frame, px; need not be multiples of anything, padding is part of the file.

    Raises
    ------
    ImportError
        Where the extra `export` is not installed.

    Notes
    -----
    Noise is an input because its hash shifts 64-bit integers, which TensorRT does not do. A size is fixed because
    a probe has one, and because a runtime plans its memory and its kernels for it.
    """
    try:
        import onnx
        import onnxscript  # noqa: F401 (torch's exporter is written in it)
    except ImportError as error:
        raise ImportError(f"export needs the package {error.name}: pip install 'ablate[export]'") from error
    device = next(generator.parameters()).device
    frame = _Frame(generator, height, width)
    sizes = [(height, width)] * len(frame.maps) + list(frame.sizes.values())
    arguments = tuple(torch.zeros(1, 1, *size, device=device) for size in sizes)
    with _quiet_exporter(), torch.no_grad():
        program = torch.onnx.export(
            frame,
            arguments,
            input_names=[*frame.maps, *frame.sizes],
            output_names=[OUTPUT],
            opset_version=OPSET,
            dynamo=True,
            verbose=False,
        )
    assert program is not None
    model = program.model_proto
    onnx.helper.set_model_props(model, {"spec": json.dumps(asdict(generator.spec))})
    onnx.checker.check_model(model, full_check=True)
    unfinished = path.with_name(path.name + ".tmp")
    try:
        onnx.save(model, unfinished)
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)


class _Frame(nn.Module):
    """The generator as a function of tensors alone: its maps, then its noise fields."""

    def __init__(self, generator: Generator, height: int, width: int) -> None:
        super().__init__()
        self.training = False  # of this frame alone: no layer of a generator has a mode
        self.generator = generator
        self.maps, self.sizes = conditions(generator.spec), generator.noise_sizes(height, width)

    def forward(self, *tensors: Tensor) -> Tensor:
        """Render (1, 1, H, W)."""
        given = dict(zip(self.maps, tensors, strict=False))
        return self.generator.render(given, dict(zip(self.sizes, tensors[len(self.maps) :], strict=True)))


@contextmanager
def _quiet_exporter() -> Iterator[None]:
    """Silence what torch's exporter says of packages that are not needed, and of its own deprecated calls."""
    log = logging.getLogger("torch.onnx")
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*LeafSpec.*", category=FutureWarning)
            yield
    finally:
        log.setLevel(level)
