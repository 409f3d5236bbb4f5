"""From a state to its views: the simulator, then the generators, one after the other."""

import time
import warnings
from collections.abc import Callable, Hashable
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import numpy as np

from ablate.anatomy import Scene
from ablate.networks.spec import OF_SURFACES, Space
from ablate.ultrasound import Display, Probe, Simulator, SimulatorSettings, TimeGain, fan_mask, with_patient_gain
from ablate.ultrasound.probe import pixel_polar
from ablate.viewer.generators import Trained, open_generator, trained_at
from ablate.viewer.session import Moving, Quality, State, Views

_COARSE_RAYS = 4
_KEPT_SIMULATORS = 8  # full, coarse and low quality, and of coarse maps, of this probe and the one before


def coarse(settings: SimulatorSettings) -> SimulatorSettings:
    """Settings for a moving probe: one layer, few rays, every second scanline. Scatterers stay where they are."""
    return replace(settings, rays=min(settings.rays, _COARSE_RAYS), layers=1, scanlines=-(-settings.scanlines // 2))


class Engine:
    """Renders the views of a scene. The triangles are given to Embree once, whatever the probe.

    Only one thread may use it at a time. The last few simulators and generators are kept. The time gain of
    `tgc=patient` is set for `training_poses`, (n, 4, 4), and for each probe anew.
    """

    def __init__(self, scene: Scene, training_poses: np.ndarray) -> None:
        self.scene = scene
        patient = partial(with_patient_gain, settings=SimulatorSettings(tgc=TimeGain.patient), poses=training_poses)
        self._patient_gain = lru_cache(_KEPT_SIMULATORS)(lambda probe: patient(scene, probe, beside=self._first))
        self._first: Simulator | None = None
        self._simulator = lru_cache(_KEPT_SIMULATORS)(self._new_simulator)
        self._generator = lru_cache(4)(lambda folder, _: open_generator(folder, scene.tissues))
        self._made: dict[str, tuple[Hashable, Any, float]] = {}

    def render(self, state: State, quality: Quality) -> Views:
        """Render all views of a state.

        At full quality the target is that of `Simulator.render`, and a generated image that of torch in fp32, bit for
        bit. While the probe moves, the maps of surfaces are of one layer. The notes say why a generator could not
        render. A pose that is not rigid, or a value outside its range, is a ValueError.
        """
        probe, settings, ms, notes = state.probe, state.simulator, dict[str, float](), dict[str, str]()
        moving = quality is Quality.coarse
        place = (state.pose.tobytes(), probe, settings)
        mask, depth = _fan(probe, settings.image_shape)
        mapped = self._simulator(probe, replace(settings, layers=1) if moving else settings)
        (segmentation, attenuation), ms["maps"] = self._once("maps", place, lambda: mapped.maps(state.pose))
        images: list[np.ndarray | None] = []
        for number, folder in enumerate(state.runs):
            name = f"generated {number}"
            try:
                trained, low = self._generator(folder, trained_at(folder)), None
                of_surfaces = bool(OF_SURFACES & set(trained.reads))
                if "low" in trained.reads:
                    simulator = self._simulator(probe, replace(settings, rays=1, layers=1))
                    make = simulator.image if trained.space is Space.image else simulator.beam_image
                    simulate = partial(_quietly, make, replace(state, display=None))
                    low, _ = self._once("low", (*place, state.seed, trained.space), simulate)

                def render(trained: Trained = trained, low: Any = low, of_surfaces: bool = of_surfaces) -> np.ndarray:
                    beam = mapped.beam_maps(state.pose, of_surfaces)
                    return trained.render((segmentation, attenuation, beam), low, mask, probe, state.seed, moving)

                image, ms[name] = self._once(f"{name}, {quality}", (trained, *place, state.seed), render)
                controls = None if state.display == Display() else state.display
                images.append(image if controls is None else controls.shown(image, depth, settings))
                notes[name], _ = self._once(f"{name}, note", (trained, *place[1:]), partial(trained.reservation, state))
            except (OSError, ValueError, KeyError) as error:
                images.append(None)
                notes[name] = " ".join(str(error).split())
        target = None
        if not moving or state.moving is Moving.both or not state.runs:
            settings = coarse(settings) if moving else settings
            key = (*place, settings, state.seed, state.display)
            simulate = partial(_quietly, self._simulator(probe, settings).image, state)
            target, ms["target"] = self._once("target", key, simulate)
        notes = {name: words for name, words in notes.items() if words}
        curve = mapped.settings.time_gain_db
        return Views(state, target, segmentation, attenuation, mask, tuple(images), ms, notes, quality, curve)

    def _once(self, name: str, key: Hashable, work: Callable[[], Any]) -> tuple[Any, float]:
        """The result of some work and its milliseconds, those of the last time where that had the same key."""
        if name not in self._made or self._made[name][0] != key:
            begun = time.perf_counter()
            self._made[name] = key, work(), 1e3 * (time.perf_counter() - begun)
        return self._made[name][1:]

    def _new_simulator(self, probe: Probe, settings: SimulatorSettings) -> Simulator:
        if settings.tgc is TimeGain.patient and settings.time_gain_db is None:
            gain = self._patient_gain(probe)  # tgc=fixed, where no tissue scatters
            settings = replace(settings, tgc=gain.tgc, time_gain_db=gain.time_gain_db)
        simulator = Simulator(self.scene, probe, settings, beside=self._first)
        self._first = self._first or simulator
        return simulator


@lru_cache(maxsize=4)
def _fan(probe: Probe, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Mask of the fan, (H, W) bool, and the depth of each pixel as a share of the imaging depth, (H, W)."""
    return fan_mask(probe, shape), pixel_polar(probe, shape)[0] / probe.depth_mm


def _quietly(make: Callable[..., np.ndarray], state: State) -> np.ndarray:
    """Make an image without the warning that the probe touches nothing, which the viewer says in its own words."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return make(state.pose, state.seed, state.display)
