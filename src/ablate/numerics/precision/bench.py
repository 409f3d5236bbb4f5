"""What all measurements share: test frames, the simulator timed on them, errors, and the table on disk."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

import numpy as np
import pandas as pd

from ablate.anatomy import Scene
from ablate.dataset import Part, equally_spaced
from ablate.metrics import METRICS, Pair, evaluate_image
from ablate.runs.job import Job
from ablate.runs.simulated import build_scene, lay_out
from ablate.runs.timed_maps import TimedMaps, nudged
from ablate.storage import remove_partial, write_text
from ablate.ultrasound import Frame, Probe, Simulator, SimulatorSettings, fan_mask
from ablate.ultrasound.probe import pixel_size_mm
from ablate.ultrasound.stages import Stage, stage_times

_TURN = 2  # poses of one setting before the next setting


ENVELOPE = "envelope_rms"
#: On the whole image as in the tables of a study; `mae_smooth` in the fan, after a Gaussian that averages speckle.
IMAGE_ERRORS = tuple(METRICS[name] for name in ("mae", "psnr", "pchi2", "mae_smooth"))


@dataclass(frozen=True)
class Frames:
    """Rendered poses: images, (n, H, W) uint8, and envelopes, (n, samples, scanlines) float32.

    Envelopes are linear, before gain, noise and logarithm. A generator has none.
    """

    images: np.ndarray
    envelopes: np.ndarray | None = None


@dataclass(frozen=True)
class Bench:
    """Some test frames of a data set: their numbers, (n,), their poses, (n, 4, 4) in mm, and the seed of scatterers."""

    scene: Scene
    probe: Probe
    simulator: SimulatorSettings
    frames: np.ndarray
    poses: np.ndarray
    seed: int

    @property
    def mask(self) -> np.ndarray:
        """The fan, (H, W) bool."""
        return fan_mask(self.probe, self.simulator.image_shape)


def bench_of(job: Job) -> Bench:
    """Choose `evaluation.timed_frames` test frames of the study's data set, which need not be simulated yet.

    The settings are those of the data set with a fixed number of rays. It raises ValueError when a mesh or all poses
    cannot be used.
    """
    settings, data = job.settings, job.data
    scene, grid = build_scene(settings)
    known = data.pairs if data.exists else lay_out(settings, scene, grid)
    frames = equally_spaced(np.flatnonzero(known.split == Part.test), settings.evaluation.timed_frames)
    fixed = replace(settings.simulator, tolerance=None)
    return Bench(scene, settings.probe, fixed, frames, known.poses[frames], settings.dataset.seed)


def render_all(
    bench: Bench, several: Sequence[SimulatorSettings], seeds: Sequence[int], advance: Callable[[], object]
) -> list[tuple[list[Frames], float]]:
    """Return the frames of each seed of the scatterers, and the median milliseconds of an image, by setting.

    The speed of a machine changes over seconds. Therefore the settings take turns, a few poses each, in an order that
    is reversed every time. Only the first seed is timed; the others reuse its rays. Each pose is new to the simulator,
    and the first rendering of a turn is not counted. The time excludes segmentation and attenuation, which an image
    does not need, and the noise of the receiver, which is kept over a series of frames.
    """
    simulators = [Simulator(bench.scene, bench.probe, settings, poses=bench.poses) for settings in several]
    rows: list[list[list[tuple[np.ndarray, np.ndarray]]]] = [[] for _ in several]
    times: list[list[float]] = [[] for _ in several]
    turns = list(range(len(several)))
    for begin in range(0, len(bench.poses), _TURN):
        for k in turns:
            simulator = simulators[k]
            simulator.render(nudged(bench.poses[begin]), seeds[0])
            for pose in bench.poses[begin : begin + _TURN]:
                simulator.maps(pose)
                start = time.perf_counter()
                first = simulator.render(pose, seeds[0])
                times[k].append(1e3 * (time.perf_counter() - start))
                rows[k].append([_shown(first), *(_shown(simulator.render(pose, seed)) for seed in seeds[1:])])
                if len(seeds) > 1:
                    simulator.render(pose, seeds[0])  # a simulator keeps the noise of its last seed
                advance()
        turns.reverse()
    stacked = [[Frames(*map(np.stack, zip(*column, strict=True))) for column in zip(*r, strict=True)] for r in rows]
    return [(frames, median(t)) for frames, t in zip(stacked, times, strict=True)]


def _shown(frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    """Keep what errors need; the maps of all settings would take gigabytes."""
    return frame.image, frame.envelope


def time_stages(bench: Bench, settings: SimulatorSettings, advance: Callable[[], object]) -> dict[str, float]:
    """Measure the median milliseconds of each stage of an image, in order; the rest is `everything else`."""
    simulator = Simulator(bench.scene, bench.probe, settings, poses=bench.poses)
    simulator.render(nudged(bench.poses[0]), bench.seed)
    whole, each = [], []
    for pose in bench.poses:
        simulator.maps(pose)
        with stage_times() as taken:
            start = time.perf_counter()
            simulator.render(pose, bench.seed)
            whole.append(1e3 * (time.perf_counter() - start))
        each.append([sum(taken[name]) for name in Stage])
        advance()
    columns = zip(Stage, zip(*each, strict=True), strict=True)
    stages = {name.value: median(column) for name, column in columns if any(column)}
    return stages | {"everything else": median(np.subtract(whole, np.sum(each, axis=1)).tolist())}


def make_inputs(bench: Bench, advance: Callable[[], object]) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """Make the inputs of generators, (n, H, W) each, and measure the median milliseconds of each, as `TimedMaps`."""
    make = TimedMaps(bench.scene, bench.probe, bench.simulator, bench.poses, low=True)
    make(nudged(bench.poses[0]), bench.seed)
    inputs, times = [], []
    for pose in bench.poses:
        maps, taken = make(pose, bench.seed)
        inputs.append(maps)
        times.append(taken)
        advance()
    arrays = {name: np.stack([maps[name] for maps in inputs]) for name in inputs[0]}
    return arrays, {name: median(taken[name] for taken in times) for name in times[0]}


def envelope_rms(envelope: np.ndarray, reference: np.ndarray) -> float:
    """Compute the root of the sum of squared differences over that of the reference; sums are in float64.

    It is 0 if both are zero everywhere, and infinite if only the reference is.
    """
    difference = float(np.sum(np.square(np.subtract(envelope, reference, dtype=np.float64))))
    power = float(np.sum(np.square(reference, dtype=np.float64)))
    if power == 0:
        return 0.0 if difference == 0 else float("inf")
    return (difference / power) ** 0.5


def mean_errors(rendered: Frames, reference: Frames, probe: Probe) -> dict[str, float]:
    """Average each error over the frames of the same poses; an error that cannot be computed is left out.

    `envelope_rms` is left out where there are no envelopes or their grids differ: images are compared on the same
    pixels whatever the grid of samples. PSNR of identical images is infinite; they are left out of its mean, unless all
    are.
    """
    errors: dict[str, list[float]] = {}
    here, there = rendered.envelopes, reference.envelopes
    if here is not None and there is not None and here.shape == there.shape:
        errors[ENVELOPE] = [envelope_rms(a, b) for a, b in zip(here, there, strict=True)]
    shape = (reference.images.shape[1], reference.images.shape[2])
    mask, pixel_mm = fan_mask(probe, shape), pixel_size_mm(probe, shape)
    for image, target in zip(rendered.images, reference.images, strict=True):
        for name, error in evaluate_image(Pair(image, target, mask, pixel_mm=pixel_mm), IMAGE_ERRORS).items():
            errors.setdefault(name, []).append(error)
    return {name: _mean(values) for name, values in errors.items()}


def _mean(values: list[float]) -> float:
    finite = [v for v in values if np.isfinite(v)]
    return float(np.mean(finite)) if finite else values[0]


def relative_change(metric: str, error: float, other: float) -> float:
    """Compute the relative change of an error with another reference; PSNR is converted to the RMS error."""
    if error == other:
        return 0.0
    if metric == "psnr":
        return abs(10 ** ((error - other) / 20) - 1)
    return abs(other / error - 1) if error else float("inf")


class CsvTable:
    """A CSV file that is written whole with each row, so that a kill keeps what was measured and leaves no half a row.

    `columns` are names separated by spaces. An existing file is replaced.
    """

    def __init__(self, path: Path, columns: str) -> None:
        self.path, self.columns = path, columns.split()
        self._rows: list[tuple[object, ...]] = []
        path.parent.mkdir(parents=True, exist_ok=True)
        remove_partial(path)
        self._write()

    def add(self, *values: object) -> None:
        """Add one row, in the order of the columns."""
        self._rows.append(values)
        self._write()

    def add_each(self, *first: object, values: Mapping[str, float]) -> None:
        """Add one row for each value: the first columns, its name and the value."""
        self._rows += [(*first, name, value) for name, value in values.items()]
        self._write()

    def table(self) -> pd.DataFrame:
        """Read all rows; names and settings are text."""
        return pd.read_csv(self.path, dtype={"setting": str}, keep_default_na=False, na_values=["nan"])

    def _write(self) -> None:
        frame = pd.DataFrame(self._rows, columns=self.columns, dtype=object)
        write_text(self.path, frame.to_csv(index=False, na_rep="nan"))
