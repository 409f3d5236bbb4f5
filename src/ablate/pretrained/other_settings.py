"""In what a frame differs from those that a generator was trained with: settings that change what a network sees."""

import numpy as np

from ablate.networks import Space
from ablate.setting import identity, plain
from ablate.ultrasound import Probe, SimulatorSettings, TimeGain
from ablate.ultrasound.probe import pixel_size_mm
from ablate.ultrasound.pulse import PulseWidths, pulse_widths
from ablate.ultrasound.time_gain import time_gain_db

MadeWith = tuple[Probe, SimulatorSettings]
# Sizes and gains, which are said otherwise; and how exactly an image is computed.
_SAID_OTHERWISE = frozenset(
    {"image_shape", "scanlines", "axial_samples", "tgc", "tgc_db_cm_mhz", "time_gain_db"}
    | {"rays", "layers", "path_seed", "precision"}
    | {"axial_fwhm_mm", "lateral_fwhm_mm", "elevational_fwhm_mm", "bandwidth", "element_height_mm"}
)
_ALIKE = 0.05  # of the size of a pixel, and of the pulse
_ALIKE_DB = 0.5  # of a time gain


def trained_with(trained: MadeWith, here: MadeWith, space: Space) -> str:
    """Say what a generator was trained with where a frame is made with something else; empty where all is alike.

    Parameters
    ----------
    trained, here : Probe and SimulatorSettings
        Of the training, and of the frame. Rays, layers, seeds, the device and the arithmetic may be others. A time gain
        of `tgc=patient` without a curve is one that is still to be computed, and like that of any patient.
    space : Space
        That the network works in; only in beam space it sees the number of rows and scanlines.

    Returns
    -------
    str
        `trained with dynamic_range_db=60.0 (here 40.0), pixels of ...`: each setting and its two values.
    """
    unlike: list[tuple[str, object, object]] = []
    for trained_look, frame_look in zip(_looks(*trained), _looks(*here), strict=True):
        for key in [one for one in trained_look if one in frame_look]:
            if trained_look[key] != frame_look[key]:
                unlike.append((f"{key}=", trained_look[key], frame_look[key]))
    for name, theirs, ours in zip(PulseWidths._fields, pulse_widths(*trained), pulse_widths(*here), strict=True):
        if not np.isclose(theirs, ours, rtol=_ALIKE, atol=0):
            unlike.append((f"pulse {name}=", f"{theirs:.3g}", f"{ours:.3g}"))
    trained_db, here_db = (_gain_db(here[0], settings) for _, settings in (trained, here))
    if trained_db is None or here_db is None:
        is_alike = TimeGain.patient == trained[1].tgc == here[1].tgc
    else:
        is_alike = np.allclose(trained_db, here_db, rtol=0, atol=_ALIKE_DB)
    if not is_alike:
        unlike.append(("time gain ", _curve(trained_db), _curve(here_db)))
    trained_mm, here_mm = (pixel_size_mm(probe, settings.image_shape) for probe, settings in (trained, here))
    if not np.allclose(trained_mm, here_mm, rtol=_ALIKE):
        size = "{0[0]:.2f} x {0[1]:.2f} mm".format
        unlike.append(("pixels of ", size(trained_mm), size(here_mm)))
    if space is Space.beam and trained[1].beam_shape != here[1].beam_shape:
        shape = "{0[0]} x {0[1]}".format
        unlike.append(("rows x scanlines of ", shape(trained[1].beam_shape), shape(here[1].beam_shape)))
    said = ", ".join(f"{what}{theirs} (here {ours})" for what, theirs, ours in unlike)
    return said and f"trained with {said}"


def _looks(probe: Probe, simulator: SimulatorSettings) -> tuple[dict[str, object], dict[str, object]]:
    """The values of a probe, and of a simulator those that images look different with."""
    return plain(probe), {key: value for key, value in identity(simulator).items() if key not in _SAID_OTHERWISE}


def _gain_db(probe: Probe, settings: SimulatorSettings) -> np.ndarray | None:
    """The time gain at eight equal distances, as a panel has sliders, (8,) dB; None where a patient is to decide it."""
    if settings.tgc is TimeGain.patient and settings.time_gain_db is None:
        return None
    return time_gain_db(np.linspace(0, probe.depth_mm, 8), probe, settings.time_gain)


def _curve(gain_db: np.ndarray | None) -> str:
    return "of each patient" if gain_db is None else f"{' '.join(f'{db:.3g}' for db in gain_db)} dB"
