"""Images a second of a training: this project's loop against a plain one of the same networks.

make bench-training
make bench-training ARGS="--variants sa2h --threads 1 --rounds 10"

Ours is `ablate.training.train` on the crops of a data set, as `preset=quick` trains: drawing of crops, logging and
the running average of weights included. The plain one is pix2pix's step in fp32 with plain modules of torch, on the
same crops and with the same losses. It renders each batch once for either network (`--forwards 1`: once for both, as
pix2pix's own code does). Each runs in a process of its own; they take their steps in turns. A ratio is that of two
successive steps, and the median over the rounds is reported.

On one thread of a CPU, processor time is measured, which other processes change little; otherwise the clock decides,
and the machine should have nothing else to do.
"""

import argparse
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import product
from multiprocessing import Pipe, get_context
from multiprocessing.connection import Connection
from pathlib import Path
from statistics import median

import numpy as np
import torch
from torch import Tensor

from ablate.command.compose import jobs_of
from ablate.dataset import CropLoader, Crops, CropSettings, PlacedFrames, StoredAs, create_pairs, fill_pairs, open_pairs
from ablate.networks import conditions, draws_noise
from ablate.settings.study import StudySettings
from ablate.study.provenance import hardware
from ablate.training import Reconstruction, TrainingPrecision, chosen_device, chosen_precision, train
from plain_training import PlainGAN
from yardstick import ABOUT, Yardstick

Times = list[list[float]]
SIDES = ("ours", "plain")
FRAMES, WARM_UP = 16, 3
LABELS = np.linspace(-1, 1, 256).astype(np.float32)[:, None]


def drawn_pairs(folder: Path, shape: tuple[int, int]) -> None:
    """Frames of blocks of tissue with speckle in a fan: what is in a frame does not change what a step costs."""
    rng = np.random.default_rng(0)
    height, width = shape
    across = np.abs(np.linspace(-1, 1, width)) < np.linspace(0.3, 1, height)[:, None]
    placed = PlacedFrames(np.zeros((FRAMES, 4, 4)), np.arange(FRAMES), np.zeros(FRAMES, np.uint8), across)
    pairs = create_pairs(folder, placed, StoredAs(FRAMES, ["a"]), {})

    def render(frames: np.ndarray, maps: frozenset[str]) -> dict[str, np.ndarray]:
        made = {name: rng.integers(1, 255, (len(frames), *shape)) * across for name in maps}
        return {name: values / 255 if name == "attenuation" else values for name, values in made.items()}

    list(fill_pairs(pairs, frozenset({"segmentation", "attenuation", "target", "low"}), render))


def settings_of(arguments: argparse.Namespace) -> StudySettings:
    """What `preset=...` composes to for a variant, with what is asked for otherwise."""
    image_space = {
        "space": "image",
        "attenuation": "integral",
        "position": "none",
        "interfaces": "none",
        "grain": "output",
        "fold": "none",
    }
    if "att" in arguments.variants[0]:
        del image_space["attenuation"]
    given = [f"training.precision={arguments.precision}", "encoding=echogenicity"]
    given += [f"model.{key}={value}" for key, value in image_space.items()]
    (job,) = jobs_of([f"preset={arguments.preset}", f"variant={arguments.variants[0]}", *given])
    steps, device, threads = arguments.rounds + WARM_UP + 1, arguments.device, arguments.threads[0]
    training = replace(
        job.settings.training, steps=steps, device=device, threads=threads, validate_every=0, checkpoint_every=0
    )
    return replace(job.settings, training=training)


def in_turns(
    batches: Iterable[dict[str, Tensor]], device: torch.device, parent: Connection
) -> Iterator[dict[str, Tensor]]:
    """Draw a batch when the parent says so, and tell it the milliseconds until the next one is asked for."""
    clock = time.process_time if device.type == "cpu" and torch.get_num_threads() == 1 else time.perf_counter
    batches = iter(batches)
    while parent.recv():
        started = clock()
        yield next(batches)
        if device.type == "cuda":
            torch.cuda.synchronize()
        parent.send(1e3 * (clock() - started))
    yield from batches  # the last, after which none is asked for: it is not timed


