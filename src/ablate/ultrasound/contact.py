"""Whether sound gets from the probe's face into the scene, told from the labels along the scanlines."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ablate.anatomy import Tissue
from ablate.ultrasound.attenuation import loss_db_mm
from ablate.ultrasound.settings import ConvexProbe

FACE_MRAYL = 1.5  # what a probe's matching layers end at: water and soft tissue
NEAR_PART = 0.1  # of the imaging depth: within it sound must get away from the face ...
#: ... without losing more than this there and back, two thirds of a display of 60 dB. In 15 mm at 8 MHz soft tissue
#: loses up to 20 dB and bone 170; 2 mm of bone, a thin skull, lose 26; gas loses 59 by its impedance alone.
MUFFLED_DB = 40.0


def contact_warning(labels: np.ndarray, tissues: Sequence[Tissue], probe: ConvexProbe) -> str | None:
    """What keeps the probe from seeing the scene; its image is right all the same, but dark or empty.

    Parameters
    ----------
    labels : (scanlines, samples) uint8
        Index into `tissues` of each sample, from the face on; of all layers, or what only they see is missed.
    tissues : sequence of Tissue
        The scene's; the first is the background.
    probe : ConvexProbe

    Returns
    -------
    str or None
        The same words for all poses that are wrong in the same way, so that a warning can be given once. Either more
        than half of the scanlines start in a tissue that lets hardly any sound out, as bone and gas do; or all of
        them stay in a background without scatterers though the scene has other tissues.
    """
    if len(tissues) > 1 and tissues[0].scatter_power == 0 and not labels.any():
        return f"no scanline meets anything but {tissues[0].name}, the background: the probe looks past the scene"
    near = labels[:, : int(NEAR_PART * labels.shape[1])]
    if near.size == 0:  # too few samples to tell
        return None
    first = near[:, 0]
    other = near != first[:, None]
    run = np.where(other.any(axis=1), other.argmax(axis=1), near.shape[1])
    run_mm = run * (probe.depth_mm / labels.shape[1])
    face_db = np.array([_two_way_face_loss_db(t.impedance_mrayl) for t in tissues])
    path_db_mm = np.array([2 * loss_db_mm(t, probe.frequency_mhz) for t in tissues])
    muffled = face_db[first] + path_db_mm[first] * run_mm > MUFFLED_DB
    if muffled.mean() <= 0.5:
        return None
    names = " and ".join(tissues[i].name for i in np.unique(first[muffled]))
    return f"most scanlines start in {names}, which lets hardly any sound out: the image is dark beyond it"


def _two_way_face_loss_db(impedance_mrayl: float) -> float:
    """Loss through the face and back: the intensity transmitted is the amplitude's two-way factor."""
    return -20 * math.log10(4 * FACE_MRAYL * impedance_mrayl / (FACE_MRAYL + impedance_mrayl) ** 2)
