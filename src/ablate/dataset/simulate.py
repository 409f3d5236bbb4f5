"""From a scene and a pose to the maps of a frame: timed, or for a data set in as many processes as there are cores."""

from __future__ import annotations

import multiprocessing
import queue
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from ablate.anatomy import Scene
from ablate.dataset.filling import MakeFrames, fill_all, fill_pairs, unclaimed
from ablate.dataset.frame_maps import maps_read
from ablate.dataset.pairs import Pairs
from ablate.dataset.processes import allotted_cores, end_with_parent, interrupts_blocked
from ablate.dataset.split import Part, resimulation_seed
from ablate.networks.spec import COMPOUND, GRAIN, OF_SURFACES, Space
from ablate.ultrasound import OwnSimulatorError, Probe, Simulator, SimulatorSettings, simulators_of
from ablate.ultrasound.stages import Stage, stage_times
from ablate.user_code import code_digest

Timed = tuple[dict[str, np.ndarray], dict[str, float]]  # maps, and the milliseconds of each
_Result = int | OSError | OwnSimulatorError  # frames that a process has made, or what stopped it
_NUDGE_MM = 1e-3
# Stages that make no map of the surfaces.
_OF_OTHERS = (
    Stage.pixel_labels,
    Stage.attenuation_labels,
    Stage.attenuation_sum,
    Stage.grain,
    Stage.scan_conversion,
)
_WITHOUT_IMAGE = frozenset({"segmentation", "attenuation", COMPOUND}) | OF_SURFACES  # maps without an image


@dataclass(frozen=True)
class Recipe:
    """What every frame of a data set is made with.

    `settings` are those of the target; the low-quality image L differs in rays, layers and angles alone. `seed` is that
    of the scatterers, one for an anatomy, because speckle belongs to the world. `target` is the dotted path of a
    simulator of the user's own, and `source` the digest of its code.
    """

    scene: Scene
    probe: Probe
    settings: SimulatorSettings
    seed: int = 0
    target: str | None = None
    source: str | None = None


def of_low(settings: SimulatorSettings) -> SimulatorSettings:
    """Settings of the low-quality image L beside frames of some settings."""
    return replace(settings, rays=1, layers=1, compound_angles=1)


def frame_simulator(recipe: Recipe, pairs: Pairs) -> MakeFrames:
    """A function that renders the wanted maps of some frames of a data set, for `fill_pairs`.

    It raises an OwnSimulatorError, which names the frame, where a simulator of the user's own fails.
    """
    target_settings = recipe.settings
    again = replace(recipe.settings, path_seed=resimulation_seed(recipe.settings.path_seed))
    make = simulators_of(recipe.target)
    if recipe.target is not None and code_digest(recipe.target) != recipe.source:
        raise OwnSimulatorError(f"scene.target={recipe.target}: edited since the command began; repeat the command")

    @cache
    def simulator(settings: SimulatorSettings) -> Simulator:
        return make(recipe.scene, recipe.probe, settings, poses=pairs.poses)

    def maps_of(frame: int, maps: frozenset[str]) -> dict[str, np.ndarray]:
        pose = pairs.poses[frame]
        rendered: dict[str, np.ndarray] = {}
        if maps & _WITHOUT_IMAGE:
            beam = simulator(target_settings).beam_maps(pose, bool(maps & OF_SURFACES), COMPOUND in maps)
            rendered = {name: getattr(beam, name) for name in _WITHOUT_IMAGE & maps}
        if "target" in maps:
            rendered["target"] = simulator(target_settings).beam_image(pose, seed=recipe.seed)
        if "resimulation" in maps and pairs.split[frame] != Part.train:
            rendered["resimulation"] = simulator(again).beam_image(pose, seed=resimulation_seed(recipe.seed))
        if "low" in maps:
            rendered["low"] = simulator(of_low(target_settings)).beam_image(pose, seed=recipe.seed)
        return rendered

    def render(frames: np.ndarray, maps: frozenset[str]) -> Mapping[str, np.ndarray]:
        stacks: dict[str, np.ndarray] = {}
        for place, frame in enumerate(frames):
            try:
                rendered = maps_of(frame, maps)
            except OwnSimulatorError as error:
                raise OwnSimulatorError(f"{pairs.folder.name}, frame {frame}: {error}") from error
            for name, values in rendered.items():
                if name not in stacks:
                    stacks[name] = np.zeros((len(frames), *values.shape), values.dtype)
                stacks[name][place] = values
        black = np.zeros((len(frames), *pairs.stored_shape), np.uint8)
        return stacks | dict.fromkeys(maps - stacks.keys(), black)

    return render


def simulate_pairs(recipe: Recipe, pairs: Pairs, maps: frozenset[str], workers: int = 0, what: str = "simulate") -> int:
    """Fill what is missing of a data set; shards that another process makes meanwhile are waited for.

    Parameters
    ----------
    recipe : Recipe
        What every frame is made with.
    pairs : Pairs
        The data set.
    maps : frozenset of str
        Those that are wanted.
    workers : int
        How many processes make them; 0 is one a core.
    what : str
        Stands before the count of frames that are done.

    Returns
    -------
    int
        How many frames this call made.

    Raises
    ------
    OSError
        When a shard cannot be written, as on a full disk.
    OwnSimulatorError
        When a simulator of the user's own fails; the message names the frame.
    RuntimeError
        When a worker process dies.
    """

    def fill() -> Iterator[int]:
        wanted = min(workers or allotted_cores(), unclaimed(pairs, maps))
        if wanted > 1:
            yield from _fill_in_processes(recipe, pairs, maps, wanted)
        elif wanted == 1:
            yield from fill_pairs(pairs, maps, frame_simulator(recipe, pairs))

    return fill_all(pairs, maps, what, fill)


