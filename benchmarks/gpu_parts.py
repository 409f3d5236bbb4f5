"""The parts of `gpu.py`, each measured in a process of its own: a name in, rows (name, quantity, value, unit) out."""

import sys
import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from statistics import median
from subprocess import run
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.utils.flop_counter import FlopCounterMode

from ablate.dataset import CropLoader, Crops, Part, network_inputs, noise_seeds
from ablate.evaluation import Scorer
from ablate.networks import Generator, GeneratorSpec, conditions, draws_noise
from ablate.threads import without_teams
from ablate.training import Engine, TrainingPrecision, TrainingSettings, generate, median_ms_per_frame, train
from ablate.ultrasound.imaging.signal_chain import SignalChain
from ablate.ultrasound.stages import stage_times
from gpu_carried import Carried, CarriedJob, CarriedPairs
from gpu_results import add_rows, add_weights, read_rows, value_of

ROOT = Path(__file__).parents[1]
#: Files with tests marked `gpu`, and the packages that their folders need beside torch and Lightning.
TESTS: dict[str, tuple[str, ...]] = {
    "tests/networks/test_gaussian_fields.py": (),
    "tests/training/test_module.py": (),
    "tests/training/test_step.py": (),
    "tests/ultrasound/test_simulator.py": ("embreex", "numba", "trimesh"),
}
Rows = list[tuple[str, str, float, str]]
_REPEATS, _WARM_UP = 5, 3
_PRECISIONS = (TrainingPrecision.bf16, TrainingPrecision.fp32)


class Place(NamedTuple):
    """What a part is given: what was carried, where results go, where it may work, and the seconds it has."""

    carried: Carried
    out: Path
    working: Path
    device: torch.device
    seconds: float

    def wait(self) -> None:
        if self.device.type == "cuda":
            torch.cuda.synchronize()


def tests(place: Place, _: str) -> Rows:
    """Part a: the suite's GPU tests that can be collected here: 1 passed, 0 failed, -1 skipped."""
    report = place.working / "tests.xml"
    files = [file for file, needed in TESTS.items() if all(map(find_spec, needed))]
    options = ["-m", "gpu", "-p", "no:cacheprovider", "-W", "default"]
    command = [sys.executable, "-m", "pytest", "-q", *options, f"--junitxml={report}", *files]
    done = run(command, cwd=ROOT, capture_output=True, text=True, timeout=place.seconds)
    with (place.out / "gpu.log").open("a") as log:
        log.write(done.stdout[-4000:] + done.stderr[-4000:])
    rows: Rows = []
    for case in ElementTree.parse(report).iter("testcase"):
        tags = {child.tag for child in case}
        result = -1.0 if tags & {"skipped", "error"} else 0.0 if "failure" in tags else 1.0
        rows.append((case.get("name") or case.get("classname") or "?", "passed", result, ""))
    return rows


def signal_chain(place: Place, name: str) -> Rows:
    """Part b: an image from what rays brought back, on the device, against the CPU's; and the times of its stages."""
    tissues, probe, settings = place.carried.simulation()
    received, pose, expected = place.carried.signal(int(name.split()[-1]))
    times: dict[str, list[float]] = {}
    images = {}
    for device in dict.fromkeys(("cpu", str(place.device))):
        with without_teams(), torch.inference_mode():
            chain = SignalChain(tissues, probe, replace(settings, device=device))

            def image(chain: SignalChain = chain) -> np.ndarray:
                noise = chain.noise(pose, 0)
                return chain.image(chain.signal(chain.prepare(received), 0, noise), noise)

            images[device] = image()
            with stage_times() as taken:
                whole = [_ms(image, place) for _ in range(_REPEATS)]
        times |= {f"{device}: {stage.value}": values for stage, values in taken.items()}
        times[f"{device}: whole"] = whole
    found = images[str(place.device)].astype(int)
    rows: Rows = [(name, label, median(values), "ms") for label, values in times.items()]
    for against, image_there in (("the CPU here", images["cpu"]), ("the whole simulator", expected)):
        apart = np.abs(found - image_there)
        rows.append((name, f"apart from {against}, at most", float(apart.max()), "grey levels"))
        rows.append((name, f"apart from {against}, pixels over 1", float((apart > 1).mean()), "share"))
    return rows


def _ms(call: Callable[[], object], place: Place) -> float:
    place.wait()
    start = time.perf_counter()
    call()
    place.wait()
    return 1e3 * (time.perf_counter() - start)


def matrix_rate(place: Place, name: str) -> Rows:
    """Part c: what a product of bf16 matrices reaches on this device, random values."""
    side = 256 if place.carried.about["tiny"] else 8192
    a, b = (torch.randn(side, side, device=place.device, dtype=torch.bfloat16) for _ in range(2))
    times = [_ms(lambda: a @ b, place) for _ in range(_WARM_UP + _REPEATS)]
    return [(name, "rate", 2e-9 * side**3 / median(times[_WARM_UP:]), "TFLOP/s")]


