"""Error and time of every trained run on disk that was trained on the same pairs."""

import logging
import time
from functools import lru_cache, partial
from statistics import median

import numpy as np
import torch

from ablate.dataset import decode_grey_levels, label_values, network_inputs
from ablate.dataset.simulate import nudged, timed_maps
from ablate.networks import Generator, Space, conditions
from ablate.numerics.precision.bench import Bench, Frames, Row, each, mean_errors, shown_progress
from ablate.runs.job import Job
from ablate.runs.run import Run, State, runs_of
from ablate.settings.study import StudySettings
from ablate.storage import digest
from ablate.threads import without_teams
from ablate.training import (
    Engine,
    TrainingPrecision,
    chosen_device,
    chosen_precision,
    load_generator,
    missing_for,
    open_engine,
)
from ablate.ultrasound import scan_converter

_WARMUP = 2
_LOG = logging.getLogger(__name__)
#: How a generator is run.
Execution = tuple[TrainingPrecision, Engine]
Planned = list[tuple[Run, Execution]]


def comparable_runs(job: Job) -> tuple[list[Run], str]:
    """List the finished runs of all studies in `runs_dir` that can be compared, and say how many are left out.

    A run that was trained on other data has seen some of these test frames, or frames of another kind. A run without a
    checkpoint cannot be executed.
    """
    results = job.settings.results
    studies = sorted(path for path in results.glob("*") if path.is_dir())
    runs = [run for study in studies for run in runs_of(study) if run.state is State.finished]
    if not runs:
        return [], f"no trained run in {results}: the simulator alone"
    same = [run for run in runs if run.spec["semantic"]["data"] == job.semantic["data"]]
    fit = [run for run in same if run.checkpoint.exists()]
    others, bare = len(runs) - len(same), len(same) - len(fit)
    counts = [
        f"{len(fit)} trained run{'' if len(fit) == 1 else 's'}",
        f"{others} left out, they learned from other data" if others else "",
        f"{bare} left out, without a checkpoint" if bare else "",
    ]
    return fit, "; ".join(filter(None, counts))


def executions(settings: StudySettings) -> tuple[list[Execution], tuple[str, ...]]:
    """List precisions and engines that this machine can run, eager first, and say what is missing for the others."""
    device = chosen_device(settings.training.device)
    has_bf16 = chosen_precision(TrainingPrecision.auto, device) is TrainingPrecision.bf16
    precisions = (TrainingPrecision.fp32, *([TrainingPrecision.bf16] if has_bf16 else []))
    notes = [] if has_bf16 else [f"bf16: {device.type} here does not multiply it"]
    lacking = {engine: missing_for(engine, device) for engine in Engine}
    notes += [f"engine {engine}: needs {what}" for engine, what in lacking.items() if what]
    return [(p, engine) for engine, what in lacking.items() if not what for p in precisions], tuple(notes)


def schedule_of(runs: list[Run], settings: StudySettings) -> Planned:
    """List each run with each precision and engine that is measured of it.

    Every run is executed in eager mode in all precisions. Exporting takes up to a minute, so only the
    first run of each network is exported: the time of a network does not depend on its weights.
    """
    every, _ = executions(settings)
    eager = [execution for execution in every if Engine.eager in execution]
    first: dict[str, Run] = {}
    ordered = sorted(runs, key=lambda run: (str(run.folder.parents[1]), run.label, run.seed))
    chosen = {r: every if first.setdefault(digest(r.spec["semantic"]["model"]), r) is r else eager for r in ordered}
    return [(run, execution) for run, its_executions in chosen.items() for execution in its_executions]


def make_inputs(bench: Bench, names: tuple[str, ...], space: Space) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """Make inputs of generators in one space, and measure the median milliseconds of each, as `timed_maps`."""
    make = timed_maps(bench.scene, bench.probe, bench.simulator, bench.poses)
    make(nudged(bench.poses[0]), bench.seed, names, space)
    poses = shown_progress(bench.poses, f"inputs of generators, {space} space")
    made = [make(pose, bench.seed, names, space) for pose in poses]
    inputs, times = zip(*made, strict=True)
    arrays = {name: np.stack([maps[name] for maps in inputs]) for name in inputs[0]}
    return arrays, {name: median(taken[name] for taken in times) for name in times[0]}


def measure_generators(
    bench: Bench, planned: Planned, settings: StudySettings, reference: Frames
) -> tuple[list[Row], list[Row]]:
    """Measure every run, in rows as of `measure_simulator`; a frame's time is that of its inputs and of the network.

    An execution that fails, as compilers and runtimes can, is left out with a warning.
    """
    points: list[Row] = []
    details: list[Row] = []
    if not planned:
        return points, details
    made = lru_cache(partial(make_inputs, bench))
    device = chosen_device(settings.training.device)
    exact: dict[Run, Frames] = {}
    for run, execution in shown_progress(planned, "trained runs"):
        study, width = run.folder.parents[1].name, run.spec["settings"]["model"]["width"]
        elsewhere = "" if study == settings.study else f", {study}"
        setting = f"width {width:g}, {', '.join(execution)}, seed {run.seed}{elsewhere}"
        try:
            generator = load_generator(run.checkpoint, settings.model.target).to(device)
            maps, needed = made(conditions(generator.spec), generator.spec.space)
            rendered, network_ms = _render(run, generator, maps, bench, execution)
        except Exception as failure:
            _LOG.warning("left out, %s, %s: %s", run.label, setting, " ".join(str(failure).split())[:300])
            continue
        ms = sum(needed.values()) + network_ms
        points += each(run.label, setting, ms, values=mean_errors(rendered, reference, bench.probe))
        details += each("stage", run.label, setting, values={**needed, "network": network_ms})
        if execution == (TrainingPrecision.fp32, Engine.eager):
            exact[run] = rendered
        elif run in exact:
            errors = mean_errors(rendered, exact[run], bench.probe)
            details += each("limit", f"{run.label}, against fp32 eager", setting, values=errors)
    return points, details


@torch.inference_mode()
def _render(
    run: Run, generator: Generator, maps: dict[str, np.ndarray], bench: Bench, execution: Execution
) -> tuple[Frames, float]:
    """Render every frame, and measure the median milliseconds from stored maps to grey levels, after a warm-up."""
    trained, in_beam_space = run.settings, generator.spec.space is Space.beam
    values = label_values(bench.scene.tissues, trained.encoding, trained.label_seed)
    device = next(generator.parameters()).device
    simulator = bench.simulator
    render = open_engine(generator, *(simulator.beam_shape if in_beam_space else simulator.image_shape), *execution)
    converter = scan_converter(bench.probe, simulator.beam_shape, simulator.image_shape)
    fan = np.ones(simulator.beam_shape, bool) if in_beam_space else converter.mask
    mask = torch.from_numpy(fan).to(device)
    images, times = [], []
    for k in [0] * _WARMUP + list(range(len(bench.frames))):
        start = time.perf_counter()
        read = network_inputs({name: m[k : k + 1] for name, m in maps.items()}, values, fan)
        seed = torch.tensor([int(bench.frames[k])], device=device)
        image = render({name: m.to(device) for name, m in read.items()}, seed)
        with without_teams():
            levels = decode_grey_levels(image[0, 0], mask).cpu().numpy()  # waits for the device
        images.append(converter.to_image(levels) if in_beam_space else levels)
        times.append(1e3 * (time.perf_counter() - start))
    return Frames(np.stack(images[_WARMUP:])), median(times[_WARMUP:])
