"""Error and time of the simulator, one setting at a time away from those of the data set."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ablate.numerics.precision.bench import (
    Bench,
    CsvTable,
    Frames,
    mean_errors,
    relative_change,
    render_all,
    time_stages,
)
from ablate.ultrasound import PlanMode, SimulatorPrecision, SimulatorSettings

RAYS = (1, 2, 4, 8, 16, 32, 64, 128)
LAYERS = (1, 3, 5)
TOLERANCES = (0.8, 0.4, 0.2, 0.1, 0.05)  # with the most of RAYS at most
_FRACTIONS = (0.25, 0.5, 1, 2)  # of the data set's scanlines and axial samples
REFERENCE_RAYS = 4096
_FINEST_LAYERS = 8  # even, so that only its two outermost planes are also planes of the ladder
_FINER = 4  # times as many scanlines or axial samples, and rays, so that Monte-Carlo noise is negligible
_GRIDS = ("layers", "scanlines", "axial_samples")
RAYS_SERIES = "simulator, rays"
FULL_SERIES = "simulator, rays, plan=full"
TOLERANCE_SERIES = "simulator, tolerance"
OTHER_SERIES = "simulator, other scatterers"


def ladders(base: SimulatorSettings) -> dict[str, dict[int, SimulatorSettings]]:
    """List settings by the name and the value of what is changed; each ladder includes `base` itself."""
    values: dict[str, set[int]] = {"rays": {*RAYS, base.rays}, "layers": {*LAYERS, base.layers}}
    for name in ("scanlines", "axial_samples"):
        values[name] = {max(1, round(part * getattr(base, name))) for part in _FRACTIONS}
    return {name: {v: _changed(base, name, v) for v in sorted(chosen)} for name, chosen in values.items()}


def _changed(base: SimulatorSettings, name: str, value: int) -> SimulatorSettings:
    changes: dict[str, Any] = {name: value}
    return replace(base, **changes)


def series_name(name: str) -> str:
    """Name a ladder as tables and figures do."""
    return f"simulator, {name.replace('_', ' ')}"


def work(base: SimulatorSettings, frames: int) -> int:
    """Count how many times `measure_simulator` calls `advance`."""
    all_ladders = ladders(base)
    settings = sum(map(len, all_ladders.values()))
    on_grids = sum(1 + len(all_ladders[name]) for name in _GRIDS)
    return frames * (2 + settings + len(all_ladders["rays"]) + len(TOLERANCES) + on_grids + 1 + len(_staged(base)))


def _staged(base: SimulatorSettings) -> list[int]:
    return sorted({RAYS[0], base.rays, RAYS[-1]})


def measure_simulator(bench: Bench, points: CsvTable, details: CsvTable, advance: Callable[[], object]) -> Frames:
    """Measure errors, times, convergence and stages of the simulator, and return the reference.

    The reference has `REFERENCE_RAYS` rays and otherwise the settings of the data set. The receiver's noise and the
    phases of clutter depend on `path_seed` and on the grid, not on the rays. With another number of rays and the same
    `path_seed` only the paths differ.
    """
    base, seeds = bench.simulator, (bench.seed, bench.seed + 1)
    ((reference,), _), ((half,), _) = (
        render_all(bench, [replace(base, rays=rays)], seeds[:1], advance)[0]
        for rays in (REFERENCE_RAYS, REFERENCE_RAYS // 2)
    )
    usual: Frames | None = None
    for name, ladder in ladders(base).items():
        planned = list(ladder.values())
        full = [replace(settings, plan=PlanMode.full) for settings in planned] if name == "rays" else []
        most = planned[-1].rays
        adaptive = [replace(base, rays=most, tolerance=t) for t in TOLERANCES] if name == "rays" else []
        measured = render_all(bench, planned + full + adaptive, seeds, advance)
        for value, settings, ((rendered, other), ms) in zip(ladder, planned, measured, strict=False):
            errors = mean_errors(rendered, reference, bench.probe)
            points.add_each(series_name(name), value, ms, values=errors)
            setting = f"{name.replace('_', ' ')} {value}"
            points.add_each(OTHER_SERIES, setting, ms, values=mean_errors(other, reference, bench.probe))
            usual = rendered if settings == base else usual
            if name == "rays":
                to_half = mean_errors(rendered, half, bench.probe)
                changes = {metric: relative_change(metric, errors[metric], to_half[metric]) for metric in errors}
                details.add_each("reference", RAYS_SERIES, value, values=changes)
        for tolerance, ((rendered, _), ms) in zip(TOLERANCES, measured[len(planned) + len(full) :], strict=False):
            points.add_each(TOLERANCE_SERIES, tolerance, ms, values=mean_errors(rendered, reference, bench.probe))
        for value, ((rendered, _), ms), ((as_planned, _), _) in zip(
            ladder, measured[len(planned) :], measured, strict=False
        ):
            points.add_each(FULL_SERIES, value, ms, values=mean_errors(rendered, reference, bench.probe))
            apart = np.abs(rendered.images.astype(np.int16) - as_planned.images).max()
            details.add("plan", FULL_SERIES, value, "largest grey difference to planned", int(apart))
    for name in _GRIDS:
        _converging(bench, name, details, advance)
    assert usual is not None  # every ladder has the data set's settings
    in_float64 = replace(base, precision=SimulatorPrecision.float64)
    (((double,), _),) = render_all(bench, [in_float64], seeds[:1], advance)
    limits = mean_errors(usual, double, bench.probe)  # of the signal chain in single precision, on the same paths
    details.add_each("limit", "simulator, float32 against float64", base.rays, values=limits)
    for rays in _staged(base):
        details.add_each("stage", RAYS_SERIES, rays, values=time_stages(bench, replace(base, rays=rays), advance))
    return reference


def _converging(bench: Bench, name: str, details: CsvTable, advance: Callable[[], object]) -> None:
    """Compare grids with a finer one, all with more rays, and the finer one with other scatterers as a scale."""
    base = replace(bench.simulator, rays=_FINER * bench.simulator.rays)
    finest = _changed(base, name, _FINEST_LAYERS if name == "layers" else _FINER * getattr(base, name))
    (((fine, other), _),) = render_all(bench, [finest], (bench.seed, bench.seed + 1), advance)
    by_setting: dict[object, Frames] = {"other scatterers": other}
    for value, settings in ladders(base)[name].items():
        (((by_setting[value],), _),) = render_all(bench, [settings], (bench.seed,), advance)
    for setting, rendered in by_setting.items():
        details.add_each("convergence", series_name(name), setting, values=mean_errors(rendered, fine, bench.probe))