def take_steps(arguments: argparse.Namespace, side: str, parent: Connection) -> None:
    """Be one of the two sides: train, a step at each word of the parent's."""
    s = settings_of(arguments)
    device = chosen_device(s.training.device)
    torch.set_num_threads(s.training.threads)
    cut = CropSettings(s.training.crop, s.training.batch_size, s.crops.fan_fraction, s.crops.flip, s.seed)
    pairs = open_pairs(arguments.folder / "data")
    crops = Crops(pairs, np.arange(FRAMES), frozenset(conditions(s.model)), LABELS, cut)

    def loader(start: int, stop: int) -> Iterator[dict[str, Tensor]]:
        return in_turns(CropLoader(crops, start, stop, s.crops.workers), device, parent)

    if side == "ours":
        with tempfile.TemporaryDirectory(dir=arguments.folder) as run:
            train(s.model, s.training, loader, Path(run), sink=lambda *_: None)
    else:
        gan = PlainGAN(s.model, device, s.training.reconstruction is Reconstruction.crps and draws_noise(s.model))
        for batch in loader(0, s.training.steps):
            gan.step(batch, arguments.forwards)


def in_processes(arguments: argparse.Namespace, variant: str, threads: int, yardstick: Yardstick) -> Times:
    """Milliseconds of the steps of both sides, taken in turns with the yardstick, the warm-up apart."""
    asked = argparse.Namespace(**vars(arguments) | {"variants": [variant], "threads": [threads]})
    pipes, processes = [], []
    for side in SIDES:
        ours, theirs = Pipe()
        process = get_context("spawn").Process(target=take_steps, args=(asked, side, theirs), daemon=True)
        process.start()
        theirs.close()  # so that a side that ends early is told
        pipes.append(ours)
        processes.append(process)
    taken: Times = [[] for _ in SIDES]
    for _ in range(arguments.rounds + WARM_UP):
        for pipe, times in zip(pipes, taken, strict=True):
            pipe.send(True)
            times.append(pipe.recv())
        yardstick.tick()
    for pipe, process in zip(pipes, processes, strict=True):
        pipe.send(False)
        process.join()
    del yardstick.convolutions[:WARM_UP], yardstick.loops[:WARM_UP]
    return [times[WARM_UP:] for times in taken]


def ratio(numerator: Sequence[float], denominator: Sequence[float]) -> float:
    """Median of the ratios of successive steps."""
    return median(a / b for a, b in zip(numerator, denominator, strict=True))


def compare(arguments: argparse.Namespace, batch: int) -> None:
    """Print the table of both loops."""
    print("| variant | threads | ours, images/s | plain, images/s | ratio | a step of ours        |")
    print("|:--------|--------:|---------------:|----------------:|------:|:----------------------|")
    for threads, variant in product(arguments.threads, arguments.variants):
        yardstick = Yardstick()
        both = in_processes(arguments, variant, threads, yardstick)
        ours, plain = (f"{1e3 * batch / median(times):.2f}" for times in both)
        cells = f"{variant:7} | {threads:7} | {ours:>14} | {plain:>15} | {ratio(both[1], both[0]):5.2f}"
        print(f"| {cells} | {yardstick.text(both[0]):21} |", flush=True)
    print(f"\n{ABOUT}")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--variants", nargs="+", default=["sa2h", "nsa2h"])
    parser.add_argument("--threads", type=int, nargs="+", default=[2, 1])
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--forwards", type=int, choices=(1, 2), default=2, help="of the plain generator a step")
    parser.add_argument("--preset", default="quick")
    parser.add_argument("--precision", default="auto", choices=list(TrainingPrecision))
    parser.add_argument("--device", default="auto", choices=("auto", "cpu", "cuda"))
    arguments = parser.parse_args()
    s = settings_of(arguments)
    precision = chosen_precision(s.training.precision, chosen_device(arguments.device))
    print(f"{hardware()}, torch {torch.__version__}; ours in {precision}. Width {s.model.width:g}, batches of")
    print(
        f"{s.training.batch_size}, crops of {s.training.crop} px; medians of {arguments.rounds} steps taken in turns.\n"
    )
    with tempfile.TemporaryDirectory() as folder:
        arguments.folder = Path(folder)
        drawn_pairs(arguments.folder / "data", s.simulator.image_shape)
        compare(arguments, s.training.batch_size)


if __name__ == "__main__":
    main()
