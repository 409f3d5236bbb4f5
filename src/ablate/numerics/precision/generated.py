"""Error and time of every trained run on disk that was trained on the same pairs."""

import logging
from functools import lru_cache, partial
from statistics import median

import numpy as np
import torch

from ablate.dataset import decode_grey_levels, label_values, network_inputs
from ablate.dataset.simulate import nudged, timed_maps
from ablate.evaluation import time_in_turns
from ablate.networks import Generator, Space, conditions
from ablate.numerics.precision.bench import Bench, Frames, Row, each, mean_errors, shown_progress
from ablate.settings.study import StudySettings
from ablate.storage import digest
from ablate.study.job import Job
from ablate.study.training import Training, trainings_in
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
Planned = list[tuple[Training, Execution]]


def comparable_runs(job: Job) -> tuple[list[Training], str]:
    """List the finished runs of all studies in `runs_dir` that can be compared, and say how many are left out.

    A run that was trained on other data has seen some of these test frames, or frames of another kind. A run without a
    checkpoint cannot be executed.
    """
    results = job.settings.results
    studies = sorted(path for path in results.glob("*") if path.is_dir())
    runs = [training for study in studies for training in trainings_in(study) if training.is_trained]
    if not runs:
        return [], f"no trained run in {results}: the simulator alone"
    same = [run for run in runs if run.identity["data"] == job.identity["data"]]
    fit = [run for run in same if run.checkpoint.exists()]
    others = len(runs) - len(same)
    bare = len(same) - len(fit)
    counts = [
        f"{len(fit)} trained run{'' if len(fit) == 1 else 's'}",
        f"{others} left out, they learned from other data" if others else "",
        f"{bare} left out, without a checkpoint" if bare else "",
    ]
    return fit, "; ".join(filter(None, counts))


def executions(settings: StudySettings) -> tuple[list[Execution], tuple[str, ...]]:
    """List precisions and engines that this machine can run, eager first, and say what is missing for the others."""
    device = chosen_device(settings.training.device)
    precisions = [TrainingPrecision.fp32]
    notes = []
    if chosen_precision(TrainingPrecision.auto, device) is TrainingPrecision.bf16:
        precisions.append(TrainingPrecision.bf16)
    else:
        notes.append(f"bf16: {device.type} here does not multiply it")
    ready = []
    for engine in Engine:
        lacking = missing_for(engine, device)
        if lacking:
            notes.append(f"engine {engine}: needs {lacking}")
        else:
            ready += [(precision, engine) for precision in precisions]
    return ready, tuple(notes)


def schedule_of(runs: list[Training], settings: StudySettings) -> Planned:
    """List each run with each precision and engine that is measured of it.

    Every run is executed in eager mode in all precisions. Exporting takes up to a minute, so only the
    first run of each network is exported: the time of a network does not depend on its weights.
    """
    every, _ = executions(settings)
    eager = [execution for execution in every if Engine.eager in execution]
    exported: set[str] = set()
    planned: Planned = []
    for run in sorted(runs, key=lambda run: (str(run.folder.parent), run.label, run.seed)):
        network = digest(run.identity["model"])
        planned += [(run, execution) for execution in (eager if network in exported else every)]
        exported.add(network)
    return planned


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
    """Measure every run; a frame's time is that of its inputs and of the network.

    An execution that fails, as compilers and runtimes can, is left out with a warning.

    Parameters
    ----------
    bench : Bench
        The frames.
    planned : list of (Run, Execution)
        As of `schedule_of`.
    settings : StudySettings
        Those of the study that asks.
    reference : Frames
        As of `measure_simulator`.

    Returns
    -------
    points, details : lists of rows
        As of `measure_simulator`.
    """
    points: list[Row] = []
    details: list[Row] = []
    if not planned:
        return points, details
    inputs_of = lru_cache(partial(make_inputs, bench))
    device = chosen_device(settings.training.device)
    exact: dict[Training, Frames] = {}
    for run, execution in shown_progress(planned, "trained runs"):
        setting = _setting(run, execution, settings.study)
        try:
            generator = load_generator(run.checkpoint, settings.model.target).to(device)
            maps, inputs_ms = inputs_of(conditions(generator.spec), generator.spec.space)
            rendered, network_ms = _render(run, generator, maps, bench, execution)
        except Exception as failure:
            _LOG.warning("left out, %s, %s: %s", run.label, setting, " ".join(str(failure).split())[:300])
            continue
        ms = sum(inputs_ms.values()) + network_ms
        points += each(run.label, setting, ms, values=mean_errors(rendered, reference, bench.probe))
        details += each("stage", run.label, setting, values={**inputs_ms, "network": network_ms})
        if execution == (TrainingPrecision.fp32, Engine.eager):
            exact[run] = rendered
        elif run in exact:
            errors = mean_errors(rendered, exact[run], bench.probe)
            details += each("limit", f"{run.label}, against fp32 eager", setting, values=errors)
    return points, details


def _setting(run: Training, execution: Execution, study: str) -> str:
    """What tells the executions of a variant apart; another study than the one that asks is named."""
    elsewhere = run.folder.parent.name
    parts = [f"width {run.about['settings']['model']['width']:g}", *execution, f"seed {run.seed}"]
    if elsewhere != study:
        parts.append(elsewhere)
    return ", ".join(parts)


@torch.inference_mode()
def _render(
    run: Training, generator: Generator, maps: dict[str, np.ndarray], bench: Bench, execution: Execution
) -> tuple[Frames, float]:
    """Render every frame, and measure the median milliseconds from stored maps to grey levels, after a warm-up."""
    values = label_values(bench.scene.tissues, run.settings.encoding, run.settings.label_seed)
    device = next(generator.parameters()).device
    in_beam_space = generator.spec.space is Space.beam
    image_shape = bench.simulator.image_shape
    beam_shape = bench.simulator.beam_shape
    render = open_engine(generator, *(beam_shape if in_beam_space else image_shape), *execution)
    converter = scan_converter(bench.probe, beam_shape, image_shape)
    fan = np.ones(beam_shape, bool) if in_beam_space else converter.mask
    mask = torch.from_numpy(fan).to(device)
    images: dict[int, np.ndarray] = {}

    def render_frame(number: int) -> None:
        frame = max(number, 1) - 1
        of_frame = {name: of_all[frame : frame + 1] for name, of_all in maps.items()}
        given = {name: read.to(device) for name, read in network_inputs(of_frame, values, fan).items()}
        image = render(given, torch.tensor([int(bench.frames[frame])], device=device))
        with without_teams():
            levels = decode_grey_levels(image[0, 0], mask).cpu().numpy()  # waits for the device
        images[frame] = converter.to_image(levels) if in_beam_space else levels

    times = time_in_turns({run.label: render_frame}, len(bench.frames), warm_up=_WARMUP)
    return Frames(np.stack([images[frame] for frame in sorted(images)])), float(times["ms"].median())
