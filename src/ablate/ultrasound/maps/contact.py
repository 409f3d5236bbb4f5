"""Whether sound gets from the probe's face into the scene, told from the labels along the scanlines."""

from collections.abc import Sequence

import numpy as np

from ablate.anatomy import Tissue
from ablate.ultrasound.media import loss_db_mm
from ablate.ultrasound.probe_kinds import Probe

FACE_MRAYL = 1.5  # of the last of a probe's matching layers: as water and soft tissue
NEAR_PART = 0.1  # of the imaging depth: sound must leave this part ...
#: ... with a smaller two-way loss than this, two thirds of a display of 60 dB. In 15 mm at 8 MHz soft tissue takes up
#: to 20 dB and bone 170; 2 mm of bone, a thin skull, take 26; gas takes 59 by its impedance alone.
BLOCKED_FROM_DB = 40.0


def contact_warning(labels: np.ndarray, tissues: Sequence[Tissue], probe: Probe) -> str | None:
    """What keeps the probe from seeing the scene; its image is right all the same, but dark or empty.

    Either more than half of the scanlines start in a tissue that lets hardly any sound out, as bone and gas do; or all
    of them stay in the background, the first tissue, which has no scatterers though the scene has other tissues. The
    words are the same for all poses that are wrong in the same way, so that a warning can be given once.
    `labels`, (scanlines, samples), index `tissues`; they are of all layers, so that what only outer ones see counts.
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
    impedance = np.array([t.impedance_mrayl for t in tissues])
    # Through the face and back: the transmitted share of the intensity is the two-way amplitude.
    face_db = -20 * np.log10(4 * FACE_MRAYL * impedance / (FACE_MRAYL + impedance) ** 2)
    path_db_mm = np.array([2 * loss_db_mm(t, probe.frequency_mhz) for t in tissues])
    blocked = face_db[first] + path_db_mm[first] * run_mm > BLOCKED_FROM_DB
    if blocked.mean() <= 0.5:
        return None
    names = " and ".join(tissues[i].name for i in np.unique(first[blocked]))
    return f"most scanlines start in {names}, which lets hardly any sound out: the image is dark beyond it"
