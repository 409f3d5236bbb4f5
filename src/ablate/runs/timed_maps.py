"""The inputs of generators made at a pose, and what each of them costs."""

import time
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from ablate.anatomy import Scene
from ablate.ultrasound import Probe, Simulator, SimulatorSettings, compensated_attenuation
from ablate.ultrasound.stages import Stage, stage_times

_NUDGE_MM = 1e-3


class TimedMaps:
    """Makes the maps that generators read and measures each; without `low` the low-quality image is left out.

    The inputs are `segmentation`, uint8, `attenuation` and `compensated`, float32 in [0, 1], and `low`, uint8.
    The first two come from one call of `Simulator.maps`, whose part for the attenuation counts for `compensated` too.
    For a generator that reads no attenuation only the labels of the pixels count.
    """

    def __init__(
        self, scene: Scene, probe: Probe, settings: SimulatorSettings, poses: Iterable[np.ndarray], low: bool
    ) -> None:
        poses = list(poses)
        self._probe, self._settings = probe, settings
        self._maps = Simulator(scene, probe, settings, poses=poses)
        self._low = Simulator(scene, probe, replace(settings, rays=1, layers=1), poses=poses) if low else None

    def __call__(self, pose: np.ndarray, seed: int) -> tuple[dict[str, np.ndarray], dict[str, float]]:
        """The maps, (H, W) each, of a pose that was not the last one, and the milliseconds of each, both by name."""
        with stage_times() as taken:
            start = time.perf_counter()
            segmentation, attenuation = self._maps.maps(pose)
            both = _milliseconds_since(start)
        labels = sum(taken[Stage.pixel_labels])
        start = time.perf_counter()
        compensated = compensated_attenuation(attenuation, self._probe, self._settings.tgc_db_cm_mhz)
        more = _milliseconds_since(start)
        made = {"segmentation": segmentation, "attenuation": attenuation, "compensated": compensated}
        times = {"segmentation": labels, "attenuation": both - labels, "compensated": both - labels + more}
        if self._low is not None:
            start = time.perf_counter()
            made["low"] = self._low.image(pose, seed)
            times["low"] = _milliseconds_since(start)
        return made, times


def nudged(pose: np.ndarray, times: int = 1) -> np.ndarray:
    """Another pose, some micrometres away, because a simulator keeps the results of its last one."""
    moved = pose.copy()
    moved[2, 3] += times * _NUDGE_MM
    return moved


def _milliseconds_since(start: float) -> float:
    return 1e3 * (time.perf_counter() - start)
