"""The time gain that an operator sets for a patient: one smooth, monotone curve for all frames of an anatomy."""

import logging
from dataclasses import replace
from typing import cast

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.optimize import isotonic_regression

from ablate.anatomy import Scene
from ablate.ultrasound.media import loss_db_mm
from ablate.ultrasound.settings import Probe, SimulatorSettings, Sliders, TimeGain
from ablate.ultrasound.simulator import Simulator

_LOG = logging.getLogger(__name__)
SLIDERS = 8  # of a scanner's panel
_POSES = 24
_LINES, _SAMPLES = 64, 512
_BINS = 64  # of depth
_MOST_DB = 300.0  # of a slider
_SOFT_MRAYL = (1.0, 2.5)  # bone and gas lie outside, and what is behind them is shadow


def with_patient_gain(
    scene: Scene, probe: Probe, settings: SimulatorSettings, poses: np.ndarray, beside: Simulator | None = None
) -> SimulatorSettings:
    """Settings with the curve of `tgc=patient`; as they are where they need none, or have one.

    Where no tissue that scatters is seen they become `tgc=fixed`, with a warning.

    The gain makes up for what the median sample of tissue has lost at its depth, two ways, over the scanlines of 24 of
    the poses. It is the curve that fits the medians best and does not fall (isotonic regression), at 8 sliders. What
    has no scatterers, or lies in the shadow of bone or gas, does not count. The curve is rounded to 0.1 dB, so that all
    processors have the same. How much of it the receiver gives is `most_gain_db`.

    Parameters
    ----------
    poses : (n, 4, 4) float
        Training poses, probe to world, mm.
    beside : Simulator, optional
        Another simulator of the scene, whose triangles are used again.
    """
    if settings.tgc is TimeGain.fixed or settings.time_gain_db is not None:
        return settings
    coarse = SimulatorSettings.low_quality(scanlines=_LINES, axial_samples=_SAMPLES, image_shape=(1, 1))
    chosen = [poses[i] for i in np.linspace(0, len(poses) - 1, min(_POSES, len(poses))).astype(int)]
    simulator = Simulator(scene, probe, coarse, chosen, beside)
    labels = np.concatenate([simulator.scanline_tissues(pose) for pose in chosen])
    loss_db = np.array([2 * loss_db_mm(t, probe.frequency_mhz) for t in scene.tissues]) * (probe.depth_mm / _SAMPLES)
    soft = np.array([_SOFT_MRAYL[0] < t.impedance_mrayl < _SOFT_MRAYL[1] for t in scene.tissues])
    scatters = np.array([t.scatter_power > 0 for t in scene.tissues])
    seen = scatters[labels] & np.logical_and.accumulate(soft[labels], axis=1)
    lost_db = np.where(seen, np.cumsum(loss_db[labels], axis=1), np.nan)
    count = seen.reshape(len(seen), _BINS, -1).sum(axis=(0, 2))
    if not count.any():
        _LOG.warning("tgc=patient: no tissue that scatters is seen from these poses; the gain is that of tgc=fixed")
        return replace(settings, tgc=TimeGain.fixed)
    known = np.flatnonzero(count)
    middle = (np.arange(_BINS) + 0.5) / _BINS * (SLIDERS - 1)  # of the bins, in sliders
    by_bin = np.moveaxis(lost_db.reshape(len(seen), _BINS, -1), 1, 0).reshape(_BINS, -1)
    medians = np.interp(middle, middle[known], [np.nanmedian(by_bin[i]) for i in known])
    rising = isotonic_regression(medians, weights=np.maximum(count, 1)).x
    gain_db = make_interp_spline(middle, rising, k=1)(np.arange(SLIDERS))  # linear, beyond the outer bins' middles too
    return replace(settings, time_gain_db=cast(Sliders, tuple(gain_db.round(1).clip(max=_MOST_DB).tolist())))
