"""Full frames from a trained generator, and how long one takes."""

import math
import time
from collections.abc import Mapping
from statistics import median

import numpy as np
import torch
from torch import Tensor

from ablate.dataset import decode_grey_levels
from ablate.networks import Generator, conditions
from ablate.threads import in_parts, without_teams
from ablate.training.engines import Engine, OpenEngine, open_engine
from ablate.training.hardware import autocast
from ablate.training.settings import TrainingPrecision

# Frames of at most so many pixels are rendered side by side. Larger ones would take too much memory, and a team of
# threads has enough to do with each of them.
_SMALL_FRAME_PX = 1 << 18


def generate(
    generator: Generator,
    maps: Mapping[str, Tensor],
    mask: Tensor,
    noise_seed: Tensor | None,
    precision: TrainingPrecision = TrainingPrecision.auto,
) -> np.ndarray:
    """Render full frames on the generator's device: one at a time, or small ones on a CPU one a thread, side by side.

    Parameters
    ----------
    maps : mapping of (N, 1, H, W) float32
        At least the maps of `conditions(generator.spec)`; others are not read.
    mask : (N, 1, H, W) or (H, W) bool or float
        The fan; outside of it the image is black.
    noise_seed : (N,) int64 or None
        One a frame: the same seed gives the same frame. None renders without noise.

    Returns
    -------
    (N, H, W) uint8

    Raises
    ------
    KeyError
        Where a map that the generator reads is missing.
    ValueError
        Where the generator's output holds NaN or infinite values.
    """
    device = next(generator.parameters()).device
    given = {name: maps[name] for name in conditions(generator.spec)}

    def render(index: int, end: int) -> np.ndarray:
        with torch.inference_mode(), autocast(precision, device):  # both are of the thread that renders
            frame = {name: value[index:end].to(device) for name, value in given.items()}
            seed = None if noise_seed is None else noise_seed[index:end].to(device)
            fan = (mask if mask.ndim == 2 else mask[index, 0]).to(device)
            levels: np.ndarray = decode_grey_levels(generator(**frame, noise_seed=seed)[0, 0], fan).cpu().numpy()
            return levels

    count, pixels = len(given["segmentation"]), math.prod(given["segmentation"].shape[-2:])
    if device.type == "cpu" and count > 1 and pixels <= _SMALL_FRAME_PX:
        with without_teams():
            return np.stack(in_parts(render, count, 1))
    return np.stack([render(index, index + 1) for index in range(count)])


def median_ms_per_frame(
    generator: Generator,
    maps: Mapping[str, Tensor],
    precision: TrainingPrecision = TrainingPrecision.auto,
    repeats: int = 10,
    warmup: int = 3,
    engine: Engine = Engine.eager,
) -> float:
    """Time the generator on the first frame of maps (N, 1, H, W), its noise included, transfers not, in milliseconds.

    Parameters
    ----------
    repeats, warmup : int
        Frames timed, after so many that are not; compiling falls into these, so let there be one.

    Raises
    ------
    RuntimeError
        Where the machine lacks what the engine needs, as `missing_for` says beforehand.
    """
    device = next(generator.parameters()).device
    frame = {name: maps[name][:1].to(device) for name in conditions(generator.spec)}
    height, width = frame["segmentation"].shape[-2:]
    render = open_engine(generator, height, width, precision, engine)
    return median_ms(render, frame, repeats, warmup)


def median_ms(render: OpenEngine, frame: Mapping[str, Tensor], repeats: int, warmup: int) -> float:
    """Time what renders `frame`, maps of (1, 1, H, W) on their device, other noise each time, in milliseconds."""
    device = next(iter(frame.values())).device
    wait = torch.get_device_module(device).synchronize
    times = []
    for index in range(warmup + repeats):
        seed = torch.tensor([index], device=device)
        wait(device)
        start = time.perf_counter()
        render(frame, seed)
        wait(device)
        times.append(1e3 * (time.perf_counter() - start))
    return median(times[warmup:])
