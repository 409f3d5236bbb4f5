"""From a state to its views: the simulator, then the generators, one after the other."""

import time
import warnings
from collections.abc import Callable, Hashable
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from ablate.anatomy import Scene
from ablate.dataset.simulate import of_low
from ablate.networks.spec import COMPOUND, GRAIN, OF_SURFACES, Space
from ablate.ultrasound import (
    Display,
    Probe,
    Simulator,
    SimulatorSettings,
    TimeGain,
    fan_mask,
    grain,
    scan_converter,
    with_patient_gain,
)
from ablate.ultrasound.formula import Formula
from ablate.ultrasound.probe import pixel_polar
from ablate.viewer.generators import FORMULA, open_generator, trained_at
from ablate.viewer.session import Moving, Quality, ViewerState, Views

_COARSE_RAYS = 4
_KEPT_SIMULATORS = 8  # full, coarse and low quality, and of coarse maps, of this probe and the one before
_KEPT_GENERATORS = 4


def coarse(settings: SimulatorSettings) -> SimulatorSettings:
    """Settings for a moving probe: one layer and angle, few rays, every second scanline; scatterers stay in place."""
    lines, rays = -(-settings.scanlines // 2), min(settings.rays, _COARSE_RAYS)
    return replace(settings, rays=rays, layers=1, scanlines=lines, compound_angles=1)


class SceneRenderer:
    """Renders the views of a scene. The triangles are given to Embree once, whatever the probe.

    Only one thread may use it at a time. The last few simulators and generators are kept. The time gain of
    `tgc=patient` is set for `training_poses`, (n, 4, 4), and for each probe anew. A generator whose network is the
    user's own class is opened only if `custom` is its dotted path.
    """

    def __init__(self, scene: Scene, training_poses: np.ndarray, custom: str | None = None) -> None:
        self.scene = scene
        self._training_poses = training_poses
        self._first: Simulator | None = None
        self._patient_gain = lru_cache(_KEPT_SIMULATORS)(self._new_patient_gain)
        self._simulator = lru_cache(_KEPT_SIMULATORS)(self._new_simulator)
        self._generator = lru_cache(_KEPT_GENERATORS)(lambda run, _: open_generator(run, scene.tissues, custom))
        self._formula = lru_cache(_KEPT_SIMULATORS)(partial(Formula, scene.tissues))
        self._kept: dict[str, tuple[Hashable, Any, float]] = {}  # of each name the last key, what was made, and its ms

    def render(self, state: ViewerState, quality: Quality) -> Views:
        """Render all views of a state.

        At full quality the target is that of `Simulator.render`, and a generated image that of torch in fp32, bit for
        bit. While the probe moves, the maps of surfaces are of one layer. The notes say why a generator could not
        render. A pose that is not rigid, or a value outside its range, is a ValueError.
        """
        moves = quality is Quality.coarse
        settings = state.simulator
        simulator = self._simulator(state.probe, replace(settings, layers=1) if moves else settings)
        ms: dict[str, float] = {}
        notes: dict[str, str] = {}
        maps, ms["maps"] = self._once("maps", _place(state), lambda: simulator.maps(state.pose))
        images: list[np.ndarray | None] = []
        for number, run in enumerate(state.runs):
            name = f"generated {number}"
            try:
                image, ms[name], note = self._generated(name, run, state, quality, simulator, maps)
            except Exception as error:  # whatever somebody wrote into the files of a run; the simulated image goes on
                image, note = None, " ".join(str(error).split())
            images.append(image)
            if note:
                notes[name] = note
        target = None
        if not moves or state.moving is Moving.both or not state.runs:
            target, ms["target"] = self._target(state, quality)
        return Views(
            state=state,
            target=target,
            segmentation=maps[0],
            attenuation=maps[1],
            mask=_fan(state.probe, settings.image_shape)[0],
            generated=tuple(images),
            ms=ms,
            notes=notes,
            quality=quality,
            time_gain_db=simulator.settings.time_gain_db,
        )

    def _target(self, state: ViewerState, quality: Quality) -> tuple[np.ndarray, float]:
        """The simulated image, (H, W) uint8, and its milliseconds."""
        settings = coarse(state.simulator) if quality is Quality.coarse else state.simulator
        key = (*_place(state), settings, state.seed, state.display)
        make = self._simulator(state.probe, settings).image
        return self._once("target", key, lambda: _quietly(make, state))

    def _generated(
        self,
        name: str,
        run: Path,
        state: ViewerState,
        quality: Quality,
        simulator: Simulator,
        maps: tuple[np.ndarray, np.ndarray],
    ) -> tuple[np.ndarray, float, str]:
        """The image of a generator, (H, W) uint8, its milliseconds, and with what reservation it is shown."""
        mask, depth = _fan(state.probe, state.simulator.image_shape)
        if run == FORMULA:
            key = "formula", *_place(state), state.seed
            image, ms = self._once(name, key, lambda: self._in_closed_form(state, simulator))
            note = ""
        else:
            trained = self._generator(run, trained_at(run))
            low = self._low(state, trained.space) if "low" in trained.reads else None
            reads_surfaces = bool(OF_SURFACES & set(trained.reads))

            def render() -> np.ndarray:
                beam = simulator.beam_maps(state.pose, reads_surfaces, COMPOUND in trained.reads)
                if GRAIN in trained.reads:  # of all layers even while the probe moves, as the network was trained
                    beam = replace(beam, grain=self._grain(state))
                fast = quality is Quality.coarse
                return trained.render((*maps, beam), low, mask, state.probe, state.seed, fast)

            image, ms = self._once(f"{name}, {quality}", (trained, *_place(state), state.seed), render)
            reserved_for = trained, state.probe, state.simulator
            note, _ = self._once(f"{name}, note", reserved_for, lambda: trained.reservation(state))
        if state.display not in (None, Display()):
            image = state.display.shown(image, depth, state.simulator)
        return image, ms, note

    def _in_closed_form(self, state: ViewerState, simulator: Simulator) -> np.ndarray:
        """The image of the formula, (H, W) uint8."""
        beam = simulator.beam_maps(state.pose, of_surfaces=False)
        maps = {"segmentation": beam.segmentation, "attenuation": beam.attenuation, GRAIN: self._grain(state)}
        formula = self._formula(state.probe, simulator.settings)
        image = formula(formula.insonified(maps), state.seed)
        return scan_converter(state.probe, image.shape, state.simulator.image_shape).to_image(image)

    def _grain(self, state: ViewerState) -> np.ndarray:
        return grain(state.pose, state.probe, state.simulator, state.seed, self.scene.body)

    def _low(self, state: ViewerState, space: Space) -> np.ndarray:
        """The image of low quality in one space, as the simulator's settings display it."""
        simulator = self._simulator(state.probe, of_low(state.simulator))
        make = simulator.image if space is Space.image else simulator.beam_image
        as_set = replace(state, display=None)
        low, _ = self._once("low", (*_place(state), state.seed, space), lambda: _quietly(make, as_set))
        return low

    def _once(self, name: str, key: Hashable, work: Callable[[], Any]) -> tuple[Any, float]:
        """The result of some work and its milliseconds, those of the last time where that had the same key."""
        kept = self._kept.get(name)
        if kept is None or kept[0] != key:
            begun = time.perf_counter()
            result = work()
            kept = key, result, 1e3 * (time.perf_counter() - begun)
            self._kept[name] = kept
        return kept[1], kept[2]

    def _new_patient_gain(self, probe: Probe) -> SimulatorSettings:
        patient = SimulatorSettings(tgc=TimeGain.patient)
        return with_patient_gain(self.scene, probe, patient, self._training_poses, beside=self._first)

    def _new_simulator(self, probe: Probe, settings: SimulatorSettings) -> Simulator:
        if settings.tgc is TimeGain.patient and settings.time_gain_db is None:
            gain = self._patient_gain(probe)  # tgc=fixed, where no tissue scatters
            settings = replace(settings, tgc=gain.tgc, time_gain_db=gain.time_gain_db)
        simulator = Simulator(self.scene, probe, settings, beside=self._first)
        self._first = self._first or simulator
        return simulator


def _place(state: ViewerState) -> tuple[Hashable, ...]:
    """What decides the maps of a state."""
    return state.pose.tobytes(), state.probe, state.simulator


@lru_cache(maxsize=4)
def _fan(probe: Probe, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Mask of the fan, (H, W) bool, and the depth of each pixel as a share of the imaging depth, (H, W)."""
    return fan_mask(probe, shape), pixel_polar(probe, shape)[0] / probe.depth_mm


def _quietly(make: Callable[..., np.ndarray], state: ViewerState) -> np.ndarray:
    """Make an image without the warning that the probe touches nothing, which the viewer says in its own words."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return make(state.pose, state.seed, state.display)
