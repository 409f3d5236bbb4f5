"""Full frames from a generator: the device, the arithmetic, and torch as it is, or OpenVINO from a file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from enum import StrEnum
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from ablate.dataset import decode_grey_levels, network_inputs, noise_seeds
from ablate.extras import installing
from ablate.networks import Family, Generator, Space, conditions, export_onnx
from ablate.threads import in_parts, without_teams
from ablate.training.settings import TrainingPrecision

if TYPE_CHECKING:
    from ablate.dataset import Pairs
    from ablate.ultrasound import ScanConverter  # only here: it is compiled, and images need none

# Takes the maps, (1, 1, H, W) each, and the noise's seed, (1,) int64; gives the image, (1, 1, H, W) in [-1, 1].
OpenEngine = Callable[[Mapping[str, Tensor], Tensor], Tensor]
# Larger frames are not rendered side by side: they take too much memory, and a team of threads has enough to do.
_SMALL_FRAME_PX = 1 << 18


def chosen_device(device: str) -> torch.device:
    """Turn `auto`, `cpu` or `cuda` into a device; RuntimeError where `cuda` is asked for and there is none."""
    if device == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if device == "cuda" and not torch.cuda.is_available():
        raise RuntimeError("device=cuda: this machine has no usable GPU, allowed are cpu and auto")
    return torch.device(device)


def chosen_precision(precision: TrainingPrecision, device: torch.device) -> TrainingPrecision:
    """Turn `auto` into bf16 where the device multiplies it in hardware, else into fp32.

    On a CPU that means AVX-512 BF16 or AMX: one without them converts every operand and is slower than in fp32.
    """
    if TrainingPrecision(precision) is not TrainingPrecision.auto:
        return TrainingPrecision(precision)
    if device.type == "cuda":
        fast = torch.cuda.is_bf16_supported(including_emulation=False)
    else:
        probes = ("_is_avx512_bf16_supported", "_is_amx_tile_supported")
        fast = any(getattr(torch.cpu, probe, lambda: False)() for probe in probes)
    return TrainingPrecision.bf16 if fast else TrainingPrecision.fp32


def autocast(precision: TrainingPrecision, device: torch.device) -> AbstractContextManager[object]:
    """Compute convolutions in `precision` within this context."""
    enabled = chosen_precision(precision, device) is TrainingPrecision.bf16
    return torch.autocast(device.type, torch.bfloat16, enabled=enabled)


class Engine(StrEnum):
    """`eager`: torch; `exported`: OpenVINO, on a CPU, from the ONNX file."""

    eager = "eager"
    exported = "exported"


def missing_for(engine: Engine, device: torch.device) -> str | None:
    """Say in a few words what this machine lacks to run an engine on a device; None if nothing."""
    if Engine(engine) is Engine.eager:
        return None
    if device.type != "cpu":
        return "a CPU: on a GPU, take the exported file to TensorRT or ONNX Runtime"
    lacking = [name for name in ("onnx", "onnxscript", "openvino") if find_spec(name) is None]
    return f"the package {lacking[0]}: {installing('export')}" if lacking else None


def open_engine(
    generator: Generator,
    height: int,
    width: int,
    precision: TrainingPrecision = TrainingPrecision.auto,
    engine: Engine = Engine.eager,
) -> OpenEngine:
    """Make a function that renders one frame, on the generator's device.

    Maps beyond `conditions(generator.spec)` are not read. Exporting takes its time here.

    Parameters
    ----------
    generator : Generator
        It is put in evaluation mode.
    height, width : int
        Size of the frame, px.
    precision : TrainingPrecision
        Of the convolutions.
    engine : Engine
        What computes them.

    Raises
    ------
    RuntimeError
        Where the machine lacks what the engine needs.
    """
    device = next(generator.eval().parameters()).device
    lacking = missing_for(engine, device)
    if lacking is not None:
        raise RuntimeError(f"engine={engine}: needs {lacking}")
    if engine == Engine.exported:
        with TemporaryDirectory() as folder:
            path = Path(folder) / "model.onnx"
            export_onnx(generator, path, height, width)
            return open_exported(generator, path, precision)
    names = conditions(generator.spec)

    @torch.inference_mode()
    def render(maps: Mapping[str, Tensor], seed: Tensor) -> Tensor:
        with autocast(precision, device):
            return generator(**{name: maps[name] for name in names}, noise_seed=seed)

    return render


@cache
def openvino_core() -> Any:
    """Return the process's `openvino.Core`, which is never freed.

    A core gives the thread that makes it a stack for signal handlers, and frees it with itself. Of two cores the second
    gives back the first one's, freed: the next signal, Ctrl-C too, is a segmentation fault (OpenVINO 2026.4, Linux).
    """
    import openvino

    return openvino.Core()


def open_exported(
    generator: Generator, path: Path, precision: TrainingPrecision = TrainingPrecision.auto
) -> OpenEngine:
    """Make a function that renders with OpenVINO from a file of `export_onnx`, on as many threads as torch has.

    The generator draws the noise, of which the file is given the fields; its weights are not used.
    """
    is_bf16 = chosen_precision(precision, torch.device("cpu")) is TrainingPrecision.bf16
    options = {
        "INFERENCE_PRECISION_HINT": "bf16" if is_bf16 else "f32",
        "INFERENCE_NUM_THREADS": torch.get_num_threads(),
        "PERFORMANCE_HINT": "LATENCY",
    }
    compiled = openvino_core().compile_model(path, "CPU", options)
    names = conditions(generator.spec)

    @without_teams()  # torch's threads go on spinning after the noise, on the cores that OpenVINO needs
    @torch.inference_mode()
    def render(maps: Mapping[str, Tensor], seed: Tensor) -> Tensor:
        given = {name: maps[name] for name in names}
        height, width = maps["segmentation"].shape[-2:]
        given |= generator.draw_noise(seed, height, width)
        image = compiled({name: value.numpy() for name, value in given.items()})
        return torch.from_numpy(image[0])

    return render


def generate(
    generator: Generator,
    maps: Mapping[str, Tensor],
    mask: Tensor,
    noise_seed: Tensor | None,
    precision: TrainingPrecision = TrainingPrecision.auto,
    converter: ScanConverter | None = None,
) -> np.ndarray:
    """Render full frames on the generator's device: one at a time, or small ones on a CPU one a thread, side by side.

    A network of the user's, which may keep what it computes on itself, always renders one at a time.

    Parameters
    ----------
    generator : Generator
        In evaluation mode.
    maps : mapping of (N, 1, H, W) float32
        At least the maps of `conditions(generator.spec)`; others are not read. The segmentation has one channel or
        more, as the generator reads it.
    mask : (N, 1, H, W), (N, H, W) or (H, W) bool or float
        The fan; outside of it the image is black.
    noise_seed : (N,) int64 or None
        One a frame: the same seed gives the same frame. None renders without noise.
    precision : TrainingPrecision
        Of the convolutions.
    converter : ScanConverter, optional
        Makes images of the frames of a generator in beam space; without it they stay there.

    Returns
    -------
    (N, H, W) uint8
        Grey levels.

    Raises
    ------
    KeyError
        If a map is missing.
    ValueError
        If the generator is in training mode, the mask has another shape than the maps, or the generator's output is
        not finite.
    """
    if generator.training:
        raise ValueError("generator: in training mode; `generator.eval()` ends it")
    device = next(generator.parameters()).device
    count, _, height, width = maps["segmentation"].shape
    if tuple(mask.shape) not in {(height, width), (count, height, width), (count, 1, height, width)}:
        raise ValueError(f"mask: shape {tuple(mask.shape)}, allowed is that of the maps, or one of (H, W) for all")
    given = {name: maps[name] for name in conditions(generator.spec)}
    fans = mask.reshape(-1, height, width).expand(count, height, width)

    def render(index: int, end: int) -> np.ndarray:
        with torch.inference_mode(), autocast(precision, device):  # both are of the thread that renders
            frame = {name: value[index:end].to(device) for name, value in given.items()}
            seed = None if noise_seed is None else noise_seed[index:end].to(device)
            image = generator(**frame, noise_seed=seed)[0, 0]
            levels: np.ndarray = decode_grey_levels(image, fans[index].to(device)).cpu().numpy()
            return levels

    ours = generator.spec.family is not Family.custom
    if ours and device.type == "cpu" and count > 1 and height * width <= _SMALL_FRAME_PX:
        with without_teams():
            frames = np.stack(in_parts(render, count, 1))
    else:
        frames = np.stack([render(index, index + 1) for index in range(count)])
    return converter.to_image(frames) if converter and generator.spec.space is Space.beam else frames


def generated_images(
    generator: Generator,
    pairs: Pairs,
    values: np.ndarray,
    precision: TrainingPrecision,
    noise_of: np.ndarray | None = None,
    shown_in: Space = Space.image,
) -> Callable[..., np.ndarray]:
    """An `ImageSource` of a generator on a data set; the noise depends on frame number and draw.

    A generator in beam space renders there, and its frames are scan-converted unless they are shown there.

    Parameters
    ----------
    generator : Generator
        In evaluation mode.
    pairs : Pairs
        Where the maps of a frame are read, unless they are given with it.
    values : (labels + 1, channels) float32
        What the generator reads for each label, `label_values`.
    precision : TrainingPrecision
        Of the convolutions.
    noise_of : (frames,) int, optional
        For each frame the number whose noise it has, in place of its own.
    shown_in : Space
        Of the frames that are returned; those of a generator on images are images.

    Returns
    -------
    callable
        Takes the numbers of frames, (N,) int, and of the draw, and gives (N, H, W) uint8.
    """
    space = generator.spec.space
    mask = pairs.mask(space)
    converter = pairs.converter if space is Space.beam and shown_in is Space.image else None

    def render(frames: np.ndarray, draw: int, given: Mapping[str, np.ndarray] | None = None) -> np.ndarray:
        maps = given or {name: pairs.read(name, frames, space) for name in conditions(generator.spec)}
        seeds = torch.from_numpy(noise_seeds(frames if noise_of is None else noise_of[frames], draw))
        inputs = network_inputs(maps, values, mask)
        return generate(generator, inputs, torch.from_numpy(mask), seeds, precision, converter)

    return render
