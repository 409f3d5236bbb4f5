"""What all measurements share, and the simulator measured one setting at a time away from those of the data set."""

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import Any, TypeVar

import numpy as np
from tqdm import tqdm

from ablate.anatomy import Scene
from ablate.dataset import Part, equally_spaced
from ablate.dataset.simulate import nudged
from ablate.metrics import METRICS, Pair, evaluate_image
from ablate.sources.prepare import frames_of, simulator_of
from ablate.sources.source import source_of
from ablate.study.job import Job
from ablate.ultrasound import Probe, Simulator, SimulatorPrecision, SimulatorSettings, fan_mask
from ablate.ultrasound.probe import pixel_size_mm
from ablate.ultrasound.stages import Stage, stage_times

T = TypeVar("T")
Row = tuple[object, ...]
_TURN = 2  # poses of one setting before the next setting
ENVELOPE = "envelope_rms"
#: On the whole image as in the tables of a study; `mae_smooth` in the fan, after a Gaussian that averages speckle.
IMAGE_ERRORS = tuple(METRICS[name] for name in ("mae", "psnr", "pchi2", "mae_smooth"))

RAYS = (1, 2, 4, 8, 16, 32, 64, 128)
LAYERS = (1, 3, 5)
_FRACTIONS = (0.25, 0.5, 1, 2)  # of the data set's scanlines and axial samples
REFERENCE_RAYS = 4096
_FINEST_LAYERS = 8  # even, so that only its two outermost planes are also planes of the ladder
_FINER = 4  # times as many scanlines or axial samples, and rays, so that Monte-Carlo noise is negligible
_GRIDS = ("layers", "scanlines", "axial_samples")
RAYS_SERIES = "simulator, rays"
OTHER_SERIES = "simulator, other scatterers"


@dataclass(frozen=True)
class Frames:
    """Rendered poses: images, (n, H, W) uint8, and envelopes, (n, samples, scanlines) float32.

    Envelopes are linear, before gain, noise and logarithm. A generator has none.
    """

    images: np.ndarray
    envelopes: np.ndarray | None = None


@dataclass(frozen=True)
class Bench:
    """Some test frames of a data set: their numbers, (n,), their poses, (n, 4, 4) in mm, and the seed of scatterers."""

    scene: Scene
    probe: Probe
    simulator: SimulatorSettings
    frames: np.ndarray
    poses: np.ndarray
    seed: int


def bench_of(job: Job) -> Bench:
    """Choose `evaluation.timed_frames` test frames of the study's data set, which need not be simulated yet.

    The settings are those of the data set. It raises ValueError when a mesh or all poses
    cannot be used.
    """
    settings = job.settings
    scene, grid = source_of(settings).scene()
    known = frames_of(settings, job.data, scene, grid)
    frames = equally_spaced(np.flatnonzero(known.split == Part.test), settings.evaluation.timed_frames)
    simulator = simulator_of(settings, job.data, scene, grid, known.poses)
    return Bench(scene, settings.probe, simulator, frames, known.poses[frames], settings.dataset.seed)


def envelope_rms(envelope: np.ndarray, reference: np.ndarray) -> float:
    """Compute the root of the sum of squared differences over that of the reference; sums are in float64.

    It is 0 if both are zero everywhere, and infinite if only the reference is.
    """
    difference = float(np.sum(np.square(np.subtract(envelope, reference, dtype=np.float64))))
    power = float(np.sum(np.square(reference, dtype=np.float64)))
    if power == 0:
        return 0.0 if difference == 0 else float("inf")
    return (difference / power) ** 0.5


