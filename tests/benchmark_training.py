"""Images a second of a training: this project's loop against a plain one of the same networks.

make bench-training
make bench-training ARGS="--variants sa2h --threads 1 --rounds 10"

Ours is `ablate.training.train` on the crops of a data set, as `preset=quick` trains: drawing of crops, logging and
the running average of weights included. The plain one is pix2pix's step in fp32 with plain modules of torch, that
renders each batch once for either network (`--forwards 1`: once for both, as pix2pix's own code does), on the same
crops. Each runs in a process of its own; they take their steps in turns. A ratio is that of two successive steps, and
the median over the rounds is reported. Give it the machine alone.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from statistics import median

import numpy as np
import torch
from torch import Tensor

from ablate.config import StudySettings
from ablate.dataset import CropLoader, Crops, CropSettings, create_pairs, fill_pairs, open_pairs
from ablate.networks import conditions
from ablate.studies.sweep import jobs_of
from ablate.tracking import hardware
from ablate.training import chosen_device, chosen_precision, train
from plain_gan import PlainGAN

SIDES = ("ours", "plain")
FRAMES, WARM_UP = 16, 3
LABELS = np.linspace(-1, 1, 256).astype(np.float32)


def drawn_pairs(folder: Path, shape: tuple[int, int]) -> None:
    """Frames of blocks of tissue with speckle in a fan: what is in a frame does not change what a step costs."""
    rng = np.random.default_rng(0)
    height, width = shape
    across = np.abs(np.linspace(-1, 1, width)) < np.linspace(0.3, 1, height)[:, None]
    pairs = create_pairs(
        folder, np.zeros((FRAMES, 4, 4)), np.arange(FRAMES), np.zeros(FRAMES, np.uint8), across, FRAMES, ["a"], {}
    )

    def render(frames: np.ndarray, maps: frozenset[str]) -> dict[str, np.ndarray]:
        made = {name: rng.integers(1, 255, (len(frames), *shape)) * across for name in maps}
        return {name: values / 255 if name == "attenuation" else values for name, values in made.items()}

    list(fill_pairs(pairs, frozenset({"segmentation", "attenuation", "high", "low"}), render))


def settings_of(arguments: argparse.Namespace) -> StudySettings:
    """What `preset=...` composes to for a variant, with what is asked for otherwise."""
    sizes = {"model.width": arguments.width, "training.batch_size": arguments.batch, "training.crop": arguments.crop}
    given = [f"{key}={value}" for key, value in sizes.items() if value is not None]
    (job,) = jobs_of([f"preset={arguments.preset}", f"variant={arguments.variants[0]}", *given])
    rounds, device, threads = arguments.rounds + WARM_UP, arguments.device, arguments.threads[0]
    training = replace(
        job.settings.training, steps=rounds, device=device, threads=threads, validate_every=0, checkpoint_every=0
    )
    return replace(job.settings, training=training)


def in_turns(batches: Iterable[dict[str, Tensor]], device: torch.device) -> Iterator[dict[str, Tensor]]:
    """Draw a batch when the parent says so, and tell it the milliseconds until the next one is asked for."""
    batches = iter(batches)
    while True:
        sys.stdin.readline()
        started = time.perf_counter()
        batch = next(batches, None)
        if batch is None:
            return
        yield batch
        if device.type == "cuda":
            torch.cuda.synchronize()
        print(1e3 * (time.perf_counter() - started), flush=True)


def take_steps(arguments: argparse.Namespace) -> None:
    """Be one of the two sides: train, a step at each word of the parent's."""
    s = settings_of(arguments)
    device = chosen_device(s.training.device)
    torch.set_num_threads(s.training.threads)
    cut = CropSettings(s.training.crop, s.training.batch_size, s.crops.fan_fraction, s.crops.flip, s.seed)
    pairs = open_pairs(arguments.folder / "data")
    crops = Crops(pairs, np.arange(FRAMES), frozenset(conditions(s.model)), LABELS, cut)

    def loader(start: int, stop: int) -> Iterator[dict[str, Tensor]]:
        return in_turns(CropLoader(crops, start, stop, s.crops.workers), device)

    if arguments.side == "ours":
        with tempfile.TemporaryDirectory(dir=arguments.folder) as run:
            train(s.model, s.training, loader, Path(run), sink=lambda *_: None)
    else:
        gan = PlainGAN(s.model, device)
        for batch in loader(0, s.training.steps):
            gan.step(batch, arguments.forwards)


def compared(arguments: argparse.Namespace) -> dict[str, list[float]]:
    """Milliseconds of the steps of both sides, taken in turns."""
    command = [sys.executable, __file__, *sys.argv[1:], "--folder", str(arguments.folder)]
    own = ["--variants", *arguments.variants, "--threads", str(arguments.threads[0])]
    sides = {
        name: subprocess.Popen(
            [*command, *own, "--side", name], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        for name in SIDES
    }
    times: dict[str, list[float]] = {name: [] for name in SIDES}
    for _ in range(arguments.rounds + WARM_UP):
        for name, process in sides.items():
            assert process.stdin is not None
            assert process.stdout is not None
            print(file=process.stdin, flush=True)
            answer = process.stdout.readline()
            if not answer:
                raise SystemExit(f"{name}: ended early")
            times[name].append(float(answer))
    for process in sides.values():
        process.communicate()
    return {name: taken[WARM_UP:] for name, taken in times.items()}


def main() -> None:
    """Print the table, or be one of its sides."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--variants", nargs="+", default=["sa2h", "nsa2h"])
    parser.add_argument("--threads", type=int, nargs="+", default=[2, 1])
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--forwards", type=int, choices=(1, 2), default=2, help="of the plain generator a step")
    parser.add_argument("--preset", default="quick")
    parser.add_argument("--width", type=float, help="of the networks, if not the preset's")
    parser.add_argument("--batch", type=int)
    parser.add_argument("--crop", type=int)
    parser.add_argument("--device", default="auto", choices=("auto", "cpu", "cuda"))
    parser.add_argument("--side", choices=SIDES, help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.side is not None:
        take_steps(arguments)
        return
    s, device = settings_of(arguments), chosen_device(arguments.device)
    precision = chosen_precision(s.training.precision, device)
    print(f"{hardware()}, torch {torch.__version__}; ours in {precision}. Width {s.model.width:g}, batches of")
    print(
        f"{s.training.batch_size}, crops of {s.training.crop} px; medians of {arguments.rounds} steps taken in turns.\n"
    )
    print("| variant | threads | ours, images/s | plain, images/s | ratio |")
    print("|:--------|--------:|---------------:|----------------:|------:|")
    with tempfile.TemporaryDirectory() as folder:
        arguments.folder = Path(folder)
        drawn_pairs(arguments.folder / "data", s.simulator.image_shape)
        for threads, variant in product(arguments.threads, arguments.variants):
            times = compared(argparse.Namespace(**{**vars(arguments), "threads": [threads], "variants": [variant]}))
            ours, plain = (1e3 * s.training.batch_size / median(times[name]) for name in SIDES)
            ratio = median(b / a for a, b in zip(times["ours"], times["plain"], strict=True))
            print(f"| {variant:7} | {threads:7} | {ours:14.2f} | {plain:15.2f} | {ratio:5.2f} |", flush=True)


if __name__ == "__main__":
    main()
