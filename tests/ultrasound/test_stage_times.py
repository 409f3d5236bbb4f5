"""Timing a frame's stages changes nothing and accounts for the frame."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from ablate.anatomy import Scene, Structure, Tissue
from ablate.ultrasound import Simulator, SimulatorSettings
from ablate.ultrasound import simulator as frame
from ablate.ultrasound.stage_times import STAGES, stage_times


def test_stages_are_timed_from_outside(gel: Tissue, tissue: Tissue, ball: Callable[..., Structure]) -> None:
    settings = SimulatorSettings(scanlines=48, axial_samples=512, rays=4, image_shape=(128, 178))
    simulator = Simulator(Scene((ball(tissue, (0, 0, 60), 30.0),), gel, "ball"), settings=settings)
    plain = simulator.render(np.eye(4))
    moved = np.eye(4)
    moved[0, 3] = 1.0
    simulator.render(moved)
    before = frame.trace
    with stage_times() as taken:
        assert frame.trace is not before
        start = time.perf_counter()
        timed = simulator.render(np.eye(4))
        whole = 1e3 * (time.perf_counter() - start)
    assert frame.trace is before
    assert np.array_equal(plain.image, timed.image)
    counts = {name: len(taken[name]) for name, *_ in STAGES}
    assert counts == dict.fromkeys(counts, 1) | {"scan conversion": 2}, "A is converted, too"
    total = sum(sum(times) for times in taken.values())
    assert 0.5 * whole < total <= whole
