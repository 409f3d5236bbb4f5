"""A simulator of the user's own as the reference: its re-simulation, and settings of ablate's simulator beside it."""

import time
from dataclasses import replace
from statistics import median

import numpy as np

from ablate.dataset.split import resimulation_seed
from ablate.numerics.precision.bench import (
    OTHER_SERIES,
    Bench,
    Measured,
    changed,
    combined,
    render_all,
    setting_in_words,
    shown_progress,
)
from ablate.numerics.precision.errors import Frames, frame_errors, with_histogram_of
from ablate.ultrasound import simulators_of


def measure_own_simulator(bench: Bench, target: str) -> tuple[Frames, Measured]:
    """Measure the re-simulation of `target`, and ablate's simulator, with scatterers that the reference does not have.

    The reference is a frame of `target` with the settings and scatterers of the data set. Its rays are not varied: what
    a user's simulator costs may not depend on them. Of ablate's simulator the usual and the fastest setting are
    measured, with grey levels matched to the reference's, for a curve could mend brightness and contrast. An
    OwnSimulatorError, which names the pose, where `target` fails.
    """
    reference, _ = _rendered(bench, target)
    base = bench.simulator
    other = replace(bench, seed=resimulation_seed(bench.seed))
    again = replace(base, path_seed=resimulation_seed(base.path_seed))
    resimulated, ms = _rendered(replace(other, simulator=again), target)
    found = Measured()
    found.add_renderer(OTHER_SERIES, bench.usual, ms, frame_errors(resimulated, reference, bench.probe))
    changes = [{"rays": base.rays}, *combined(base)]
    settings = [changed(base, change) for change in changes]
    measured = render_all(other, settings, [other.seed], "ablate's own simulator")
    for change, ((frames,), own_ms) in zip(changes, measured, strict=True):
        errors = frame_errors(with_histogram_of(frames, reference, bench.probe), reference, bench.probe)
        found.add_renderer(OTHER_SERIES, setting_in_words(change), own_ms, errors)
    return reference, found


def _rendered(bench: Bench, target: str) -> tuple[Frames, float]:
    """The poses by the user's simulator, and the median milliseconds of an image; the first one's set-up counts."""
    simulator = simulators_of(target)(bench.scene, bench.probe, bench.simulator, poses=bench.poses)
    images, times = [], []
    for pose in shown_progress(bench.poses, target):
        start = time.perf_counter()
        images.append(simulator.image(pose, bench.seed))
        times.append(1e3 * (time.perf_counter() - start))
    return Frames(np.stack(images)), median(times)
