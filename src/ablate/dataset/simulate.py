"""From a scene and a pose to the maps of one frame, in as many processes as there are cores."""

from __future__ import annotations

import multiprocessing
import queue
import signal
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from multiprocessing.synchronize import Event

import numpy as np

from ablate.anatomy import Scene
from ablate.dataset.filling import MakeFrames, fill_pairs, unclaimed
from ablate.dataset.pairs import Pairs
from ablate.dataset.processes import allotted_cores, end_with_parent, interrupts_blocked
from ablate.dataset.split import Part, resimulation_seed
from ablate.ultrasound import Probe, Simulator, SimulatorSettings

Progress = Callable[[int], object]
_WAIT_S = 1.0


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
        out = {m: np.zeros((len(frames), *pairs.shape), np.float32 if m == "attenuation" else np.uint8) for m in maps}
        for k, frame in enumerate(frames):
            pose = pairs.poses[frame]
            made: dict[str, np.ndarray] = {}
            if "target" in maps:
                shown = simulator(of_target).render(pose, seed=recipe.seed)
                made |= {"target": shown.image, "segmentation": shown.segmentation, "attenuation": shown.attenuation}
            elif maps & {"segmentation", "attenuation"}:
                made["segmentation"], made["attenuation"] = simulator(of_target).maps(pose)
            if "resimulation" in maps and pairs.split[frame] != Part.train:
                made["resimulation"] = simulator(again).image(pose, seed=resimulation_seed(recipe.seed))
            if "low" in maps:
                made["low"] = simulator(of_low).image(pose, seed=recipe.seed)
            for name in made.keys() & maps:
                out[name][k] = made[name]
        return out

    return render


def simulate_pairs(
    recipe: Recipe, pairs: Pairs, maps: frozenset[str], workers: int = 0, progress: Progress = lambda _: None
) -> int:
    """Fill what is missing of a data set and return the number of frames that this call made.

    Shards that another process makes meanwhile are waited for. There are `workers` processes, one a core if it is 0.
    An OSError when a shard cannot be written, as on a full disk; a RuntimeError when a worker process dies.
    """
    made = 0

    def count(frames: int) -> None:
        nonlocal made
        made += frames
        progress(frames)

    while pairs.missing(maps):
        wanted = min(workers or allotted_cores(), len(unclaimed(pairs, maps)))
        if wanted > 1:
            _fill_in_processes(recipe, pairs, maps, wanted, count)
        elif wanted == 1:
            for frames in fill_pairs(pairs, maps, frame_simulator(recipe, pairs)):
                count(frames)
        else:
            time.sleep(_WAIT_S)  # other processes make all that is missing
    return made


def _fill_in_processes(recipe: Recipe, pairs: Pairs, maps: frozenset[str], workers: int, count: Progress) -> None:
    context = multiprocessing.get_context("spawn")
    done: multiprocessing.Queue[int | OSError] = context.Queue()
    stop = context.Event()
    arguments = recipe, pairs, maps, done, stop
    processes = [context.Process(target=_work, args=arguments, daemon=True) for _ in range(workers)]
    try:
        with interrupts_blocked():  # Ctrl-C reaches every process of a terminal; the parent ends its workers
            for process in processes:
                process.start()
        while any(p.is_alive() for p in processes) or not done.empty():
            try:
                told = done.get(timeout=0.2)
            except queue.Empty:
                _raise_for([p.exitcode for p in processes])
                continue
            if isinstance(told, OSError):
                raise told
            count(told)
        _raise_for([p.exitcode for p in processes])
    except KeyboardInterrupt:
        for process in (p for p in processes if p.is_alive()):
            process.terminate()
        raise
    finally:
        stop.set()  # where one has failed, the others finish the shard they are at
        for process in processes:
            if process.pid is not None:
                process.join()


def _raise_for(codes: list[int | None]) -> None:
    for code in codes:
        if code and code < 0:
            killed = f"a simulation process was ended by {signal.Signals(-code).name}"
            raise RuntimeError(f"{killed}; SIGKILL is often the system's, out of memory: try fewer dataset.workers")
        if code:
            raise RuntimeError(f"a simulation process ended with code {code}; its error is printed above")


def _work(
    recipe: Recipe, pairs: Pairs, maps: frozenset[str], done: multiprocessing.Queue[int | OSError], stop: Event
) -> None:
    import torch

    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))  # what is half-written is removed
    end_with_parent()
    torch.set_num_threads(1)
    try:
        for frames in fill_pairs(pairs, maps, frame_simulator(recipe, pairs)):
            done.put(frames)
            if stop.is_set():
                return
    except OSError as error:
        done.put(error)
