"""The inputs of generators made at a pose, and what each of them costs."""

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ablate.anatomy import Scene
from ablate.ultrasound import Probe, Simulator, SimulatorSettings, compensated_attenuation
from ablate.ultrasound.stages import Stage, stage_times

_NUDGE_MM = 1e-3


def timed_maps(
    scene: Scene, probe: Probe, settings: SimulatorSettings, poses: np.ndarray, low: bool
) -> Callable[[np.ndarray, int], tuple[dict[str, np.ndarray], dict[str, float]]]:
    """A function of a pose that was not the last one, and a seed: the maps, (H, W), and the milliseconds of each.

    They are the maps that generators read, by name; without `low` the low-quality image is left out.
    The inputs are `segmentation`, uint8, `attenuation` and `compensated`, float32 in [0, 1], and `low`, uint8.
    The first two come from one call of `Simulator.maps`, whose part for the attenuation counts for `compensated` too.
    For a generator that reads no attenuation only the labels of the pixels count.
    """
    simulator = Simulator(scene, probe, settings, poses=poses)
    of_low = Simulator(scene, probe, replace(settings, rays=1, layers=1), poses=poses) if low else None

    def make(pose: np.ndarray, seed: int) -> tuple[dict[str, np.ndarray], dict[str, float]]:
        with stage_times() as taken:
            start = time.perf_counter()
            segmentation, attenuation = simulator.maps(pose)
            both = _milliseconds_since(start)
        labels = sum(taken[Stage.pixel_labels])
        start = time.perf_counter()
        compensated = compensated_attenuation(attenuation, probe, settings.time_gain)
        more = _milliseconds_since(start)
        made = {"segmentation": segmentation, "attenuation": attenuation, "compensated": compensated}
        times = {"segmentation": labels, "attenuation": both - labels, "compensated": both - labels + more}
        if of_low is not None:
            start = time.perf_counter()
            made["low"] = of_low.image(pose, seed)
            times["low"] = _milliseconds_since(start)
        return made, times

    return make


def nudged(pose: np.ndarray, times: int = 1) -> np.ndarray:
    """Another pose, some micrometres away, because a simulator keeps the results of its last one."""
    moved = pose.copy()
    moved[2, 3] += times * _NUDGE_MM
    return moved


def _milliseconds_since(start: float) -> float:
    return 1e3 * (time.perf_counter() - start)
