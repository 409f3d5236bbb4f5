"""Acoustic properties as tables over the tissues of a scene, ready to be indexed by rays."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ablate.anatomy import Tissue
from ablate.ultrasound.settings import DepthMode

DISPLAY_SPEED_M_S = 1540.0


class Media(NamedTuple):
    """Tables over tissues, (tissues,) float32 unless said otherwise; a tuple, so that compiled code can take it."""

    speed_m_s: np.ndarray
    impedance_mrayl: np.ndarray
    specularity: np.ndarray
    thickness_mm: np.ndarray
    loss_db_mm: np.ndarray  # one way, at the probe's frequency
    lobe_exponent: np.ndarray  # 1 / (s + 1) of the power-cosine lobe of normals, roughness / (1 + roughness)
    stretch: np.ndarray  # displayed over geometric length: 1, or 1540 / speed in time-of-flight mode
    anechoic: np.ndarray  # bool: whether it is the background, and has no scatterers
    differs: np.ndarray  # (tissues, tissues) bool: where an interface reflects or refracts
    refracts: bool  # whether the tissues need refraction, rough normals, surface thickness at all
    rough: bool
    thick: bool


def loss_db_mm(tissue: Tissue, frequency_mhz: float) -> float:
    """Amplitude lost one way, alpha f^b, dB/mm."""
    return tissue.attenuation_db_cm_mhz * frequency_mhz**tissue.attenuation_power / 10


def time_gain_db(depth_mm: np.ndarray, frequency_mhz: float, tgc_db_cm_mhz: float) -> np.ndarray:
    """Two-way gain of the TGC at some depths, dB: what tissue of `tgc_db_cm_mhz` takes on the way there and back."""
    return 2 * tgc_db_cm_mhz * frequency_mhz * (depth_mm / 10)


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
        anechoic=np.array([i == 0 and t.scatter_power == 0 for i, t in enumerate(tissues)]),
        differs=(impedance[:, None] != impedance) | (speed[:, None] != speed),
        refracts=full or bool((speed[used] != speed[used][0]).any()),
        rough=full or bool(roughness[used].any()),
        thick=full or bool(thickness[used].any()),
    )
