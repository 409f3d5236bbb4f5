"""From a scene and a pose to the maps of one frame, in as many processes as there are cores."""

from __future__ import annotations

import multiprocessing
import os
import queue
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ablate.anatomy import Scene
from ablate.dataset.pairs import Pairs, fill_pairs
from ablate.dataset.processes import end_with_parent
from ablate.dataset.split import Part
from ablate.ultrasound import ConvexProbe, Simulator, SimulatorSettings

Progress = Callable[[int], object]
_RESIMULATION = 1_000_003  # added to the scatterer seed


@dataclass(frozen=True)
class Recipe:
    """What every frame of a data set is made with.

    Attributes
    ----------
    scene : Scene
    probe : ConvexProbe
    settings : SimulatorSettings
        Of the high-quality image; the low-quality one differs in rays and layers alone.
    seed : int
        Of the scatterers: one an anatomy, because speckle belongs to the world.
    """

    scene: Scene
    probe: ConvexProbe
    settings: SimulatorSettings
    seed: int = 0


def renderer(recipe: Recipe, pairs: Pairs) -> Callable[[np.ndarray, frozenset[str]], Mapping[str, np.ndarray]]:
    """A function that renders the wanted maps of some frames of a data set, for `fill_pairs`."""
    high = Simulator(recipe.scene, recipe.probe, recipe.settings, poses=pairs.poses)
    low: list[Simulator] = []

    def render(frames: np.ndarray, maps: frozenset[str]) -> Mapping[str, np.ndarray]:
        out = {m: np.zeros((len(frames), *pairs.shape), np.float32 if m == "attenuation" else np.uint8) for m in maps}
        if "low" in maps and not low:
            settings = replace(recipe.settings, rays=1, layers=1)
            low.append(Simulator(recipe.scene, recipe.probe, settings, poses=pairs.poses))
        for k, frame in enumerate(frames):
            pose = pairs.poses[frame]
            if maps & {"high", "segmentation", "attenuation"}:
                shown = high.render(pose, seed=recipe.seed)
                for name, value in (
                    ("high", shown.image),
                    ("segmentation", shown.segmentation),
                    ("attenuation", shown.attenuation),
                ):
                    if name in maps:
                        out[name][k] = value
            if "high_again" in maps and pairs.split[frame] != Part.train:
                out["high_again"][k] = high.render(pose, seed=recipe.seed + _RESIMULATION).image
            if "low" in maps:
                out["low"][k] = low[0].render(pose, seed=recipe.seed).image
        return out

    return render


def simulate_pairs(
    recipe: Recipe, pairs: Pairs, maps: frozenset[str], workers: int = 0, progress: Progress | None = None
) -> int:
    """Fill what is missing of a data set and return when nothing is.

    Parameters
    ----------
    recipe : Recipe
    pairs : Pairs
    maps : frozenset of str
    workers : int
        Processes; 0 is one a core.
    progress : callable (frames made since the last call), optional

    Returns
    -------
    int
        Frames made by this call; shards that another process makes meanwhile are waited for.

    Raises
    ------
    RuntimeError
        When a worker process dies.
    """
    made = 0

    def count(frames: int) -> None:
        nonlocal made
        made += frames
        if progress is not None:
            progress(frames)

    while missing := pairs.missing(maps):
        wanted = min(workers or os.cpu_count() or 1, len(missing))
        before = made
        if wanted == 1:
            for frames in fill_pairs(pairs, maps, renderer(recipe, pairs)):
                count(frames)
        else:
            _fill_in_processes(recipe, pairs, maps, wanted, count)
        if made == before:
            time.sleep(1.0)  # all that is missing is in other hands
    return made


def _fill_in_processes(recipe: Recipe, pairs: Pairs, maps: frozenset[str], workers: int, count: Progress) -> None:
    context = multiprocessing.get_context("spawn")
    done = context.Queue()
    processes = [context.Process(target=_work, args=(recipe, pairs, maps, done), daemon=True) for _ in range(workers)]
    for process in processes:
        process.start()
    while any(p.is_alive() for p in processes) or not done.empty():
        try:
            count(done.get(timeout=0.2))
        except queue.Empty:
            failed = [p.exitcode for p in processes if p.exitcode]
            if failed:
                for p in processes:
                    p.terminate()
                raise RuntimeError(
                    f"a simulation process ended with code {failed[0]}; its error is printed above"
                ) from None
    for process in processes:
        process.join()


def _work(recipe: Recipe, pairs: Pairs, maps: frozenset[str], done: multiprocessing.Queue[int]) -> None:
    import torch

    end_with_parent()
    torch.set_num_threads(1)
    for frames in fill_pairs(pairs, maps, renderer(recipe, pairs)):
        done.put(frames)
