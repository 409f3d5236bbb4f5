"""Full frames from a trained generator, and how long one takes."""

from __future__ import annotations

import time
from collections.abc import Mapping
from statistics import median

import numpy as np
import torch
from torch import Tensor

from ablate.networks import Generator, conditions
from ablate.training.engines import Engine, Render, renderer
from ablate.training.precision import autocast
from ablate.training.settings import Precision


@torch.inference_mode()
def generate(
    generator: Generator,
    maps: Mapping[str, Tensor],
    mask: Tensor,
    noise_seed: Tensor | None,
    precision: Precision = Precision.auto,
) -> np.ndarray:
    """Render full frames, one at a time.

    Parameters
    ----------
    generator : Generator
        Runs where its weights are.
    maps : mapping of (N, 1, H, W) float32
        At least the maps of `conditions(generator.spec)`; others are not read.
    mask : (N, 1, H, W) or (H, W) bool or float
        The fan; outside of it the image is black.
    noise_seed : (N,) int64 or None
        One a frame: the same seed gives the same frame. None renders without noise.
    precision : Precision

    Returns
    -------
    (N, H, W) uint8

    Raises
    ------
    KeyError
        Where a map that the generator reads is missing.
    """
    device = next(generator.parameters()).device
    given = {name: maps[name] for name in conditions(generator.spec)}
    frames = []
    with autocast(precision, device):
        for index in range(len(given["segmentation"])):
            frame = {name: value[index : index + 1].to(device) for name, value in given.items()}
            seed = None if noise_seed is None else noise_seed[index : index + 1].to(device)
            fan = (mask if mask.ndim == 2 else mask[index, 0]).to(device)
            frames.append(to_grey_levels(generator(**frame, noise_seed=seed)[0, 0], fan).cpu())
    return torch.stack(frames).numpy()


def to_grey_levels(image: Tensor, mask: Tensor) -> Tensor:
    """Turn (H, W) floats in [-1, 1] to uint8 grey levels, 0 outside `mask`."""
    grey = (image.float() + 1) * 127.5
    return (grey * (mask > 0)).round().clamp(0, 255).to(torch.uint8)


def median_ms_per_frame(
    generator: Generator,
    maps: Mapping[str, Tensor],
    precision: Precision = Precision.auto,
    repeats: int = 10,
    warmup: int = 3,
    engine: Engine = Engine.eager,
) -> float:
    """Time the generator on one frame, batch 1, its noise included, transfers not, in milliseconds.

    Parameters
    ----------
    generator : Generator
    maps : mapping of (N, 1, H, W) float32
        The first frame is used.
    precision : Precision
    repeats, warmup : int
        Frames timed, after so many that are not; compiling falls into these, so let there be one.
    engine : Engine
        `missing_for` tells beforehand whether this machine can run it.

    Raises
    ------
    RuntimeError
        Where the machine lacks what the engine needs.
    """
    device = next(generator.parameters()).device
    frame = {name: maps[name][:1].to(device) for name in conditions(generator.spec)}
    height, width = frame["segmentation"].shape[-2:]
    render = renderer(generator, height, width, precision, engine)
    return median_ms(render, frame, repeats, warmup)


def median_ms(render: Render, frame: Mapping[str, Tensor], repeats: int, warmup: int) -> float:
    """Time what renders `frame`, maps of (1, 1, H, W) on their device, other noise each time, in milliseconds."""
    device = next(iter(frame.values())).device
    times = []
    for index in range(warmup + repeats):
        seed = torch.tensor([index], device=device)
        _wait(device)
        start = time.perf_counter()
        render(frame, seed)
        _wait(device)
        times.append(1e3 * (time.perf_counter() - start))
    return median(times[warmup:])


def _wait(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)
