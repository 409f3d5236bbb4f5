"""Error and time of every trained run on disk that has learned from the same pairs."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median

import numpy as np
import torch

from ablate.config import StudySettings, build
from ablate.dataset import label_values, network_inputs
from ablate.networks import Generator, conditions
from ablate.studies.data import about_data
from ablate.studies.identity import digest
from ablate.studies.precision.bench import Bench, make_inputs
from ablate.studies.precision.errors import Shots, mean_errors
from ablate.studies.precision.ledger import Ledger
from ablate.studies.results import Finished, finished_runs
from ablate.training import (
    LAST,
    Engine,
    Precision,
    chosen_device,
    chosen_precision,
    load_generator,
    missing_for,
    renderer,
)
from ablate.training.inference import to_grey_levels

_WARMUP = 2
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Way:
    """Arithmetic and engine that a generator is run with."""

    precision: Precision
    engine: Engine


def comparable_runs(settings: StudySettings) -> tuple[list[Finished], str]:
    """Finished runs of all studies in `runs_dir` that learned from this very data set, and a word on the others.

    Others were trained on another scene, another grid or other poses: their test frames are none of theirs, or not
    unseen. Of others only the results are here, without a checkpoint: they cannot be run.
    """
    about = about_data(settings)
    studies = sorted({path.parents[2] for path in settings.runs.glob("*/*/seed*/result.json")})
    runs = [run for study in studies for run in finished_runs(study)]
    if not runs:
        return [], f"no trained run in {settings.runs}: the simulator alone"
    same = [run for run in runs if run.spec["semantic"]["data"] == about]
    fit = [run for run in same if (run.folder / LAST).exists()]
    said = f"{len(fit)} trained runs"
    if others := len(runs) - len(same):
        said += f"; {others} left out, they learned from other data"
    if bare := len(same) - len(fit):
        said += f"; {bare} left out, without a checkpoint"
    return fit, said


def ways(settings: StudySettings) -> tuple[list[Way], tuple[str, ...]]:
    """Every way to run a generator on this machine, eager ones first, and what it lacks for the others."""
    device = chosen_device(settings.training.device)
    notes = []
    precisions = [Precision.fp32]
    if chosen_precision(Precision.auto, device) is Precision.bf16:
        precisions.append(Precision.bf16)
    else:
        notes.append(f"bf16: {device.type} here does not multiply it")
    engines = []
    for engine in Engine:
        lacking = missing_for(engine, device)
        if lacking is None:
            engines.append(engine)
        else:
            notes.append(f"engine {engine}: needs {lacking}")
    return [Way(p, e) for e in engines for p in precisions], tuple(notes)


def plan_of(runs: list[Finished], settings: StudySettings) -> list[tuple[Finished, list[Way]]]:
    """Which run is run in which ways.

    Eager in every precision, each of them; compiled and exported, which takes up to a minute each, only the first run
    of each network, because the time of a network is no matter of its weights.
    """
    every, _ = ways(settings)
    eager = [way for way in every if way.engine is Engine.eager]
    seen: set[str] = set()
    planned = []
    for run in sorted(runs, key=lambda r: (str(r.folder.parents[1]), r.label, r.seed)):
        network = digest(run.spec["semantic"]["model"])
        planned.append((run, eager if network in seen else every))
        seen.add(network)
    return planned


def measure_generators(
    bench: Bench,
    planned: list[tuple[Finished, list[Way]]],
    settings: StudySettings,
    reference: Shots,
    points: Ledger,
    details: Ledger,
    advance: Callable[[], object],
) -> None:
    """Fill the tables with every run; the time of a frame is that of its inputs and of the network.

    A way that fails (compilers and runtimes can) is left out with a warning.

    Parameters
    ----------
    bench : Bench
    planned : list of (Finished, list of Way)
    settings : StudySettings
    reference : Shots
    points, details : Ledger
    advance : callable
        Called once for the inputs of each pose, then after each run and way.
    """
    if not planned:
        return
    maps, inputs = make_inputs(bench, advance)
    device = chosen_device(settings.training.device)
    for run, its_ways in planned:
        exact: Shots | None = None
        for way in its_ways:
            setting = _setting(run, way, settings)
            advance()
            try:
                generator = load_generator(run.folder / LAST).to(device)
                shots, network_ms = _render(run, generator, maps, bench, way)
            except Exception as failure:
                _LOG.warning("left out, %s, %s: %s", run.label, setting, " ".join(str(failure).split())[:300])
                continue
            needed = {name: inputs[name] for name in conditions(generator.spec)}
            ms = sum(needed.values()) + network_ms
            for metric, error in mean_errors(shots, reference, bench.mask).items():
                points.add(run.label, setting, ms, metric, error)
            for stage, taken in {**needed, "network": network_ms}.items():
                details.add("stage", run.label, setting, stage, taken)
            if exact is None:
                exact = shots
            else:
                for metric, error in mean_errors(shots, exact, bench.mask).items():
                    details.add("limit", f"{run.label}, against fp32 eager", setting, metric, error)


def _setting(run: Finished, way: Way, settings: StudySettings) -> str:
    """What tells one point of a label from the others; the study only where it is not the one asked for."""
    width = run.spec["settings"]["model"]["width"]
    study = run.folder.parents[1].name
    elsewhere = "" if study == settings.study else f", {study}"
    return f"width {width:g}, {way.precision}, {way.engine}, seed {run.seed}{elsewhere}"


@torch.inference_mode()
def _render(
    run: Finished, generator: Generator, maps: dict[str, np.ndarray], bench: Bench, way: Way
) -> tuple[Shots, float]:
    """Every frame, and the median milliseconds from maps as they are stored to grey levels, after a warm-up."""
    trained = build(StudySettings, run.spec["settings"])
    values = label_values(bench.scene.tissues, trained.encoding, trained.encoding_seed)
    stored = {name: maps[name] for name in conditions(generator.spec)}
    device = next(generator.parameters()).device
    render = renderer(generator, *bench.simulator.image_shape, way.precision, way.engine)
    mask = torch.from_numpy(bench.mask).to(device)
    images, times = [], []
    for k in [0] * _WARMUP + list(range(len(bench.frames))):
        start = time.perf_counter()
        read = network_inputs({name: m[k : k + 1] for name, m in stored.items()}, values, bench.mask)
        seed = torch.tensor([int(bench.frames[k])], device=device)
        image = render({name: m.to(device) for name, m in read.items()}, seed)
        images.append(to_grey_levels(image[0, 0], mask).cpu().numpy())  # waits for the device
        times.append(1e3 * (time.perf_counter() - start))
    return Shots(np.stack(images[_WARMUP:])), median(times[_WARMUP:])