def _compiled(**options: object) -> Callable[[], None]:
    def switch() -> None:
        from ablate.training import loop

        made = loop.PairGAN.__init__

        def init(self: loop.PairGAN, *arguments: object) -> None:
            made(self, *arguments)  # type: ignore[arg-type]
            self.generator.compile(**options)
            if self.discriminator is not None:
                self.discriminator.compile(**options)

        loop.PairGAN.__init__ = init  # type: ignore[method-assign, assignment]

    return switch


def _channels_last() -> None:
    from ablate.networks import discriminator, generator

    for module in (generator, discriminator):
        module.laid_out = lambda maps: maps.contiguous(memory_format=torch.channels_last)


#: Our loop with what could make it faster, each switched on in its own process.
SWITCHES: dict[str, tuple[Callable[[], None], ...]] = {
    "": (),
    ", channels-last": (_channels_last,),
    ", compiled": (_compiled(),),
    ", channels-last, compiled": (_channels_last, _compiled()),
    ", compiled with CUDA graphs": (_compiled(mode="reduce-overhead"),),
}
LOOPS = ("plain fp32", "plain bf16", "ours fp32", *(f"ours bf16{switch}" for switch in SWITCHES))


def loop(place: Place, name: str) -> Rows:
    """Part c: images a second of a training of SA2H at the paper's size, crops drawn beforehand."""
    job = place.carried.jobs("paper")[0]
    batch, size = job.training.batch_size, job.training.crop
    steps = 2 if place.carried.about["tiny"] else 60
    side, precision = name.split(",")[0].split()
    random = torch.Generator().manual_seed(0)
    maps = ("segmentation", "attenuation", "target", "mask")
    drawn = {key: torch.rand(batch, 1, size, size, generator=random) for key in maps}
    drawn |= {"mask": drawn["mask"].round(), "noise_seed": torch.arange(batch)}
    if place.device.type == "cuda":
        drawn = {key: value.pin_memory() for key, value in drawn.items()}
    marks: list[float] = []

    def batches(start: int = 0, stop: int = _WARM_UP + steps) -> Iterator[dict[str, Tensor]]:
        for step in range(start, stop):
            if step == _WARM_UP:
                place.wait()
                marks.append(time.perf_counter())
            yield drawn
        place.wait()
        marks.append(time.perf_counter())

    if side == "plain":
        _train_plainly(job.spec, batches(), precision, place)
    else:
        for switch in SWITCHES[name.removeprefix(f"{side} {precision}")]:
            switch()
        settings = replace(
            job.training, steps=_WARM_UP + steps, checkpoint_every=0, precision=precision, device=place.device.type
        )
        train(job.spec, settings, batches, place.working / name.replace(" ", "-"), sink=lambda *_: None)
    seconds = (marks[1] - marks[0]) / steps
    rate = _flops(job.spec, drawn) / seconds / 1e12
    rows: Rows = [(name, "rate", batch / seconds, "images/s"), (name, "arithmetic", rate, "TFLOP/s")]
    known = read_rows(place.out)
    if plain := value_of(known, "c", "plain fp32", "rate"):
        rows.append((name, "against plain fp32", batch / seconds / plain, "times"))
    if best := value_of(known, "c", "matrix rate", "rate"):
        rows.append((name, "of the matrix rate", rate / best, "share"))
    return rows


def _plain_gan(spec: GeneratorSpec, device: torch.device) -> object:
    sys.path.insert(0, str(ROOT / "tests"))
    from support.plain_gan import PlainGAN

    return PlainGAN(spec, device)


def _train_plainly(spec: GeneratorSpec, batches: Iterator[dict[str, Tensor]], precision: str, place: Place) -> None:
    gan = _plain_gan(spec, place.device)
    for batch in batches:
        with torch.autocast(place.device.type, torch.bfloat16, enabled=precision == "bf16"):
            gan.step(batch, 2)  # type: ignore[attr-defined]


def _flops(spec: GeneratorSpec, drawn: dict[str, Tensor]) -> float:
    """Floating-point operations of a step that renders its batch once, counted without computing them."""
    with torch.device("meta"), FlopCounterMode(display=False) as counter:
        gan = _plain_gan(spec, torch.device("meta"))
        maps = torch.cat([drawn[name].to("meta") for name in conditions(spec)], 1)
        fake = gan.generator(maps)  # type: ignore[attr-defined]
        judged = [gan.discriminator(maps, image) for image in (fake, fake.detach(), fake.detach())]  # type: ignore[attr-defined]
        torch.stack(judged).sum().backward()
    return float(counter.get_total_flops())


