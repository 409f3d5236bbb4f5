"""Observing a frame's stages changes nothing, accounts for the frame's time, and costs nothing when it is not used."""

import time
from collections.abc import Callable

import numpy as np
import pytest

from ablate.anatomy import Scene, Structure, Tissue
from ablate.ultrasound import Simulator, SimulatorSettings
from ablate.ultrasound.stages import Stage, stage_times

SETTINGS = SimulatorSettings(scanlines=48, axial_samples=512, rays=4, image_shape=(128, 178))


@pytest.fixture
def simulator(gel: Tissue, tissue: Tissue, ball: Callable[..., Structure]) -> Simulator:
    return Simulator(Scene((ball(tissue, (0, 0, 60), 30.0),), gel, "ball"), settings=SETTINGS)


def test_every_stage_is_timed_and_the_frame_is_the_same(simulator: Simulator) -> None:
    unobserved = simulator.render(np.eye(4))
    moved = np.eye(4)
    moved[0, 3] = 1.0
    simulator.render(moved)
    with stage_times() as taken:
        start = time.perf_counter()
        timed = simulator.render(np.eye(4))
        whole = 1e3 * (time.perf_counter() - start)
    assert np.array_equal(unobserved.image, timed.image)
    counts = {name: len(taken[name]) for name in Stage}
    twice = {Stage.scan_conversion: 2, Stage.probe_rays: 2}  # A is converted, too; scanlines, then rays
    assert counts == dict.fromkeys(Stage, 1) | twice
    total = sum(sum(times) for times in taken.values())
    assert 0 < total <= whole
    simulator.render(moved)
    assert total == sum(sum(times) for times in taken.values()), "nothing is timed after the context"
