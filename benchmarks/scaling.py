"""Memory and time of a simulated frame, a generated frame and a training step as each size doubles.

make bench-scaling                     # Markdown; half an hour on two cores. Single sizes go to the standard error
make bench-scaling ARGS="--doublings 2 --no-check --work 'training step'"

Every row is measured in a process of its own, so that the peak of its memory is its own. Exponents are those of the
three largest sizes: of time the slope of the logarithms, of memory m = a + b n^p through the three points, where a is
what every process takes. Where memory grows ever less, p = 1 through the last two: the safe side of a bend. What fits
in 4 GiB is extrapolated so and then run; where that took more, less is taken, and run again. What fits in 24 GiB is
extrapolated through the last size and that run. The time of a simulated frame is without the building of its scene,
which is paid once; its memory is with it.
"""

import argparse
import math
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import TextIO

import numpy as np
import torch
import trimesh
from torch import Tensor

from ablate.anatomy import Scene, Structure, load_tissues
from ablate.networks import Generator, GeneratorSpec, conditions
from ablate.study.provenance import hardware
from ablate.training import Engine, TrainingPrecision, TrainingSettings, chosen_device, open_engine, train
from ablate.ultrasound import Simulator, SimulatorSettings
from yardstick import Yardstick, in_own_process, milliseconds, peak_gib

REPEATS = 3
BUDGETS_GIB = (4.0, 24.0)
NOISE_GIB = 0.02  # less than this a doubling is no growth
TRIES = 3  # to find what fits in the smaller budget
FAR = 100  # times the largest size that was run: no further is extrapolated
_ORGANS = ("liver", "kidney", "bone", "blood", "muscle", "fat")


@dataclass(frozen=True)
class Cost:
    """What one process measured."""

    peak_gib: float
    ms: float


@dataclass(frozen=True)
class Growth:
    """Memory a + b n^power, GiB."""

    constant: float
    factor: float
    power: float

    def largest(self, budget_gib: float) -> float:
        """The n that takes so much."""
        return ((budget_gib - self.constant) / self.factor) ** (1 / self.power)


def through(sizes: list[float], memory: list[float], power: float) -> Growth:
    """The law of this power through the last two sizes."""
    factor = (memory[-1] - memory[-2]) / (sizes[-1] ** power - sizes[-2] ** power)
    return Growth(memory[-1] - factor * sizes[-1] ** power, factor, power)


def ball(centre_mm: tuple[float, float, float], radius_mm: float, triangles: int) -> trimesh.Trimesh:
    """A sphere of rings and segments, of nearly so many triangles."""
    rings = max(3, round(math.sqrt(triangles / 8)))
    return trimesh.creation.uv_sphere(radius_mm, count=(rings, 2 * rings)).apply_translation(centre_mm)


