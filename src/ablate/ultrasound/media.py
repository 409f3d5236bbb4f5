"""Acoustic properties as tables over the tissues of a scene, ready to be indexed by rays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ablate.anatomy import Tissue
from ablate.ultrasound.attenuation import loss_db_mm
from ablate.ultrasound.settings import DepthMode

DISPLAY_SPEED_M_S = 1540.0


class Media(NamedTuple):
    """Tables over tissues, float32 unless said otherwise; a tuple, so that compiled code can take it.

    Attributes
    ----------
    speed_m_s, impedance_mrayl, specularity, thickness_mm : (tissues,)
    loss_db_mm : (tissues,)
        One way, at the probe's frequency.
    lobe_exponent : (tissues,)
        1 / (s + 1) of the power-cosine lobe of normals, roughness / (1 + roughness).
    stretch : (tissues,)
        Displayed length over geometric length: 1, or 1540 / speed in time-of-flight mode.
    silent : (tissues,) bool
        Whether it is the background, and has no scatterers.
    differs : (tissues, tissues) bool
        Where an interface reflects or refracts.
    refracts, rough, thick : bool
        Whether the tissues need these steps at all.
    """

    speed_m_s: np.ndarray
    impedance_mrayl: np.ndarray
    specularity: np.ndarray
    thickness_mm: np.ndarray
    loss_db_mm: np.ndarray
    lobe_exponent: np.ndarray
    stretch: np.ndarray
    silent: np.ndarray
    differs: np.ndarray
    refracts: bool
    rough: bool
    thick: bool


def tabulate(tissues: Sequence[Tissue], used: np.ndarray, frequency_mhz: float, mode: DepthMode, full: bool) -> Media:
    """Tables of some tissues; steps that no tissue in use needs are switched off unless `full`."""

    def column(values: list[float]) -> np.ndarray:
        return np.array(values, np.float32)

    speed = column([t.speed_m_s for t in tissues])
    impedance = column([t.impedance_mrayl for t in tissues])
    roughness = column([t.roughness for t in tissues])
    thickness = column([t.thickness_mm for t in tissues])
    geometric = mode is DepthMode.geometric
    return Media(
        speed_m_s=speed,
        impedance_mrayl=impedance,
        specularity=column([t.specularity for t in tissues]),
        thickness_mm=thickness,
        loss_db_mm=column([loss_db_mm(t, frequency_mhz) for t in tissues]),
        lobe_exponent=roughness / (1 + roughness),
        stretch=np.ones_like(speed) if geometric else np.float32(DISPLAY_SPEED_M_S) / speed,
        silent=np.array([i == 0 and t.scatter_power == 0 for i, t in enumerate(tissues)]),
        differs=(impedance[:, None] != impedance) | (speed[:, None] != speed),
        refracts=full or bool((speed[used] != speed[used][0]).any()),
        rough=full or bool(roughness[used].any()),
        thick=full or bool(thickness[used].any()),
    )