def _fill_in_processes(recipe: Recipe, pairs: Pairs, maps: frozenset[str], workers: int) -> Iterator[int]:
    context = multiprocessing.get_context("spawn")
    results: multiprocessing.Queue[_Result] = context.Queue()
    arguments = (recipe, pairs, maps, results)
    processes = [context.Process(target=_work, args=arguments, daemon=True) for _ in range(workers)]
    try:
        with interrupts_blocked():  # Ctrl-C reaches every process of a terminal; the parent ends its workers
            for process in processes:
                process.start()
        alive = True
        while alive or not results.empty():
            alive = any(process.is_alive() for process in processes)
            with suppress(queue.Empty):
                frames = results.get(timeout=0.2)
                if not isinstance(frames, int):
                    raise frames
                yield frames
            for process in processes:
                if process.exitcode:
                    raise RuntimeError(f"a simulation process {_ended(process.exitcode)}")
    finally:
        for process in processes:
            if process.pid is not None:
                process.terminate()
                process.join()


def _ended(code: int) -> str:
    """How a process ended, from its exit code."""
    if code > 0:
        return f"ended with code {code}; its error is printed above"
    often = "SIGKILL is often the system's, out of memory: try fewer dataset.workers"
    return f"was ended by {signal.Signals(-code).name}; {often}"


def _work(recipe: Recipe, pairs: Pairs, maps: frozenset[str], results: multiprocessing.Queue[_Result]) -> None:
    import torch

    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))  # what is half-written is removed
    end_with_parent()
    torch.set_num_threads(1)
    try:
        for frames in fill_pairs(pairs, maps, frame_simulator(recipe, pairs)):
            results.put(frames)
    except (OSError, OwnSimulatorError) as error:
        results.put(error)


def timed_maps(
    scene: Scene, probe: Probe, settings: SimulatorSettings, poses: np.ndarray, target: str | None = None
) -> Callable[[np.ndarray, int, Sequence[str], Space], Timed]:
    """A function that makes the maps of a frame and measures how long each takes.

    Parameters
    ----------
    scene : Scene
        What is simulated.
    probe : Probe
    settings : SimulatorSettings
        Those of the target; the low-quality image has those of `of_low`.
    poses : (n, 4, 4) float, mm
        Those that may be asked for, probe to world; they decide what of the scene is needed.
    target : str, optional
        Dotted path of a simulator of the user's own.

    Returns
    -------
    callable
        Given a pose that was not the last one, the seed of the scatterers, names and a space, it gives the maps of
        these names, (H, W) or (rows, scanlines), as `maps_read` does, and `low`, uint8; and the milliseconds of each.
        Labels and interfaces have the time of their stages, or their share where some ran side by side, and other maps
        the rest.
    """
    simulator = Simulator(scene, probe, settings, poses=poses)
    simulator_of_low = cache(lambda: simulators_of(target)(scene, probe, of_low(settings), poses=poses))
    nothing = np.zeros(settings.image_shape, np.uint8)

    def make(pose: np.ndarray, seed: int, names: Sequence[str], space: Space) -> Timed:
        in_image_space = space is Space.image
        with stage_times() as stages:
            start = time.perf_counter()
            beam = simulator.beam_maps(pose, bool(OF_SURFACES & set(names)), COMPOUND in names)
            if GRAIN in names:
                beam = replace(beam, grain=simulator.grain(pose, seed))
            segmentation, attenuation = simulator.maps(pose) if in_image_space else (nothing, nothing)
            maps = maps_read(names, space, (segmentation, attenuation, beam), probe, settings.time_gain)
            whole_ms = 1e3 * (time.perf_counter() - start)
        times = _shares(stages, whole_ms, names, space)
        if "low" in names:
            low = simulator_of_low()
            start = time.perf_counter()
            maps["low"] = low.image(pose, seed) if in_image_space else low.beam_image(pose, seed)
            times["low"] = 1e3 * (time.perf_counter() - start)
        return maps, times

    return make


def _shares(
    stages: Mapping[str, Sequence[float]], whole_ms: float, names: Sequence[str], space: Space
) -> dict[str, float]:
    """The milliseconds of each map but `low`, from those of the stages that made them."""
    label_stage = Stage.pixel_labels if space is Space.image else Stage.attenuation_labels
    stages_of_maps = {
        "segmentation": sum(stages[label_stage]),
        "interfaces": sum(ms for stage in Stage if stage not in _OF_OTHERS for ms in stages[stage]),
        GRAIN: sum(stages[Stage.grain]),
    }
    at_once = max(1.0, sum(map(sum, stages.values())) / whole_ms)
    times = {name: ms / at_once for name, ms in stages_of_maps.items() if name in names}
    for name in ("attenuation", "compensated", "illumination", COMPOUND):
        if name in names:
            times[name] = whole_ms - sum(times.values())
            break
    return times


def nudged(pose: np.ndarray, times: int = 1) -> np.ndarray:
    """Another pose, some micrometres away, because a simulator keeps the results of its last one."""
    moved = pose.copy()
    moved[2, 3] += times * _NUDGE_MM
    return moved