def balls(triangles: int) -> Scene:
    """Organs of several tissues side by side in soft tissue."""
    tissues = load_tissues()
    places = [(x, 0.0, z) for z in (45.0, 100.0) for x in (-32.0, 0.0, 32.0)]
    structures = tuple(
        Structure(ball(where, 14.0, triangles // len(_ORGANS)), tissues[name])
        for where, name in zip(places, _ORGANS, strict=True)
    )
    return Scene(structures, tissues["soft_tissue"], "balls")


def simulated_frame(pixels: float, rays: float, triangles: float) -> Callable[[], float]:
    """H, S and A of a scene that was met before, in poses that were not."""
    rows = round(math.sqrt(pixels / 1.386))
    scene = balls(round(triangles))
    settings = SimulatorSettings(rays=round(rays), image_shape=(rows, round(1.386 * rows)))
    poses = [np.eye(4) for _ in range(REPEATS + 1)]
    for k, pose in enumerate(poses):
        pose[1, 3] = k

    def work() -> float:
        simulator = Simulator(scene, settings=settings)
        return median(_timed(simulator.render, pose) for pose in poses[1:]) if simulator.render(poses[0]) else 0.0

    return work


def generated_frame(pixels: float, width: float) -> Callable[[], float]:
    """One frame of SA2H with drawn weights, eager, fp32."""
    rows = round(math.sqrt(pixels / 1.386))
    shape, device = (rows, round(1.386 * rows)), chosen_device("auto")
    generator = Generator(GeneratorSpec(width=width)).eval().requires_grad_(False).to(device)
    for name, parameter in generator.named_parameters():
        if name.endswith("noise_weight"):
            parameter.fill_(0.1)
    maps = {name: torch.rand(1, 1, *shape).to(device) for name in conditions(generator.spec)}

    def measure() -> float:
        render = open_engine(generator, *shape, TrainingPrecision.fp32, Engine.eager)
        times = [milliseconds(lambda: render(maps, torch.tensor([0], device=device)).cpu()) for _ in range(REPEATS + 1)]
        return median(times[1:])

    return measure


def training_step(crop: float, batch: float, width: float) -> Callable[[], float]:
    """Both networks of SA2H, fp32."""
    side, count, times = round(crop), round(batch), list[float]()
    settings = TrainingSettings(
        steps=REPEATS + 3,
        batch_size=count,
        crop=side,
        precision=TrainingPrecision.fp32,
        checkpoint_every=0,
        log_every=10**6,
    )

    def batches(start: int, stop: int) -> Iterator[dict[str, Tensor]]:
        for step in range(start, stop):
            times.append(time.perf_counter())
            drawn = {name: torch.rand(count, 1, side, side) for name in ("segmentation", "attenuation", "target")}
            yield {**drawn, "mask": torch.ones(count, 1, side, side), "noise_seed": torch.arange(count) + step}

    def work() -> float:
        with tempfile.TemporaryDirectory() as folder:
            train(GeneratorSpec(width=width), settings, batches, Path(folder))
        # Lightning asks for the next batch before it takes a step: the first two intervals hold no warm step.
        return median((1e3 * np.diff(times))[2:].tolist())

    return work


#: What is measured, its sizes where another is grown, and the values of each that is grown.
FRAME, GENERATED, STEP = "simulated frame", "generated frame", "training step"
MAKERS: dict[str, Callable[..., Callable[[], float]]] = {
    FRAME: simulated_frame,
    GENERATED: generated_frame,
    STEP: training_step,
}
PAPER_PIXELS = 1000 * 1386
USUAL: dict[str, dict[str, float]] = {
    FRAME: {"pixels": PAPER_PIXELS, "rays": 32, "triangles": 200_000},
    GENERATED: {"pixels": PAPER_PIXELS, "width": 0.25},
    STEP: {"crop": 256, "batch": 2, "width": 0.25},
}
#: The smallest of each, and how often it is doubled.
FIRST: dict[str, dict[str, tuple[float, int]]] = {
    FRAME: {"pixels": (PAPER_PIXELS / 2, 5), "rays": (16, 5), "triangles": (100_000, 5)},
    GENERATED: {"pixels": (PAPER_PIXELS / 8, 5), "width": (0.125, 3)},
    STEP: {"crop": (128, 3), "batch": (1, 4), "width": (0.125, 3)},
}
PAPER: dict[str, dict[str, float]] = {
    FRAME: {"triangles": 675_000},
    GENERATED: {"width": 1.0},
    STEP: {"crop": 512, "batch": 4, "width": 1.0},
}


def _timed(call: Callable[[np.ndarray], object], pose: np.ndarray) -> float:
    start = time.perf_counter()
    call(pose)
    return 1e3 * (time.perf_counter() - start)


def measure(what: str, sizes: dict[str, float]) -> Cost:
    """Do the work in this process."""
    work = MAKERS[what](**sizes)
    Path("/proc/self/clear_refs").write_text("5")  # the peak starts anew: making meshes is not the simulator's
    ms = work()
    on_gpu = torch.cuda.is_available() and what != FRAME
    return Cost(torch.cuda.max_memory_allocated() / 2**30 if on_gpu else peak_gib(), ms)


def cost(what: str, **sizes: float) -> Cost | None:
    """The cost of one piece of work in a process of its own; None where it did not get its memory."""
    try:
        return in_own_process(measure, what, USUAL[what] | sizes)
    except (BrokenProcessPool, MemoryError):  # the first where the system killed it
        return None
    except RuntimeError as error:  # of torch
        if "allocate memory" in str(error) or "out of memory" in str(error):
            return None
        raise


def exponent(sizes: list[float], times: list[float]) -> float:
    """Slope of the logarithms over the three largest sizes."""
    return float(np.polyfit(np.log(sizes[-3:]), np.log(times[-3:]), 1)[0])


def growth(sizes: list[float], memory: list[float]) -> Growth | None:
    """Through the three largest sizes, each twice the one before; None where memory hardly grows."""
    first, second = np.diff(memory[-3:])
    if min(first, second) < NOISE_GIB:
        return None
    return through(sizes, memory, max(1.0, math.log2(second / first)))


def row(*cells: str, file: TextIO | None = None) -> None:
    """Print a row of a Markdown table."""
    print(f"| {' | '.join(cells)} |", flush=True, file=file)


def shown(value: float) -> str:
    """Three digits, thousands apart."""
    return f"{float(f'{value:.3g}'):,.0f}" if value >= 100 else f"{value:.3g}"


def grow(what: str, name: str, doublings: int, check: bool) -> tuple[str, ...]:
    """Measure doubled sizes, print them, and return the row of what they tell."""
    first, most = FIRST[what][name]
    sizes, costs = [], []
    for k in range(min(doublings, most) + 1):
        found = cost(what, **{name: first * 2**k})
        if found is None:
            break
        sizes.append(first * 2**k)
        costs.append(found)
        row(what, name, shown(sizes[-1]), f"{found.peak_gib:.2f}", f"{found.ms:.0f}", file=sys.stderr)
    time = f"{exponent(sizes, [c.ms for c in costs]):.2f}" if len(sizes) > 2 else "not known"
    if len(sizes) < 3:
        return what, name, "not known", time, *["not known: too few sizes could be run"] * len(BUDGETS_GIB), ""
    peaks = [c.peak_gib for c in costs]
    memory = growth(sizes, peaks)
    if memory is None:
        return what, name, "hardly grows", time, *["far more than was run"] * len(BUDGETS_GIB), ""
    law, far, tried = f"{memory.constant:.2f} GiB + n^{memory.power:.2f}", FAR * sizes[-1], "not run"
    fits = [memory.largest(budget) for budget in BUDGETS_GIB]
    for _ in range(TRIES if check and fits[0] < far else 0):
        found = cost(what, **{name: fits[0]})
        if found is None:
            tried = "more than this machine has"
            break
        tried = f"{found.peak_gib:.2f} GiB, {found.ms:.0f} ms"
        memory = through([sizes[-1], fits[0]], [peaks[-1], found.peak_gib], memory.power)
        fits[1] = memory.largest(BUDGETS_GIB[1])
        if found.peak_gib <= BUDGETS_GIB[0]:
            break
        fits[0] = memory.largest(BUDGETS_GIB[0])
    shown_fits = [f"over {shown(far)}" if fit >= far else shown(fit) for fit in fits]
    return what, name, law, time, *shown_fits, tried


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--doublings", type=int, default=5, help="of each size at most; at least 2")
    parser.add_argument("--work", nargs="+", choices=tuple(FIRST), default=tuple(FIRST))
    parser.add_argument("--no-check", dest="check", action="store_false", help="do not run what should fit in 4 GiB")
    args = parser.parse_args()
    if args.doublings < 2:
        parser.error("--doublings: at least 2, exponents are of three sizes")
    usual = "; ".join(f"{w}: {', '.join(f'{k} {shown(v)}' for k, v in s.items())}" for w, s in USUAL.items())
    print(f"{hardware()}, torch {torch.__version__}. Where another size grows: {usual}.\n")
    row("work", "size", "value", "peak, GiB", "ms", file=sys.stderr)
    yardstick = Yardstick()
    yardstick.tick()
    facts = [grow(what, name, args.doublings, args.check) for what in args.work for name in FIRST[what]]
    head = ("work", "as it grows", "memory", "time ~ n^", "fits in 4 GiB", "fits in 24 GiB", "that for 4 GiB, run")
    row(*head)
    row(*["---"] * len(head))
    for fact in facts:
        row(*fact)
    yardstick.tick()
    print("\nAt the paper's sizes:\n")
    row("work", "sizes", "peak, GiB", "ms")
    row(*["---"] * 4)
    for what in args.work:
        sizes = PAPER[what]
        found = cost(what, **sizes)
        named = ", ".join(f"{k} {shown(v)}" for k, v in (USUAL[what] | sizes).items())
        row(what, named, *((f"{found.peak_gib:.2f}", f"{found.ms:.0f}") if found else ("more than there is", "")))
    yardstick.tick()
    print(f"\n{yardstick.line()}")


if __name__ == "__main__":
    main()
