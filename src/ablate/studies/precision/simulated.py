"""Error and time of the simulator, one setting at a time away from those of the data set."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ablate.studies.precision.bench import Bench, shoot, time_stages
from ablate.studies.precision.errors import Shots, mean_errors, moved
from ablate.studies.precision.ledger import Ledger
from ablate.ultrasound import Plan, Precision, SimulatorSettings

RAYS = (1, 2, 4, 8, 16, 32, 64, 128)
LAYERS = (1, 3, 5)
_PARTS = (0.25, 0.5, 1, 2)  # of the data set's scanlines and axial samples
REFERENCE_RAYS = 4096
_FINEST_LAYERS = 8  # even: but for the outermost two, none of its planes is one of the ladder's
_FINER = 4  # times as many scanlines or axial samples; and rays, so that their noise does not count
_GRIDS = ("layers", "scanlines", "axial_samples")
RAYS_SERIES = "simulator, rays"
FULL_SERIES = "simulator, rays, plan=full"
OTHER_SERIES = "simulator, other scatterers"


def ladders(base: SimulatorSettings) -> dict[str, dict[int, SimulatorSettings]]:
    """Settings by the name of what is changed and its value; all else is as in `base`, which is in each of them."""
    values: dict[str, set[int]] = {"rays": {*RAYS, base.rays}, "layers": {*LAYERS, base.layers}}
    for name in ("scanlines", "axial_samples"):
        values[name] = {max(1, round(part * getattr(base, name))) for part in _PARTS}
    return {name: {v: _changed(base, name, v) for v in sorted(chosen)} for name, chosen in values.items()}


def _changed(base: SimulatorSettings, name: str, value: int) -> SimulatorSettings:
    changes: dict[str, Any] = {name: value}
    return replace(base, **changes)


def series_name(name: str) -> str:
    """What a ladder is called in tables and figures."""
    return f"simulator, {name.replace('_', ' ')}"


def work(base: SimulatorSettings, frames: int) -> int:
    """How many times `measure_simulator` advances."""
    all_ladders = ladders(base)
    settings = sum(map(len, all_ladders.values()))
    on_grids = sum(1 + len(all_ladders[name]) for name in _GRIDS)
    return frames * (2 + settings + len(all_ladders["rays"]) + on_grids + 1 + len(_staged(base)))


def _staged(base: SimulatorSettings) -> tuple[int, ...]:
    return tuple(sorted({RAYS[0], base.rays, RAYS[-1]}))


def measure_simulator(bench: Bench, points: Ledger, details: Ledger, advance: Callable[[], object]) -> Shots:
    """Fill the tables with everything about the simulator.

    The receiver's noise and the phases of clutter follow `path_seed` and the grid, not the rays: with another number of
    rays and the same `path_seed`, the paths are others and all else is the same.

    Returns
    -------
    Shots
        The reference: `REFERENCE_RAYS` rays, all else as the data set.
    """
    base, seeds = bench.simulator, (bench.seed, bench.seed + 1)
    ((reference,), _), ((half,), _) = (
        shoot(bench, [replace(base, rays=rays)], seeds[:1], advance)[0]
        for rays in (REFERENCE_RAYS, REFERENCE_RAYS // 2)
    )
    usual: Shots | None = None
    for name, ladder in ladders(base).items():
        planned = list(ladder.values())
        full = [replace(settings, plan=Plan.full) for settings in planned] if name == "rays" else []
        found = shoot(bench, planned + full, seeds, advance)
        for value, settings, ((shots, other), ms) in zip(ladder, planned, found, strict=False):
            errors = mean_errors(shots, reference, bench.mask)
            _add(points, series_name(name), value, ms, errors)
            _add(
                points, OTHER_SERIES, f"{name.replace('_', ' ')} {value}", ms, mean_errors(other, reference, bench.mask)
            )
            usual = shots if settings == base else usual
            if name == "rays":
                to_half = mean_errors(shots, half, bench.mask)
                for metric, error in errors.items():
                    details.add("reference", RAYS_SERIES, value, metric, moved(metric, error, to_half[metric]))
        for value, ((shots, _), ms), ((as_planned, _), _) in zip(ladder, found[len(planned) :], found, strict=False):
            _add(points, FULL_SERIES, value, ms, mean_errors(shots, reference, bench.mask))
            apart = np.abs(shots.images.astype(np.int16) - as_planned.images).max()
            details.add("plan", FULL_SERIES, value, "largest grey difference to planned", int(apart))
    for name in _GRIDS:
        _converging(bench, name, details, advance)
    assert usual is not None  # every ladder has the data set's settings
    _float64(bench, usual, details, advance)
    for rays in _staged(base):
        for stage, ms in time_stages(bench, replace(base, rays=rays), advance).items():
            details.add("stage", RAYS_SERIES, rays, stage, ms)
    return reference


def _add(points: Ledger, series: str, setting: object, ms: float, errors: dict[str, float]) -> None:
    for metric, error in errors.items():
        points.add(series, setting, ms, metric, error)


def _converging(bench: Bench, name: str, details: Ledger, advance: Callable[[], object]) -> None:
    """Errors of one grid to a finer one, all with more rays; the yardstick is another draw of the speckle there."""
    base = replace(bench.simulator, rays=_FINER * bench.simulator.rays)
    finest = _changed(base, name, _FINEST_LAYERS if name == "layers" else _FINER * getattr(base, name))
    (((fine, other), _),) = shoot(bench, [finest], (bench.seed, bench.seed + 1), advance)
    found: dict[object, Shots] = {"other scatterers": other}
    for value, settings in ladders(base)[name].items():
        (((found[value],), _),) = shoot(bench, [settings], (bench.seed,), advance)
    for setting, shots in found.items():
        for metric, error in mean_errors(shots, fine, bench.mask).items():
            details.add("convergence", series_name(name), setting, metric, error)


def _float64(bench: Bench, single: Shots, details: Ledger, advance: Callable[[], object]) -> None:
    """What single precision of the signal chain costs, on the same paths."""
    (((double,), _),) = shoot(bench, [replace(bench.simulator, precision=Precision.float64)], (bench.seed,), advance)
    for metric, error in mean_errors(single, double, bench.mask).items():
        details.add("limit", "simulator, float32 against float64", bench.simulator.rays, metric, error)
