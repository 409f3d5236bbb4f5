"""The poses that everything is measured on, and the simulator timed on them."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import median

import numpy as np

from ablate.anatomy import Scene
from ablate.config import StudySettings
from ablate.dataset import Part, equally_spaced
from ablate.studies.data import build_scene, dataset_folder, open_data
from ablate.studies.layout import lay_out
from ablate.studies.precision.errors import Shots
from ablate.ultrasound import ConvexProbe, Frame, Simulator, SimulatorSettings, fan_mask
from ablate.ultrasound.stage_times import STAGES, stage_times

Shown = tuple[np.ndarray, np.ndarray]  # image and envelope

_TURN = 2  # poses in a row
_NUDGE_MM = 1e-3  # a pose of its own: a simulator remembers the last one


@dataclass(frozen=True)
class Bench:
    """Some test frames of a data set.

    Attributes
    ----------
    scene : Scene
    probe : ConvexProbe
    simulator : SimulatorSettings
        Of the data set.
    frames : (n,) int
        Their numbers in the data set.
    poses : (n, 4, 4) float64
        Probe to world, mm.
    seed : int
        Of the scatterers.
    """

    scene: Scene
    probe: ConvexProbe
    simulator: SimulatorSettings
    frames: np.ndarray
    poses: np.ndarray
    seed: int

    @property
    def mask(self) -> np.ndarray:
        """The fan, (H, W) bool."""
        return fan_mask(self.probe, self.simulator.image_shape)


def bench_of(settings: StudySettings) -> Bench:
    """`evaluation.timed_frames` test frames of the study's data set, which need not have been simulated.

    Raises
    ------
    ValueError
        When a mesh cannot be used or no pose.
    """
    scene, grid = build_scene(settings)
    folder = dataset_folder(settings)
    known = open_data(folder).pairs if (folder / "about.json").exists() else lay_out(settings, scene, grid)
    frames = equally_spaced(np.flatnonzero(known.split == Part.test), settings.evaluation.timed_frames)
    seed = settings.dataset.seed
    return Bench(scene, settings.probe, settings.simulator, frames, known.poses[frames], seed)


def shoot(
    bench: Bench, several: Sequence[SimulatorSettings], seeds: Sequence[int], advance: Callable[[], object]
) -> list[tuple[list[Shots], float]]:
    """Render all poses with each setting and each seed of the scatterers.

    A machine is now faster and now slower, for seconds: settings take turns, a few poses each, and every other time in
    the reverse order.

    Parameters
    ----------
    bench : Bench
    several : sequence of SimulatorSettings
    seeds : sequence of int
        The first is timed; the others reuse its rays.
    advance : callable
        Called after each pose of each setting.

    Returns
    -------
    list of (list of Shots, float), one a setting
        Shots, one a seed; median milliseconds of an image, each pose seen for the first time, after one that does not
        count; without segmentation and attenuation, which an image does not need, and with the receiver's noise at
        hand, as it is in a series of frames.
    """
    simulators = [Simulator(bench.scene, bench.probe, settings, poses=bench.poses) for settings in several]
    rows: list[list[list[Shown]]] = [[] for _ in several]
    times: list[list[float]] = [[] for _ in several]
    turns = list(range(len(several)))
    for begin in range(0, len(bench.poses), _TURN):
        for k in turns:
            simulator = simulators[k]
            simulator.render(_nudged(bench.poses[begin]), seeds[0])
            for pose in bench.poses[begin : begin + _TURN]:
                simulator.maps(pose)
                start = time.perf_counter()
                first = simulator.render(pose, seeds[0])
                times[k].append(1e3 * (time.perf_counter() - start))
                rows[k].append([_shown(first), *(_shown(simulator.render(pose, seed)) for seed in seeds[1:])])
                if len(seeds) > 1:
                    simulator.render(pose, seeds[0])  # a simulator remembers the noise of its last seed
                advance()
        turns.reverse()
    return [([_shots(column) for column in zip(*r, strict=True)], median(t)) for r, t in zip(rows, times, strict=True)]


def _shown(frame: Frame) -> Shown:
    """What errors need; the maps of all settings at once would be gigabytes."""
    return frame.image, frame.envelope


def _shots(shown: Sequence[Shown]) -> Shots:
    images, envelopes = zip(*shown, strict=True)
    return Shots(np.stack(images), np.stack(envelopes))


def time_stages(bench: Bench, settings: SimulatorSettings, advance: Callable[[], object]) -> dict[str, float]:
    """Median milliseconds of every stage of an image, in the order they run, what is left as `everything else`."""
    simulator = Simulator(bench.scene, bench.probe, settings, poses=bench.poses)
    simulator.render(_nudged(bench.poses[0]), bench.seed)
    whole, each = [], []
    for pose in bench.poses:
        simulator.maps(pose)
        with stage_times() as taken:
            start = time.perf_counter()
            simulator.render(pose, bench.seed)
            whole.append(1e3 * (time.perf_counter() - start))
        each.append([sum(taken[name]) for name, *_ in STAGES])
        advance()
    columns = zip(STAGES, zip(*each, strict=True), strict=True)
    stages = {name: median(column) for (name, *_), column in columns if any(column)}
    return stages | {"everything else": median(np.subtract(whole, np.sum(each, axis=1)).tolist())}


def make_inputs(bench: Bench, advance: Callable[[], object]) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """What generators read, and the time that it takes to make.

    Segmentation and attenuation come from one call of `Simulator.maps`; a generator that reads no attenuation is
    charged for the labels of the pixels alone.

    Returns
    -------
    maps : dict of (n, H, W)
        `segmentation` uint8, `attenuation` float32 in [0, 1], `low` uint8.
    ms : dict of str to float
        Median milliseconds of each.
    """
    maps = Simulator(bench.scene, bench.probe, bench.simulator, poses=bench.poses)
    low = Simulator(bench.scene, bench.probe, replace(bench.simulator, rays=1, layers=1), poses=bench.poses)
    maps.maps(_nudged(bench.poses[0]))
    low.render(_nudged(bench.poses[0]), bench.seed)
    rows, made = [], []
    for pose in bench.poses:
        with stage_times() as taken:
            start = time.perf_counter()
            segmentation, attenuation = maps.maps(pose)
            both = 1e3 * (time.perf_counter() - start)
        labels = sum(taken["labels of the pixels"])
        low.maps(pose)  # now remembered: what follows is the image alone
        start = time.perf_counter()
        image = low.render(pose, bench.seed).image
        rows.append((labels, both - labels, 1e3 * (time.perf_counter() - start)))
        made.append((segmentation, attenuation, image))
        advance()
    names = ("segmentation", "attenuation", "low")
    arrays = {name: np.stack(c) for name, c in zip(names, zip(*made, strict=True), strict=True)}
    return arrays, {name: median(c) for name, c in zip(names, zip(*rows, strict=True), strict=True)}


def _nudged(pose: np.ndarray) -> np.ndarray:
    moved = pose.copy()
    moved[2, 3] += _NUDGE_MM
    return moved