def mean_errors(rendered: Frames, reference: Frames, probe: Probe) -> dict[str, float]:
    """Average each error over the frames of the same poses; an error that cannot be computed is left out.

    `envelope_rms` is left out where there are no envelopes or their grids differ: images are compared on the same
    pixels whatever the grid of samples. PSNR of identical images is infinite; they are left out of its mean, unless all
    are.
    """
    errors: dict[str, list[float]] = {}
    here, there = rendered.envelopes, reference.envelopes
    if here is not None and there is not None and here.shape == there.shape:
        errors[ENVELOPE] = [envelope_rms(a, b) for a, b in zip(here, there, strict=True)]
    shape = (reference.images.shape[1], reference.images.shape[2])
    mask, pixel_mm = fan_mask(probe, shape), pixel_size_mm(probe, shape)
    for image, target in zip(rendered.images, reference.images, strict=True):
        for name, error in evaluate_image(Pair(image, target, mask, pixel_mm=pixel_mm), IMAGE_ERRORS).items():
            errors.setdefault(name, []).append(error)
    finite = {name: [v for v in values if np.isfinite(v)] for name, values in errors.items()}
    return {name: float(np.mean(finite[name])) if finite[name] else values[0] for name, values in errors.items()}


def relative_change(metric: str, error: float, other: float) -> float:
    """Compute the relative change of an error with another reference; PSNR is converted to the RMS error."""
    if error == other:
        return 0.0
    if metric == "psnr":
        return abs(10 ** ((error - other) / 20) - 1)
    return abs(other / error - 1) if error else float("inf")


def each(*first: object, values: Mapping[str, float]) -> list[Row]:
    """Make one row for each value: the first columns, its name and the value."""
    return [(*first, name, value) for name, value in values.items()]


def shown_progress(steps: Iterable[T], what: str) -> Iterable[T]:
    """Give each step in turn, and show how many are done of what is measured."""
    return tqdm(steps, f"precision, {what.replace('_', ' ')}", unit="step", leave=False, disable=None)


def render_all(
    bench: Bench, several: Sequence[SimulatorSettings], seeds: Sequence[int], what: str
) -> list[tuple[list[Frames], float]]:
    """Return the frames of each seed of the scatterers, and the median milliseconds of an image, by setting.

    The speed of a machine changes over seconds. Therefore the settings take turns, a few poses each, in an order that
    is reversed every time. Only the first seed is timed; the others reuse its rays. Each pose is new to the simulator,
    and the first rendering of a turn is not counted. The time excludes all maps, which an image does not need,
    and the noise of the receiver, which is kept over a series of frames.
    """
    simulators = [Simulator(bench.scene, bench.probe, settings, poses=bench.poses) for settings in several]
    rows: list[list[list[tuple[np.ndarray, np.ndarray]]]] = [[] for _ in several]
    times: list[list[float]] = [[] for _ in several]
    turns = list(range(len(several)))
    for begin in shown_progress(range(0, len(bench.poses), _TURN), what):
        for k in turns:
            simulator = simulators[k]
            simulator.render(nudged(bench.poses[begin]), seeds[0])
            for pose in bench.poses[begin : begin + _TURN]:
                start = time.perf_counter()
                simulator.image(pose, seeds[0])
                times[k].append(1e3 * (time.perf_counter() - start))
                shown = [simulator.render(pose, seed) for seed in seeds]
                rows[k].append([(f.image, f.envelope) for f in shown])  # the maps of all settings would take gigabytes
                if len(seeds) > 1:
                    simulator.render(pose, seeds[0])  # a simulator keeps the noise of its last seed
        turns.reverse()
    stacked = [[Frames(*map(np.stack, zip(*column, strict=True))) for column in zip(*r, strict=True)] for r in rows]
    return [(frames, median(t)) for frames, t in zip(stacked, times, strict=True)]


def time_stages(bench: Bench, settings: SimulatorSettings) -> dict[str, float]:
    """Measure the median milliseconds of each stage of an image, in order; the rest is `everything else`."""
    simulator = Simulator(bench.scene, bench.probe, settings, poses=bench.poses)
    simulator.render(nudged(bench.poses[0]), bench.seed)
    whole, each = [], []
    for pose in shown_progress(bench.poses, f"stages of {settings.rays} rays"):
        with stage_times() as taken:
            start = time.perf_counter()
            simulator.image(pose, bench.seed)
            whole.append(1e3 * (time.perf_counter() - start))
        each.append([sum(taken[name]) for name in Stage])
    columns = zip(Stage, zip(*each, strict=True), strict=True)
    stages = {name.value: median(column) for name, column in columns if any(column)}
    return stages | {"everything else": median(np.subtract(whole, np.sum(each, axis=1)).tolist())}


