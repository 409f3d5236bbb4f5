"""The test frames that all measurements use, and the simulator timed on them."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import median

import numpy as np

from ablate.anatomy import Scene
from ablate.dataset import Part, equally_spaced
from ablate.numerics.precision.errors import Frames
from ablate.runs.data import dataset_folder, open_data
from ablate.runs.simulated import build_scene, lay_out
from ablate.runs.timed_maps import TimedMaps, nudged
from ablate.settings.study import StudySettings
from ablate.ultrasound import Frame, Probe, Simulator, SimulatorSettings, fan_mask
from ablate.ultrasound.stages import Stage, stage_times

_TURN = 2  # poses of one setting before the next setting


@dataclass(frozen=True)
class Bench:
    """Some test frames of a data set: their numbers, (n,), their poses, (n, 4, 4) in mm, and the seed of scatterers."""

    scene: Scene
    probe: Probe
    simulator: SimulatorSettings
    frames: np.ndarray
    poses: np.ndarray
    seed: int

    @property
    def mask(self) -> np.ndarray:
        """The fan, (H, W) bool."""
        return fan_mask(self.probe, self.simulator.image_shape)


def bench_of(settings: StudySettings) -> Bench:
    """Choose `evaluation.timed_frames` test frames of the study's data set, which need not be simulated yet.

    The settings are those of the data set with a fixed number of rays. It raises ValueError when a mesh or all poses
    cannot be used.
    """
    scene, grid = build_scene(settings)
    folder = dataset_folder(settings)
    known = open_data(folder).pairs if (folder / "about.json").exists() else lay_out(settings, scene, grid)
    frames = equally_spaced(np.flatnonzero(known.split == Part.test), settings.evaluation.timed_frames)
    fixed = replace(settings.simulator, tolerance=None)
    return Bench(scene, settings.probe, fixed, frames, known.poses[frames], settings.dataset.seed)


def render_all(
    bench: Bench, several: Sequence[SimulatorSettings], seeds: Sequence[int], advance: Callable[[], object]
) -> list[tuple[list[Frames], float]]:
    """Return the frames of each seed of the scatterers, and the median milliseconds of an image, by setting.

    The speed of a machine changes over seconds. Therefore the settings take turns, a few poses each, in an order that
    is reversed every time. Only the first seed is timed; the others reuse its rays. Each pose is new to the simulator,
    and the first rendering of a turn is not counted. The time excludes segmentation and attenuation, which an image
    does not need, and the noise of the receiver, which is kept over a series of frames.
    """
    simulators = [Simulator(bench.scene, bench.probe, settings, poses=bench.poses) for settings in several]
    rows: list[list[list[tuple[np.ndarray, np.ndarray]]]] = [[] for _ in several]
    times: list[list[float]] = [[] for _ in several]
    turns = list(range(len(several)))
    for begin in range(0, len(bench.poses), _TURN):
        for k in turns:
            simulator = simulators[k]
            simulator.render(nudged(bench.poses[begin]), seeds[0])
            for pose in bench.poses[begin : begin + _TURN]:
                simulator.maps(pose)
                start = time.perf_counter()
                first = simulator.render(pose, seeds[0])
                times[k].append(1e3 * (time.perf_counter() - start))
                rows[k].append([_shown(first), *(_shown(simulator.render(pose, seed)) for seed in seeds[1:])])
                if len(seeds) > 1:
                    simulator.render(pose, seeds[0])  # a simulator keeps the noise of its last seed
                advance()
        turns.reverse()
    stacked = [[Frames(*map(np.stack, zip(*column, strict=True))) for column in zip(*r, strict=True)] for r in rows]
    return [(frames, median(t)) for frames, t in zip(stacked, times, strict=True)]


def _shown(frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    """Keep what errors need; the maps of all settings would take gigabytes."""
    return frame.image, frame.envelope


def time_stages(bench: Bench, settings: SimulatorSettings, advance: Callable[[], object]) -> dict[str, float]:
    """Measure the median milliseconds of each stage of an image, in order; the rest is `everything else`."""
    simulator = Simulator(bench.scene, bench.probe, settings, poses=bench.poses)
    simulator.render(nudged(bench.poses[0]), bench.seed)
    whole, each = [], []
    for pose in bench.poses:
        simulator.maps(pose)
        with stage_times() as taken:
            start = time.perf_counter()
            simulator.render(pose, bench.seed)
            whole.append(1e3 * (time.perf_counter() - start))
        each.append([sum(taken[name]) for name in Stage])
        advance()
    columns = zip(Stage, zip(*each, strict=True), strict=True)
    stages = {name.value: median(column) for name, column in columns if any(column)}
    return stages | {"everything else": median(np.subtract(whole, np.sum(each, axis=1)).tolist())}


def make_inputs(bench: Bench, advance: Callable[[], object]) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """Make the inputs of generators, (n, H, W) each, and measure the median milliseconds of each, as `TimedMaps`."""
    make = TimedMaps(bench.scene, bench.probe, bench.simulator, bench.poses, low=True)
    make(nudged(bench.poses[0]), bench.seed)
    made, times = [], []
    for pose in bench.poses:
        maps, taken = make(pose, bench.seed)
        made.append(maps)
        times.append(taken)
        advance()
    arrays = {name: np.stack([maps[name] for maps in made]) for name in made[0]}
    return arrays, {name: median(taken[name] for taken in times) for name in times[0]}
