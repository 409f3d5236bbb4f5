"""Error and time of renderers that do not know the scatterers: trained runs, shipped networks and the formula."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from statistics import median

import numpy as np
import torch

from ablate.anatomy import Tissue
from ablate.dataset import decode_grey_levels, label_values, network_inputs
from ablate.dataset.simulate import nudged, timed_maps
from ablate.evaluation import formula_maps, time_in_turns
from ablate.metrics.metric import FORMULA
from ablate.networks import Generator, GeneratorSpec, Space, conditions
from ablate.numerics.precision.bench import Bench, Measured, each, shown_progress
from ablate.numerics.precision.errors import Frames, frame_errors, mean_errors, with_histogram_of
from ablate.pretrained.renderer import NAMES, OUTSIDE, Renderer, load
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
from ablate.ultrasound.formula import Formula

SHIPPED = "shipped"  # begins the series of a network that comes with the package
NETWORK = "network"  # what the time of a frame is beside that of its maps
_WARMUP = 2
_LOG = logging.getLogger(__name__)
#: How a generator is run.
Execution = tuple[TrainingPrecision, Engine]


@dataclass(frozen=True, eq=False)
class Candidate:
    """A network that is measured.

    Attributes
    ----------
    series : str
        The label of a run, or `shipped` and a name.
    about : tuple of str
        Width, and behind the execution the seed and another study than the one that asks.
    network : str
        Runs with the same one are exported once: the time of a network does not depend on its weights.
    load : callable
        Given the tissues of the scene, the generator on the CPU, and the values that it reads for labels.
    """

    series: str
    about: tuple[str, ...]
    network: str
    load: Callable[[Sequence[Tissue]], tuple[Generator, np.ndarray]]

    def setting(self, execution: Execution) -> str:
        """What tells the executions of a variant apart."""
        width, *others = self.about
        return ", ".join([width, *execution, *others])


Planned = list[tuple[Candidate, Execution]]


def comparable_runs(job: Job, shipped: Sequence[Candidate] = ()) -> tuple[list[Training], str]:
    """List the finished runs of all studies in `runs_dir` that can be compared, and say in words what is measured.

    A run that was trained on other data has seen some of these test frames, or frames of another kind. A run without a
    checkpoint cannot be executed. Both are counted; the `shipped` networks are named.
    """
    results = job.settings.results
    studies = sorted(path for path in results.glob("*") if path.is_dir())
    runs = [training for study in studies for training in trainings_in(study) if training.is_trained]
    if not runs and not shipped:
        return [], f"no trained run in {results}: the simulator alone"
    same = [run for run in runs if run.identity["data"] == job.identity["data"]]
    fit = [run for run in same if run.checkpoint.exists()]
    others = len(runs) - len(same)
    bare = len(same) - len(fit)
    counts = [
        f"{len(fit)} trained run{'' if len(fit) == 1 else 's'}" if runs else f"no trained run in {results}",
        f"{others} left out, they learned from other data" if others else "",
        f"{bare} left out, without a checkpoint" if bare else "",
        *(candidate.series for candidate in shipped),
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


def schedule_of(runs: Sequence[Training], settings: StudySettings, shipped: Sequence[Candidate] = ()) -> Planned:
    """List each run and each shipped network with each precision and engine that is measured of it.

    Every network is executed in eager mode in all precisions. Exporting takes up to a minute, so only the first run of
    each network is exported.
    """
    every, _ = executions(settings)
    eager = [execution for execution in every if Engine.eager in execution]
    ordered = sorted(runs, key=lambda run: (str(run.folder.parent), run.label, run.seed))
    exported: set[str] = set()
    planned: Planned = []
    for candidate in (*shipped, *(_of_run(run, settings) for run in ordered)):
        planned += [(candidate, execution) for execution in (eager if candidate.network in exported else every)]
        exported.add(candidate.network)
    return planned


def _of_run(run: Training, settings: StudySettings) -> Candidate:
    about = [f"width {run.about['settings']['model']['width']:g}", f"seed {run.seed}"]
    if run.folder.parent.name != settings.study:
        about.append(run.folder.parent.name)

    def load(tissues: Sequence[Tissue]) -> tuple[Generator, np.ndarray]:
        values = label_values(tissues, run.settings.encoding, run.settings.label_seed)
        return load_generator(run.checkpoint, settings.model.target), values

    return Candidate(run.label, tuple(about), digest(run.identity["model"]), load)


def shipped_candidates(bench: Bench) -> list[Candidate]:
    """The networks that come with the package and were trained on such frames: probe, size, angles and tissues.

    No network was trained on those of a simulator of the user's own.
    """
    found = []
    for name in NAMES if bench.target is None else ():
        renderer = load(name)
        trained = renderer.simulator
        frames = [(s.image_shape, s.beam_shape, s.compound_angles) for s in (trained, bench.simulator)]
        knows = {tissue.name for tissue in bench.scene.tissues} <= renderer.values.keys()
        if renderer.probe == bench.probe and frames[0] == frames[1] and knows:
            spec = renderer.generator.spec
            found.append(Candidate(f"{SHIPPED} {name}", (f"width {spec.width:g}",), name, partial(_shipped, renderer)))
    return found


def _shipped(renderer: Renderer, tissues: Sequence[Tissue]) -> tuple[Generator, np.ndarray]:
    values = [renderer.values[OUTSIDE], *(renderer.values[tissue.name] for tissue in tissues)]
    return renderer.generator, np.asarray(values, np.float32)


def make_inputs(bench: Bench, names: tuple[str, ...], space: Space) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """Make inputs of generators in one space, and measure the median milliseconds of each, as `timed_maps`."""
    make = timed_maps(bench.scene, bench.probe, bench.simulator, bench.poses)
    make(nudged(bench.poses[0]), bench.seed, names, space)
    poses = shown_progress(bench.poses, f"inputs of generators, {space} space")
    inputs_and_times = [make(pose, bench.seed, names, space) for pose in poses]
    inputs, times = zip(*inputs_and_times, strict=True)
    arrays = {name: np.stack([maps[name] for maps in inputs]) for name in inputs[0]}
    return arrays, {name: median(taken[name] for taken in times) for name in times[0]}


def with_other_scatterers(bench: Bench) -> Bench:
    """The same frames with scatterers that the reference does not have: a renderer may read no others of it."""
    return replace(bench, seed=bench.seed + 1)


def measure_generators(bench: Bench, planned: Planned, settings: StudySettings, reference: Frames) -> Measured:
    """Measure every network; a frame's time is that of its inputs and of the network.

    The scatterers that it reads are not those of the reference. An execution that fails, as compilers and runtimes
    can, is left out with a warning.

    Parameters
    ----------
    bench : Bench
        The frames.
    planned : list of (Candidate, Execution)
        As of `schedule_of`.
    settings : StudySettings
        Those of the study that asks.
    reference : Frames
        As of `measure_simulator`.
    """
    found = Measured()
    if not planned:
        return found
    inputs_of = lru_cache(partial(make_inputs, with_other_scatterers(bench)))
    device = chosen_device(settings.training.device)
    exact: dict[Candidate, Frames] = {}
    for candidate, execution in shown_progress(planned, "networks"):
        setting = candidate.setting(execution)
        try:
            generator, values = candidate.load(bench.scene.tissues)
            maps, inputs_ms = inputs_of(conditions(generator.spec), generator.spec.space)
            rendered, network_ms = _render(generator.to(device), values, maps, bench, execution)
        except Exception as failure:
            _LOG.warning("left out, %s, %s: %s", candidate.series, setting, " ".join(str(failure).split())[:300])
            continue
        ms = sum(inputs_ms.values()) + network_ms
        found.add_renderer(candidate.series, setting, ms, frame_errors(rendered, reference, bench.probe))
        found.details.extend(each("stage", candidate.series, setting, values={**inputs_ms, NETWORK: network_ms}))
        if execution == (TrainingPrecision.fp32, Engine.eager):
            exact[candidate] = rendered
        elif candidate in exact:
            errors = mean_errors(rendered, exact[candidate], bench.probe)
            found.details.extend(each("limit", f"{candidate.series}, against fp32 eager", setting, values=errors))
    return found


def measure_formula(bench: Bench, spec: GeneratorSpec, reference: Frames) -> Measured:
    """Measure the formula of the maps that a network of `spec` reads, as a network is measured.

    Beside a simulator of the user's own, its grey levels are matched as those of ablate's simulator are.
    """
    names = formula_maps(spec)
    maps, inputs_ms = make_inputs(with_other_scatterers(bench), names, Space.beam)
    formula = Formula(bench.scene.tissues, bench.probe, bench.simulator)
    converter = scan_converter(bench.probe, bench.simulator.beam_shape, bench.simulator.image_shape)

    def render_frame(frame: int) -> np.ndarray:
        insonified = formula.insonified({name: all_frames[frame] for name, all_frames in maps.items()})
        return converter.to_image(formula(insonified, int(bench.frames[frame])))

    rendered, formula_ms = _all_frames(render_frame, len(bench.frames))
    if bench.target is not None:
        rendered = with_histogram_of(rendered, reference, bench.probe)
    setting = ", ".join(names)
    found = Measured()
    ms = sum(inputs_ms.values()) + formula_ms
    found.add_renderer(FORMULA, setting, ms, frame_errors(rendered, reference, bench.probe))
    found.details.extend(each("stage", FORMULA, setting, values={**inputs_ms, NETWORK: formula_ms}))
    return found


@torch.inference_mode()
def _render(
    generator: Generator, values: np.ndarray, maps: dict[str, np.ndarray], bench: Bench, execution: Execution
) -> tuple[Frames, float]:
    """Render every frame, and measure the median milliseconds from stored maps to grey levels."""
    device = next(generator.parameters()).device
    in_beam_space = generator.spec.space is Space.beam
    image_shape = bench.simulator.image_shape
    beam_shape = bench.simulator.beam_shape
    render = open_engine(generator, *(beam_shape if in_beam_space else image_shape), *execution)
    converter = scan_converter(bench.probe, beam_shape, image_shape)
    fan = np.ones(beam_shape, bool) if in_beam_space else converter.mask
    mask = torch.from_numpy(fan).to(device)

    def render_frame(frame: int) -> np.ndarray:
        frame_maps = {name: all_frames[frame : frame + 1] for name, all_frames in maps.items()}
        given = {name: read.to(device) for name, read in network_inputs(frame_maps, values, fan).items()}
        image = render(given, torch.tensor([int(bench.frames[frame])], device=device))
        with without_teams():
            levels = decode_grey_levels(image[0, 0], mask).cpu().numpy()  # waits for the device
        return converter.to_image(levels) if in_beam_space else levels

    return _all_frames(render_frame, len(bench.frames))


def _all_frames(render_frame: Callable[[int], np.ndarray], count: int) -> tuple[Frames, float]:
    """Render every frame, and measure the median milliseconds of one, after a warm-up."""
    images: dict[int, np.ndarray] = {}

    def keep(number: int) -> None:
        frame = max(number, 1) - 1
        images[frame] = render_frame(frame)

    times = time_in_turns({NETWORK: keep}, count, warm_up=_WARMUP)
    return Frames(np.stack([images[frame] for frame in sorted(images)])), float(times["ms"].median())
