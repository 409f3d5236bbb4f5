"""What all measurements share, and the simulator measured one setting at a time away from those of the data set."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
from tqdm import tqdm

from ablate.anatomy import Scene
from ablate.dataset import Part, equally_spaced
from ablate.dataset.simulate import nudged
from ablate.evaluation import time_in_turns
from ablate.numerics.precision.errors import Frames, finite_mean, frame_errors, mean_errors, relative_change
from ablate.sources.prepare import frames_of, simulator_of
from ablate.sources.source import source_of
from ablate.study.job import Job
from ablate.ultrasound import Probe, Simulator, SimulatorPrecision, SimulatorSettings

T = TypeVar("T")
Row = tuple[object, ...]
Frame = tuple[np.ndarray, np.ndarray]  # an image and its envelope

RAYS = (1, 2, 4, 8, 16, 32, 64, 128)
LAYERS = (1, 3, 5)
ANGLES = (1, 3, 5, 7, 9)  # up to those of the data set
_FRACTIONS = (0.25, 0.5, 1, 2)  # of the data set's scanlines and axial samples
REFERENCE_RAYS = 4096
_FINEST_LAYERS = 8  # even, so that only its two outermost planes are also planes of the ladder
_FINER = 4  # times as many scanlines or axial samples, and rays, so that Monte-Carlo noise is negligible
_GRIDS = ("layers", "scanlines", "axial_samples")
RAYS_SERIES = "simulator, rays"
COMBINED_SERIES = "simulator, combined"
OTHER_SERIES = "simulator, other scatterers"


@dataclass(frozen=True)
class Bench:
    """Some test frames of a data set: their numbers, (n,), their poses, (n, 4, 4) in mm, and the seed of scatterers.

    `target` is the dotted path of a simulator of the user's own.
    """

    scene: Scene
    probe: Probe
    simulator: SimulatorSettings
    frames: np.ndarray
    poses: np.ndarray
    seed: int
    target: str | None = None

    @property
    def usual(self) -> str:
        """The setting of a simulator that is the re-simulation."""
        return f"rays {self.simulator.rays}" if self.target is None else self.target


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
    return Bench(
        scene, settings.probe, simulator, frames, known.poses[frames], settings.dataset.seed, settings.scene.target
    )


def each(*first: object, values: Mapping[str, float]) -> list[Row]:
    """Make one row for each value: the first columns, its name and the value."""
    return [(*first, name, value) for name, value in values.items()]


def progress_text(what: str) -> str:
    """What stands at a bar."""
    return f"precision, {what.replace('_', ' ')}"


def shown_progress(steps: Iterable[T], what: str) -> Iterable[T]:
    """Give each step in turn, and show how many are done of what is measured."""
    return tqdm(steps, progress_text(what), unit="step", leave=False, disable=None)


def render_all(
    bench: Bench, several: Sequence[SimulatorSettings], seeds: Sequence[int], what: str
) -> list[tuple[list[Frames], float]]:
    """Render the poses with several settings, and time an image of each.

    The settings take turns. Only the first seed is timed; the others reuse its rays. Each pose is new to the simulator,
    which has just rendered another one. The time excludes all maps, which an image does not need, and the noise of the
    receiver, which is kept over a series of frames.

    Parameters
    ----------
    bench : Bench
        Scene, probe and poses.
    several : sequence of SimulatorSettings
        Those that are compared.
    seeds : sequence of int
        Of the scatterers.
    what : str
        Stands at the bar that shows how far it is.

    Returns
    -------
    list of (list of Frames, float)
        By setting the frames of each seed, and the median milliseconds of an image.
    """
    simulators = {
        str(place): Simulator(bench.scene, bench.probe, settings, poses=bench.poses)
        for place, settings in enumerate(several)
    }
    shown: dict[str, list[list[Frame]]] = {name: [[] for _ in seeds] for name in simulators}

    def render_another(name: str, number: int) -> None:
        simulators[name].render(nudged(bench.poses[number - 1]), seeds[0])

    def time_image(simulator: Simulator, number: int) -> None:
        simulator.image(bench.poses[number - 1], seeds[0])

    def keep_frames(name: str, number: int) -> None:
        for seed, frames in zip(seeds, shown[name], strict=True):
            frame = simulators[name].render(bench.poses[number - 1], seed)
            frames.append((frame.image, frame.envelope))  # the maps of all settings would take gigabytes

    times = time_in_turns(
        {name: partial(time_image, simulator) for name, simulator in simulators.items()},
        rounds=len(bench.poses),
        warm_up=0,
        before=render_another,
        after=keep_frames,
        what=progress_text(what),
    )
    median_ms = times.groupby("call")["ms"].median()
    return [([_stacked(frames) for frames in shown[name]], float(median_ms[name])) for name in simulators]


def _stacked(frames: Sequence[Frame]) -> Frames:
    images, envelopes = zip(*frames, strict=True)
    return Frames(np.stack(images), np.stack(envelopes))


def ladders(base: SimulatorSettings) -> dict[str, dict[int, SimulatorSettings]]:
    """List settings by the name and the value of what is changed; each ladder includes `base` itself."""
    values = {
        "rays": {*RAYS, base.rays},
        "layers": {*LAYERS, base.layers},
        "scanlines": _fractions(base.scanlines),
        "axial_samples": _fractions(base.axial_samples, min(base.samples_per_row, base.axial_samples)),
    }
    if base.compound_angles > 1:
        values["compound_angles"] = {angles for angles in ANGLES if angles <= base.compound_angles}
    return {name: {value: changed(base, {name: value}) for value in sorted(steps)} for name, steps in values.items()}


def combined(base: SimulatorSettings) -> list[dict[str, int]]:
    """List what is changed together, so that a frame takes the least time without another grid."""
    cheap = {"rays": 2, "layers": 1}
    if base.compound_angles == 1:
        return [cheap]
    return [cheap, {**cheap, "compound_angles": 1}]


def _fractions(length: int, step: int = 1) -> set[int]:
    """The nearest multiples of a step to fractions of a length."""
    return {step * max(1, round(fraction * length / step)) for fraction in _FRACTIONS}


def changed(base: SimulatorSettings, changes: Mapping[str, Any]) -> SimulatorSettings:
    return replace(base, **changes)


@dataclass(frozen=True)
class Measured:
    """What was measured, as rows.

    `points` are series, setting, milliseconds, metric, mean error; `details` are table, series, setting, quantity,
    value; and `of_frames` are series, setting, metric, frame, error, of renderers that do not know the scatterers.
    """

    points: list[Row] = field(default_factory=list)
    details: list[Row] = field(default_factory=list)
    of_frames: list[Row] = field(default_factory=list)

    def add_renderer(self, series: str, setting: str, ms: float, errors: Mapping[str, Sequence[float]]) -> None:
        """Add one that does not know the scatterers.

        Parameters
        ----------
        series, setting : str
            Its name in tables.
        ms : float
            The median time of a frame.
        errors : mapping of str to sequence of float
            By metric, one a frame.
        """
        means = {name: finite_mean(values) for name, values in errors.items()}
        self.points.extend(each(series, setting, ms, values=means))
        self.of_frames.extend(
            (series, setting, name, frame, error)
            for name, values in errors.items()
            for frame, error in enumerate(values)
        )


def measure_simulator(bench: Bench) -> tuple[Frames, Measured]:
    """Measure the simulator: the reference, and errors and times, convergence and limits.

    The reference has `REFERENCE_RAYS` rays and otherwise the settings of the data set. The receiver's noise and the
    phases of clutter depend on `path_seed` and on the grid, not on the rays. With another number of rays and the same
    `path_seed` only the paths differ.
    """
    base = bench.simulator
    reference = _rendered(bench, replace(base, rays=REFERENCE_RAYS), f"reference of {REFERENCE_RAYS} rays")
    half_rays = REFERENCE_RAYS // 2
    half = _rendered(bench, replace(base, rays=half_rays), f"reference of {half_rays} rays")
    found = Measured()
    points, details = found.points, found.details
    for name, ladder in ladders(base).items():
        measured = render_all(bench, list(ladder.values()), (bench.seed, bench.seed + 1), name)
        words = name.replace("_", " ")
        for value, ((rendered, other), ms) in zip(ladder, measured, strict=True):
            errors = mean_errors(rendered, reference, bench.probe)
            points += each(f"simulator, {words}", value, ms, values=errors)
            found.add_renderer(OTHER_SERIES, f"{words} {value}", ms, frame_errors(other, reference, bench.probe))
            if name == "rays":
                to_half = mean_errors(rendered, half, bench.probe)
                changes = {metric: relative_change(metric, errors[metric], to_half[metric]) for metric in errors}
                details += each("reference", RAYS_SERIES, value, values=changes)
            if value == getattr(base, name):
                usual = rendered
    together = {setting_in_words(changes): changed(base, changes) for changes in combined(base)}
    measured = render_all(bench, list(together.values()), (bench.seed, bench.seed + 1), "settings combined")
    for words, ((rendered, other), ms) in zip(together, measured, strict=True):
        points += each(COMBINED_SERIES, words, ms, values=mean_errors(rendered, reference, bench.probe))
        found.add_renderer(OTHER_SERIES, words, ms, frame_errors(other, reference, bench.probe))
    for name in _GRIDS:
        for setting, errors in _converging(bench, name).items():
            details += each("convergence", f"simulator, {name.replace('_', ' ')}", setting, values=errors)
    double = _rendered(bench, replace(base, precision=SimulatorPrecision.float64), "float64")
    limits = mean_errors(usual, double, bench.probe)  # of the signal chain in single precision, on the same paths
    details += each("limit", "simulator, float32 against float64", base.rays, values=limits)
    return reference, found


def setting_in_words(changes: Mapping[str, int]) -> str:
    """Several settings as one: `rays 2, layers 1`."""
    return ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in changes.items())


def _rendered(bench: Bench, settings: SimulatorSettings, what: str) -> Frames:
    """The poses with one setting and the seed of the data set."""
    (((frames,), _),) = render_all(bench, [settings], [bench.seed], what)
    return frames


def _converging(bench: Bench, name: str) -> dict[str | int, dict[str, float]]:
    """Compare grids with a finer one, all with more rays, and the finer one with other scatterers as a scale."""
    base = replace(bench.simulator, rays=_FINER * bench.simulator.rays)
    finest = _FINEST_LAYERS if name == "layers" else _FINER * getattr(base, name)
    seeds = (bench.seed, bench.seed + 1)
    (((fine, other), _),) = render_all(bench, [changed(base, {name: finest})], seeds, f"finest {name}")
    grids = ladders(base)[name]
    measured = render_all(bench, list(grids.values()), seeds[:1], f"convergence of {name}")
    rendered: dict[str | int, Frames] = {"other scatterers": other}
    for value, ((frames,), _) in zip(grids, measured, strict=True):
        rendered[value] = frames
    return {setting: mean_errors(frames, fine, bench.probe) for setting, frames in rendered.items()}
