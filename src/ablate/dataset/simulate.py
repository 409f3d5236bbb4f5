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
from ablate.networks.spec import OF_SURFACES, Space
from ablate.ultrasound import Probe, Simulator, SimulatorSettings
from ablate.ultrasound.stages import Stage, stage_times

Timed = tuple[dict[str, np.ndarray], dict[str, float]]  # maps, and the milliseconds of each
_NUDGE_MM = 1e-3
_OF_LABELS = (Stage.pixel_labels, Stage.attenuation_labels, Stage.attenuation_sum, Stage.scan_conversion)
_WITHOUT_IMAGE = frozenset({"segmentation", "attenuation"}) | OF_SURFACES  # maps without an image


@dataclass(frozen=True)
class Recipe:
    """What every frame of a data set is made with.

    `settings` are those of the target; the low-quality image L differs in rays and layers alone. `seed` is that of the
    scatterers, one for an anatomy, because speckle belongs to the world.
    """

    scene: Scene
    probe: Probe
    settings: SimulatorSettings
    seed: int = 0


def frame_simulator(recipe: Recipe, pairs: Pairs) -> MakeFrames:
    """A function that renders the wanted maps of some frames of a data set, for `fill_pairs`."""
    of_target, of_low = recipe.settings, replace(recipe.settings, rays=1, layers=1)
    again = replace(recipe.settings, path_seed=resimulation_seed(recipe.settings.path_seed))

    @cache
    def simulator(settings: SimulatorSettings) -> Simulator:
        return Simulator(recipe.scene, recipe.probe, settings, poses=pairs.poses)

    def render(frames: np.ndarray, maps: frozenset[str]) -> Mapping[str, np.ndarray]:
        out: dict[str, np.ndarray] = {}
        for k, frame in enumerate(frames):
            pose = pairs.poses[frame]
            made: dict[str, np.ndarray] = {}
            if maps & _WITHOUT_IMAGE:
                beam = simulator(of_target).beam_maps(pose, bool(maps & OF_SURFACES))
                made = {name: getattr(beam, name) for name in _WITHOUT_IMAGE & maps}
            if "target" in maps:
                made["target"] = simulator(of_target).beam_image(pose, seed=recipe.seed)
            if "resimulation" in maps and pairs.split[frame] != Part.train:
                made["resimulation"] = simulator(again).beam_image(pose, seed=resimulation_seed(recipe.seed))
            if "low" in maps:
                made["low"] = simulator(of_low).beam_image(pose, seed=recipe.seed)
            for name, value in made.items():
                out.setdefault(name, np.zeros((len(frames), *value.shape), value.dtype))[k] = value
        return out | {name: np.zeros((len(frames), *pairs.stored_shape), np.uint8) for name in maps - out.keys()}

    return render


def simulate_pairs(recipe: Recipe, pairs: Pairs, maps: frozenset[str], workers: int = 0) -> int:
    """Fill what is missing of a data set and return the number of frames that this call made.

    Shards that another process makes meanwhile are waited for. There are `workers` processes, one a core if it is 0.
    An OSError when a shard cannot be written, as on a full disk; a RuntimeError when a worker process dies.
    """

    def fill() -> Iterator[int]:
        wanted = min(workers or allotted_cores(), unclaimed(pairs, maps))
        if wanted > 1:
            yield from _fill_in_processes(recipe, pairs, maps, wanted)
        elif wanted == 1:
            yield from fill_pairs(pairs, maps, frame_simulator(recipe, pairs))

    return fill_all(pairs, maps, "simulate", fill)


def _fill_in_processes(recipe: Recipe, pairs: Pairs, maps: frozenset[str], workers: int) -> Iterator[int]:
    context = multiprocessing.get_context("spawn")
    told: multiprocessing.Queue[int | OSError] = context.Queue()
    arguments = recipe, pairs, maps, told
    processes = [context.Process(target=_work, args=arguments, daemon=True) for _ in range(workers)]
    try:
        with interrupts_blocked():  # Ctrl-C reaches every process of a terminal; the parent ends its workers
            for process in processes:
                process.start()
        alive = True
        while alive or not told.empty():
            alive = any(process.is_alive() for process in processes)
            with suppress(queue.Empty):
                made = told.get(timeout=0.2)
                if isinstance(made, OSError):
                    raise made
                yield made
            for code in (process.exitcode for process in processes if process.exitcode):
                ended = f"ended with code {code}; its error is printed above"
                if code < 0:
                    often = "SIGKILL is often the system's, out of memory: try fewer dataset.workers"
                    ended = f"was ended by {signal.Signals(-code).name}; {often}"
                raise RuntimeError(f"a simulation process {ended}")
    finally:
        for process in processes:
            if process.pid is not None:
                process.terminate()
                process.join()


def _work(recipe: Recipe, pairs: Pairs, maps: frozenset[str], told: multiprocessing.Queue[int | OSError]) -> None:
    import torch

    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))  # what is half-written is removed
    end_with_parent()
    torch.set_num_threads(1)
    try:
        for frames in fill_pairs(pairs, maps, frame_simulator(recipe, pairs)):
            told.put(frames)
    except OSError as error:
        told.put(error)


def timed_maps(scene: Scene, probe: Probe, settings: SimulatorSettings, poses: np.ndarray) -> Callable[..., Timed]:
    """A function of a pose that was not the last one, a seed, names and a space: maps, and the milliseconds of each.

    They are the maps of these names, (H, W) or (rows, scanlines), as `maps_read` gives them, and `low`, uint8. Labels
    and interfaces have the time of their stages, or their share where some ran side by side, and other maps the rest.
    """
    simulator = Simulator(scene, probe, settings, poses=poses)
    of_low = cache(lambda: Simulator(scene, probe, replace(settings, rays=1, layers=1), poses=poses))
    nothing = np.zeros(settings.image_shape, np.uint8)

    def make(pose: np.ndarray, seed: int, names: Sequence[str], space: Space) -> Timed:
        with stage_times() as taken:
            start = time.perf_counter()
            beam = simulator.beam_maps(pose, bool(OF_SURFACES & set(names)))
            shown = simulator.maps(pose) if space is Space.image else (nothing, nothing)
            made = maps_read(names, space, (*shown, beam), probe, settings.time_gain)
            ms = 1e3 * (time.perf_counter() - start)
        own = {
            "segmentation": taken[Stage.pixel_labels if space is Space.image else Stage.attenuation_labels],
            "interfaces": [ms for each in Stage if each not in _OF_LABELS for ms in taken[each]],
        }
        at_once = max(1.0, sum(map(sum, taken.values())) / ms)
        times = {name: sum(own[name]) / at_once for name in own if name in names}
        rest = next((name for name in ("attenuation", "compensated", "illumination") if name in names), "")
        if rest:
            times[rest] = ms - sum(times.values())
        if "low" in names:
            simulate = of_low()
            start = time.perf_counter()
            made["low"] = simulate.image(pose, seed) if space is Space.image else simulate.beam_image(pose, seed)
            times["low"] = 1e3 * (time.perf_counter() - start)
        return made, times

    return make


def nudged(pose: np.ndarray, times: int = 1) -> np.ndarray:
    """Another pose, some micrometres away, because a simulator keeps the results of its last one."""
    moved = pose.copy()
    moved[2, 3] += times * _NUDGE_MM
    return moved