def frame(place: Place, name: str) -> Rows:
    """Part d: milliseconds of a generated frame; the name holds width, engine and precision."""
    width, engine, precision = name.split()
    spec = replace(place.carried.jobs("paper")[0].spec, width=float(width))
    height, across = place.carried.about["size"]
    torch.manual_seed(0)
    generator = Generator(spec).eval().requires_grad_(False).to(place.device)
    maps = {key: torch.rand(1, 1, height, across, device=place.device) for key in conditions(spec)}
    ms = median_ms_per_frame(generator, maps, TrainingPrecision(precision), 20, 5, Engine(engine))
    return [(name, "time", ms, "ms")]


def job_of(place: Place, group: str, name: str) -> CarriedJob:
    """A training of a group by its name."""
    return next(job for job in place.carried.jobs(group) if job.name == name)


def of_the_study(place: Place, name: str) -> Rows:
    """Part e: a training of the study, and its scores."""
    job = job_of(place, "study", name)
    return _trained(place, job, job.training)


def at_full_size(place: Place, name: str) -> Rows:
    """Part f: a training at the paper's size, as long as there is time for each of the two."""
    job, known = job_of(place, "paper", name), read_rows(place.out)
    jobs = place.carried.jobs("paper")
    steps = next((s for other in jobs if (s := value_of(known, "f", other.name, "steps"))), None)
    if steps is None:
        rate = value_of(known, "c", f"ours {job.training.precision}", "rate") or value_of(known, "c", LOOPS[3], "rate")
        for_each = 0.8 * place.seconds / len(jobs)  # the rest is for the scores
        steps = 2 if place.carried.about["tiny"] else max(for_each * (rate or 1.0) / job.training.batch_size, 1)
    rows = _trained(place, job, replace(job.training, steps=int(steps), checkpoint_every=max(int(steps) // 4, 1)))
    return [*rows, (name, "steps", int(steps), "")]


def _trained(place: Place, job: CarriedJob, settings: TrainingSettings) -> Rows:
    started = time.perf_counter()
    pairs = place.carried.pairs(job.data)
    frames = pairs.frames(Part.train)
    crops = Crops(pairs, frames, frozenset(conditions(job.spec)), job.values, job.crops)  # type: ignore[arg-type]
    settings = replace(settings, device=place.device.type)
    trained = train(
        job.spec, settings, lambda a, b: CropLoader(crops, a, b, job.workers), place.working / job.data / job.name,
        sink=lambda *_: None,
    )  # fmt: skip
    seconds = time.perf_counter() - started
    render = _renderer(trained.generator, pairs, job, settings.precision)
    scorer = Scorer(pairs, pairs.about["tissues"], pairs.about["probe"])  # type: ignore[arg-type]
    scores = scorer.score(Part.test, render, draws_noise(job.spec))
    table = scores.per_image.assign(run=job.name)
    add_rows(place.out / "scores.csv", table.columns, table.itertuples(index=False))
    kept = add_weights(place.out, f"{job.data}-{job.name}", trained.generator)
    rows: Rows = [(job.name, name, value, "") for name, value in sorted(scores.scalars.items())]
    return [*rows, (job.name, "training", seconds, "s"), (job.name, "weights kept", float(kept), "")]


def _renderer(
    generator: Generator, pairs: CarriedPairs, job: CarriedJob, precision: TrainingPrecision
) -> Callable[[np.ndarray, int], np.ndarray]:
    mask = torch.from_numpy(pairs.mask())

    def render(frames: np.ndarray, draw: int) -> np.ndarray:
        read = {name: pairs.read(name, frames) for name in conditions(job.spec)}
        inputs = network_inputs(read, job.values, pairs.mask())
        return generate(generator, inputs, mask, torch.from_numpy(noise_seeds(frames, draw)), precision)

    return render


PARTS: dict[str, Callable[[Place, str], Rows]] = {
    "a": tests, "b": signal_chain, "c": loop, "d": frame, "e": of_the_study, "f": at_full_size,
}  # fmt: skip


def measure(place: Place, part: str, name: str) -> Rows:
    """One measurement."""
    return matrix_rate(place, name) if name == "matrix rate" else PARTS[part](place, name)


def names(carried: Carried, device: torch.device) -> list[tuple[str, str]]:
    """All measurements, (part, name), in the order of their worth."""
    engines, precisions, loops = [Engine.compiled, Engine.eager], list(_PRECISIONS), list(LOOPS)
    if device.type == "cpu":  # a dry run: without a compiler, and most processors have no bf16
        engines, precisions = [Engine.eager], [TrainingPrecision.fp32]
        loops = [name for name in LOOPS if name.endswith("fp32")]
    return [
        ("a", "tests"),
        *(("b", f"pose {number}") for number in range(carried.about["signals"])),
        *(("c", name) for name in ("matrix rate", *loops)),
        *(("d", f"{w} {e} {p}") for w in carried.about["widths"] for e in engines for p in precisions),
        *(("e", job.name) for job in carried.jobs("study")),
        *(("f", job.name) for job in carried.jobs("paper")),
    ]