def ladders(base: SimulatorSettings) -> dict[str, dict[int, SimulatorSettings]]:
    """List settings by the name and the value of what is changed; each ladder includes `base` itself."""
    values: dict[str, set[Any]] = {"rays": {*RAYS, base.rays}, "layers": {*LAYERS, base.layers}}
    for name, whole in (("scanlines", 1), ("axial_samples", min(base.samples_per_row, base.axial_samples))):
        values[name] = {whole * max(1, round(part * getattr(base, name) / whole)) for part in _FRACTIONS}
    return {name: {v: replace(base, **{name: v}) for v in sorted(chosen)} for name, chosen in values.items()}


def measure_simulator(bench: Bench) -> tuple[Frames, list[Row], list[Row]]:
    """Measure the simulator: the reference, rows of errors and times, and rows of convergence, limits and stages.

    The reference has `REFERENCE_RAYS` rays and otherwise the settings of the data set. The receiver's noise and the
    phases of clutter depend on `path_seed` and on the grid, not on the rays. With another number of rays and the same
    `path_seed` only the paths differ.
    """
    base, seeds = bench.simulator, (bench.seed, bench.seed + 1)
    ((reference,), _), ((half,), _) = (
        render_all(bench, [replace(base, rays=rays)], seeds[:1], f"reference of {rays} rays")[0]
        for rays in (REFERENCE_RAYS, REFERENCE_RAYS // 2)
    )

    def errors_of(frames: Frames, other: Frames = reference) -> dict[str, float]:
        return mean_errors(frames, other, bench.probe)

    points: list[Row] = []
    details: list[Row] = []
    for name, ladder in ladders(base).items():
        measured, words = render_all(bench, list(ladder.values()), seeds, name), name.replace("_", " ")
        for value, ((rendered, other), ms) in zip(ladder, measured, strict=True):
            errors = errors_of(rendered)
            points += each(f"simulator, {words}", value, ms, values=errors)
            points += each(OTHER_SERIES, f"{words} {value}", ms, values=errors_of(other))
            if name == "rays":
                to_half = errors_of(rendered, half)
                changes = {metric: relative_change(metric, errors[metric], to_half[metric]) for metric in errors}
                details += each("reference", RAYS_SERIES, value, values=changes)
            if value == getattr(base, name):
                usual = rendered
    for name in _GRIDS:
        for setting, errors in _converging(bench, name).items():
            details += each("convergence", f"simulator, {name.replace('_', ' ')}", setting, values=errors)
    in_float64 = replace(base, precision=SimulatorPrecision.float64)
    (((double,), _),) = render_all(bench, [in_float64], seeds[:1], "float64")
    limits = errors_of(usual, double)  # of the signal chain in single precision, on the same paths
    details += each("limit", "simulator, float32 against float64", base.rays, values=limits)
    for rays in sorted({RAYS[0], base.rays, RAYS[-1]}):
        details += each("stage", RAYS_SERIES, rays, values=time_stages(bench, replace(base, rays=rays)))
    return reference, points, details


def _converging(bench: Bench, name: str) -> dict[str | int, dict[str, float]]:
    """Compare grids with a finer one, all with more rays, and the finer one with other scatterers as a scale."""
    base, seeds = replace(bench.simulator, rays=_FINER * bench.simulator.rays), (bench.seed, bench.seed + 1)
    finest: Any = _FINEST_LAYERS if name == "layers" else _FINER * getattr(base, name)
    (((fine, other), _),) = render_all(bench, [replace(base, **{name: finest})], seeds, f"finest {name}")
    grids = ladders(base)[name]
    measured = render_all(bench, list(grids.values()), seeds[:1], f"convergence of {name}")
    rendered = {"other scatterers": other} | {v: f for v, ((f,), _) in zip(grids, measured, strict=True)}
    return {setting: mean_errors(frames, fine, bench.probe) for setting, frames in rendered.items()}
