"""Is the GPU used, and does it compute what the CPU computes?   python benchmarks/gpu.py

Prints a table: a simulated frame, the first training step, and a frame of the generator that comes with the package,
each on the CPU and on the GPU, with the largest difference that is allowed and the times. Ends with 1 where a
difference is larger. Without a GPU it says so in one line and ends with 0.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from statistics import median

import numpy as np
import torch
from torch import Tensor

import ablate
from ablate.anatomy import fetal_abdomen, fetal_planes
from ablate.networks import Generator, GeneratorSpec
from ablate.training import TrainingPrecision, TrainingSettings, train
from ablate.ultrasound import Simulator, SimulatorSettings

# Estimated, no GPU has measured them: float32 in another order, TF32 in cuDNN's convolutions (10 bits), bf16 (7 bits).
APART_PIXELS = 0.001  # of a simulated frame, more than one grey level apart
APART_LOSS = 0.01  # relative, of the first step
APART_LEVELS = {TrainingPrecision.fp32: 1.0, TrainingPrecision.bf16: 4.0}  # mean over a generated frame
_WARM_UP, _REPEATS = 3, 10


@dataclass(frozen=True)
class Check:
    """One comparison of a device with the CPU: the difference, the largest allowed one, and the times of both."""

    name: str
    difference: float
    allowed: float
    unit: str
    cpu_ms: float
    device_ms: float

    @property
    def passes(self) -> bool:
        return self.difference <= self.allowed

    def row(self) -> str:
        """A row of the table."""
        verdict = "ok" if self.passes else "DIFFERS"
        difference = f"{self.difference:.2g} {self.unit} | {self.allowed:g}"
        return f"| {self.name} | {difference} | {verdict} | {self.cpu_ms:.1f} | {self.device_ms:.1f} |"


def check_simulator(device: str, settings: SimulatorSettings, triangles: int) -> Check:
    """Compare a simulated frame; rays are traced on the CPU in both, the signal chain is on the device."""
    scene, pose = fetal_abdomen(triangles), fetal_planes()["abdomen"]
    images, times = [], []
    for place in ("cpu", device):
        simulator = Simulator(scene, settings=replace(settings, device=place))
        images.append(simulator.image(pose).astype(int))
        times.append(median_ms(lambda simulator=simulator: simulator.image(pose)))
    apart = float((np.abs(images[0] - images[1]) > 1).mean())
    return Check("simulated frame", apart, APART_PIXELS, "of the pixels", times[0], times[1])


def check_training(device: str, spec: GeneratorSpec, settings: TrainingSettings) -> Check:
    """Compare the losses of the first training step in fp32; the time is that of a step after the first ones."""
    losses, times = [], []
    for place in ("cpu", device):
        clock: list[float] = []
        metrics: list[dict[str, float]] = []

        def sink(step: dict[str, float], _: int, clock: list[float] = clock, metrics: list = metrics) -> None:
            clock.append(time.perf_counter())
            metrics.append(step)

        with tempfile.TemporaryDirectory() as folder:
            here = replace(settings, device=place, log_every=1, precision=TrainingPrecision.fp32)
            train(spec, here, lambda start, stop, here=here: batches(here, start, stop), Path(folder), sink)
        losses.append({name: value for name, value in metrics[0].items() if name in ("train/loss_g", "train/loss_d")})
        times.append(1e3 * median(end - begin for begin, end in pairwise(clock)))
    apart = max(abs(losses[1][name] / value - 1) for name, value in losses[0].items())
    return Check("training step, losses", apart, APART_LOSS, "relative", times[0], times[1])


def batches(settings: TrainingSettings, start: int, stop: int) -> Iterator[dict[str, Tensor]]:
    """Random maps and targets, the same for the same step."""
    shape = (settings.batch_size, 1, settings.crop, settings.crop)
    for step in range(start, stop):
        random = torch.Generator().manual_seed(step)
        batch = {name: torch.rand(shape, generator=random) for name in ("segmentation", "attenuation", "target")}
        yield batch | {"mask": torch.ones(shape), "noise_seed": torch.arange(settings.batch_size) + step}


def check_generator(device: str, triangles: int) -> Iterator[Check]:
    """Compare a generated frame in fp32 and in bf16 with that of the CPU in fp32."""
    renderer, scene, pose = ablate.load("sa2h"), fetal_abdomen(triangles), fetal_planes()["abdomen"]
    shown = Simulator(scene, renderer.probe, renderer.simulator).render(pose)

    def frame(generator: Generator, precision: TrainingPrecision) -> np.ndarray:
        return replace(renderer, generator=generator).render(shown, scene.tissues, precision=precision)

    expected = frame(renderer.generator, TrainingPrecision.fp32).astype(int)
    cpu_ms = median_ms(lambda: frame(renderer.generator, TrainingPrecision.fp32))
    generator = renderer.generator.to(device)
    for precision, allowed in APART_LEVELS.items():
        apart = float(np.abs(frame(generator, precision) - expected)[shown.mask].mean())
        device_ms = median_ms(lambda precision=precision: frame(generator, precision))
        yield Check(f"generated frame, {precision}", apart, allowed, "grey levels", cpu_ms, device_ms)


def median_ms(work: Callable[[], object]) -> float:
    """Time some work whose result comes back to the CPU, in milliseconds."""
    times = []
    for _ in range(_WARM_UP + _REPEATS):
        begin = time.perf_counter()
        work()
        times.append(1e3 * (time.perf_counter() - begin))
    return median(times[_WARM_UP:])


def main() -> int:
    """Print the table; 1 where a difference is larger than allowed."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    if not torch.cuda.is_available():
        print(
            f"No GPU: PyTorch {torch.__version__} finds none, so there is nothing to check; ablate computes on the CPU."
        )
        return 0
    print(f"{torch.cuda.get_device_name()}, PyTorch {torch.__version__}, CUDA {torch.version.cuda}\n")
    print("| check | difference | allowed | | CPU (ms) | GPU (ms) |\n| --- | --- | --- | --- | --- | --- |")
    settings, triangles = SimulatorSettings(), 160_000
    checks = [check_simulator("cuda", settings, triangles)]
    checks.append(check_training("cuda", GeneratorSpec(width=0.25), TrainingSettings(steps=8, crop=256)))
    checks += check_generator("cuda", triangles)
    for check in checks:
        print(check.row())
    return 0 if all(check.passes for check in checks) else 1


if __name__ == "__main__":
    sys.exit(main())
