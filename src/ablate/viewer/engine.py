"""From a state to its views: the simulator, then the generators, one after the other."""

import time
import warnings
from collections.abc import Callable, Hashable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

import numpy as np

from ablate.anatomy import Scene
from ablate.ultrasound import Frame, Probe, Simulator, SimulatorSettings, fan_mask
from ablate.ultrasound.probe import pixel_polar
from ablate.viewer.generators import open_generator
from ablate.viewer.session import Moving, Quality, State, Views

T = TypeVar("T")

_COARSE_RAYS = 4
_KEPT_SIMULATORS = 6  # full, coarse and low quality, of this probe and the one before
_KEPT_GENERATORS = 4


def coarse(settings: SimulatorSettings) -> SimulatorSettings:
    """Settings for a moving probe: one layer, few rays, every second scanline. Scatterers stay where they are."""
    return replace(settings, rays=min(settings.rays, _COARSE_RAYS), layers=1, scanlines=-(-settings.scanlines // 2))


class Engine:
    """Renders the views of a scene. The triangles are given to Embree once, whatever the probe.

    Only one thread may use it at a time. The last few simulators and generators are kept.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._first: Simulator | None = None
        self._simulator = lru_cache(_KEPT_SIMULATORS)(self._new_simulator)
        self._generator = lru_cache(_KEPT_GENERATORS)(lambda folder: open_generator(folder, scene.tissues))
        self._took: dict[str, tuple[Hashable, float]] = {}
        self._images: dict[Path, tuple[Hashable, np.ndarray, float]] = {}

    def render(self, state: State, quality: Quality) -> Views:
        """Render all views of a state.

        At full quality the target is that of `Simulator.render`, bit for bit. The notes say why a generator could not
        render.

        Raises
        ------
        ValueError
            When the pose is not rigid, or a value is outside its range.
        """
        ms: dict[str, float] = {}
        notes: dict[str, str] = {}
        full = self._simulator(state.probe, state.simulator)
        place = (state.pose.tobytes(), state.probe, state.simulator)
        segmentation, attenuation = self._timed(ms, "maps", place, lambda: full.maps(state.pose))
        images = []
        for number, folder in enumerate(state.runs):
            name = f"generated {number}"
            try:
                image, ms[name], notes[name] = self._generated(folder, state, segmentation, attenuation)
            except (OSError, ValueError, KeyError) as error:
                image, notes[name] = None, " ".join(str(error).split())
            images.append(image)
        target = None
        if quality is Quality.full or state.moving is Moving.both or not state.runs:
            settings = state.simulator if quality is Quality.full else coarse(state.simulator)
            used = self._simulator(state.probe, settings)
            picture = (state.pose.tobytes(), state.probe, settings, state.seed, state.display)
            target = self._timed(ms, "target", picture, lambda: _quietly(used, state)).image
        return Views(
            target=target,
            segmentation=segmentation,
            attenuation=attenuation,
            mask=_fan(state.probe, state.simulator.image_shape)[0],
            generated=tuple(images),
            ms=ms,
            notes={name: words for name, words in notes.items() if words},
            quality=quality,
        )

    def _timed(self, ms: dict[str, float], name: str, key: Hashable, work: Callable[[], T]) -> T:
        """Do some work and note its milliseconds; if the same was asked for again, those of the first time."""
        begun = time.perf_counter()
        result = work()
        if name not in self._took or self._took[name][0] != key:
            self._took[name] = key, 1e3 * (time.perf_counter() - begun)
        ms[name] = self._took[name][1]
        return result

    def _new_simulator(self, probe: Probe, settings: SimulatorSettings) -> Simulator:
        simulator = Simulator(self.scene, probe, settings, beside=self._first)
        self._first = self._first or simulator
        return simulator

    def _generated(
        self, folder: Path, state: State, segmentation: np.ndarray, attenuation: np.ndarray
    ) -> tuple[np.ndarray, float, str]:
        """Image of a generator, its milliseconds and a reservation. A state at rest keeps the image it had moving."""
        trained = self._generator(folder)
        fan, depth = _fan(state.probe, state.simulator.image_shape)
        key = (state.pose.tobytes(), state.probe, state.simulator, state.seed)
        if folder not in self._images or self._images[folder][0] != key:
            maps = {"segmentation": segmentation, "attenuation": attenuation}
            if "low" in trained.reads:
                low = replace(state.simulator, rays=1, layers=1)
                maps["low"] = _quietly(self._simulator(state.probe, low), replace(state, display=None)).image
            begun = time.perf_counter()
            image = trained.render(maps, fan, state.probe, state.seed)
            self._images = {run: kept for run, kept in self._images.items() if run in state.runs}
            self._images[folder] = key, image, 1e3 * (time.perf_counter() - begun)
        _, image, ms = self._images[folder]
        if state.display is not None:
            image = state.display.shown(image, depth, state.simulator)
        return image, ms, trained.reservation(state)


@lru_cache(maxsize=4)
def _fan(probe: Probe, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Mask of the fan, (H, W) bool, and the depth of each pixel as a share of the imaging depth, (H, W)."""
    return fan_mask(probe, shape), pixel_polar(probe, shape)[0] / probe.depth_mm


def _quietly(simulator: Simulator, state: State) -> Frame:
    """Render a frame without the warning that the probe touches nothing, which the viewer says in its own words."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return simulator.render(state.pose, state.seed, state.display)
