"""Milliseconds and memory of a generated frame: eager and exported, in fp32 and bf16, at several widths.

make bench-inference
make bench-inference ARGS="--variant lsa2h --widths 0.25 --size 250 346"
make bench-inference ARGS="--preset quick --widths 0.25 --size 1536 192"    # beam space, rows and scanlines

Every row is measured in a process of its own, so that the peak of its memory is its own; for the exported engine
that process starts from the finished file. Differences are to the eager engine in fp32. Weights are drawn, not
trained: they change neither time nor memory. Give it the machine alone.
"""

import argparse
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import NamedTuple

import numpy as np
import torch

from ablate.anatomy import load_tissues
from ablate.command.compose import jobs_of
from ablate.dataset import label_values
from ablate.dataset.encoding import HALF_RANGE
from ablate.networks import Generator, GeneratorSpec, conditions, count_generator, export_onnx, map_channels
from ablate.study.provenance import hardware
from ablate.training import (
    Engine,
    TrainingPrecision,
    chosen_device,
    chosen_precision,
    missing_for,
    open_engine,
    open_exported,
)
from yardstick import ABOUT, Yardstick, in_own_process, milliseconds, peak_gib

HEAD = (
    "width",
    "parameters",
    "  engine",
    "precision",
    "ms per frame",
    "ready, s",
    "peak, GiB",
    "grey levels apart",
    "yardstick",
)


class Measured(NamedTuple):
    """What one process measured; `before_gib` is what it had without the network."""

    image: np.ndarray
    ms: float
    ready_s: float
    peak_gib: float
    before_gib: float
    yardstick: str


def line(cells: tuple[str, ...]) -> None:
    """Print one row of the table, at once."""
    print("| " + " | ".join(cell.rjust(len(name)) for cell, name in zip(cells, HEAD, strict=True)) + " |", flush=True)


def peak_of(device: torch.device) -> float:
    """GiB of this process so far: memory of the GPU where one is used, else resident memory."""
    return torch.cuda.max_memory_allocated(device) / 2**30 if device.type == "cuda" else peak_gib()


def spec_of(arguments: argparse.Namespace, width: float) -> tuple[GeneratorSpec, int]:
    """The generator of a variant with the maps of a preset, as deep as in the paper's frame; channels of its labels."""
    given = [f"preset={arguments.preset}", f"variant={arguments.variant}", "simulator.image_shape=[1000,1386]"]
    settings = jobs_of(given)[0].settings
    values = label_values(tuple(load_tissues().values()), settings.encoding)
    return replace(settings.model, width=width), values.shape[1]


def drawn_generator(spec: GeneratorSpec, labels: int) -> Generator:
    """A generator with its first weights, its noise switched on."""
    torch.manual_seed(0)
    generator = Generator(spec, labels).eval().requires_grad_(False)
    for name, parameter in generator.named_parameters():
        if name.endswith("noise_weight"):
            parameter.fill_(0.1)
    return generator


def export(arguments: argparse.Namespace, width: float, file: Path) -> None:
    """Write the file of the exported engine."""
    export_onnx(drawn_generator(*spec_of(arguments, width)), file, *arguments.size)


def measure(
    arguments: argparse.Namespace, width: float, engine: Engine, precision: TrainingPrecision, file: Path
) -> Measured:
    """Measure one row in this process."""
    (height, width_px), device = arguments.size, chosen_device(arguments.device)
    before = peak_of(device)
    generator = drawn_generator(*spec_of(arguments, width)).to(device)
    random = torch.Generator().manual_seed(0)
    channels = {name: map_channels(name, generator.labels) for name in conditions(generator.spec)}
    maps = {name: torch.rand(1, n, height, width_px, generator=random).to(device) for name, n in channels.items()}
    started = time.perf_counter()
    if engine is Engine.exported:
        render = open_exported(generator, file, precision)
    else:
        render = open_engine(generator, height, width_px, precision, engine)
    image = render(maps, torch.tensor([1], device=device)).float().cpu()
    ready_s = time.perf_counter() - started
    peak = peak_of(device)
    yardstick, times = Yardstick(), []
    render(maps, torch.tensor([0], device=device)).cpu()  # does not count
    for number in range(arguments.repeats):
        seed = torch.tensor([number], device=device)
        times.append(milliseconds(lambda seed=seed: render(maps, seed).cpu()))
        yardstick.tick()
    return Measured(image.numpy(), median(times), ready_s, peak, before, yardstick.text(times))


def table(arguments: argparse.Namespace, folder: Path) -> None:
    """Print a row for each width, engine and precision."""
    device, before = chosen_device(arguments.device), 0.0
    computed = tuple(dict.fromkeys((TrainingPrecision.fp32, chosen_precision(TrainingPrecision.auto, device))))
    for width in arguments.widths:
        parameters = f"{count_generator(*spec_of(arguments, width)):,}"
        exported, reference = folder / "model.onnx", None
        for engine in Engine:
            lacking = missing_for(engine, device)
            if lacking is not None:
                print(f"{engine} left out, it needs {lacking}")
                continue
            if engine is Engine.exported:
                in_own_process(export, arguments, width, exported)
            for precision in computed:
                found = in_own_process(measure, arguments, width, engine, precision, exported)
                before = max(before, found.before_gib)
                reference = found.image if reference is None else reference
                apart = HALF_RANGE * np.abs(found.image - reference)
                line(
                    (
                        f"{width:g}",
                        parameters,
                        engine,
                        precision,
                        f"{found.ms:.1f}",
                        f"{found.ready_s:.1f}",
                        f"{found.peak_gib:.2f}",
                        f"{apart.max():.2g} at most, {apart.mean():.2g} in the mean",
                        found.yardstick,
                    )
                )
    where = (
        "GPU memory of the arrays"
        if device.type == "cuda"
        else f"{before:.2f} GiB of it Python, torch and this project"
    )
    print(f"\nPeak: {where}. Ready: until the first frame, without exporting.")
    print(ABOUT)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--variant", default="sa2h")
    parser.add_argument("--preset", default="paper", help="whose maps the network reads")
    parser.add_argument("--widths", type=float, nargs="+", default=[1.0, 0.5, 0.25])
    parser.add_argument("--size", type=int, nargs=2, default=[1000, 1386], metavar=("HEIGHT", "WIDTH"))
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--device", default="auto", choices=("auto", "cpu", "cuda"))
    arguments = parser.parse_args()
    print(f"{hardware()}, {torch.get_num_threads()} threads, torch {torch.__version__}; {arguments.variant} at")
    print(f"{arguments.size[0]} x {arguments.size[1]}, batch 1, median of {arguments.repeats} frames after warm-up.\n")
    if chosen_precision(TrainingPrecision.auto, chosen_device(arguments.device)) is not TrainingPrecision.bf16:
        print("bf16 is left out: this processor has no instructions for it.\n")
    line(HEAD)
    print("|" + "|".join("-" * (len(name) + 1) + ":" for name in HEAD) + "|")
    with tempfile.TemporaryDirectory() as folder:
        table(arguments, Path(folder))


if __name__ == "__main__":
    main()
