"""In what a frame differs from those that a generator was trained with: settings that change what a network sees."""

import numpy as np

from ablate.networks import Space
from ablate.setting import identity, plain
from ablate.ultrasound import Probe, SimulatorSettings, TimeGain
from ablate.ultrasound.probe import pixel_size_mm
from ablate.ultrasound.time_gain import time_gain_db

MadeWith = tuple[Probe, SimulatorSettings]
# Sizes and gains, which are said otherwise; and how exactly an image is computed.
_SAID_OTHERWISE = frozenset(
    {"image_shape", "scanlines", "axial_samples", "tgc", "tgc_db_cm_mhz", "time_gain_db"}
    | {"rays", "layers", "path_seed", "precision"}
)
_ALIKE = 0.05  # of the size of a pixel
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
    for of_training, of_frame in zip(_looks(*trained), _looks(*here), strict=True):
        for key in [one for one in of_training if one in of_frame]:
            if of_training[key] != of_frame[key]:
                unlike.append((f"{key}=", of_training[key], of_frame[key]))
    gains = [None if _is_open(settings) else _gain_db(here[0], settings) for _, settings in (trained, here)]
    if gains[0] is None or gains[1] is None:
        is_alike = TimeGain.patient == trained[1].tgc == here[1].tgc
    else:
        is_alike = np.allclose(*gains, rtol=0, atol=_ALIKE_DB)
    if not is_alike:
        curves = ["of each patient" if gain is None else f"{' '.join(f'{db:.3g}' for db in gain)} dB" for gain in gains]
        unlike.append(("time gain ", *curves))
    sizes_mm = [pixel_size_mm(probe, settings.image_shape) for probe, settings in (trained, here)]
    if not np.allclose(*sizes_mm, rtol=_ALIKE):
        sizes = [f"{height:.2f} x {width:.2f} mm" for height, width in sizes_mm]
        unlike.append(("pixels of ", *sizes))
    shapes = [f"{rows} x {lines}" for rows, lines in (settings.beam_shape for _, settings in (trained, here))]
    if space is Space.beam and shapes[0] != shapes[1]:
        unlike.append(("rows x scanlines of ", *shapes))
    said = ", ".join(f"{what}{theirs} (here {ours})" for what, theirs, ours in unlike)
    return said and f"trained with {said}"


def _looks(probe: Probe, simulator: SimulatorSettings) -> tuple[dict[str, object], dict[str, object]]:
    """The values of a probe, and of a simulator those that images look different with."""
    return plain(probe), {key: value for key, value in identity(simulator).items() if key not in _SAID_OTHERWISE}


def _is_open(settings: SimulatorSettings) -> bool:
    return settings.tgc is TimeGain.patient and settings.time_gain_db is None


def _gain_db(probe: Probe, settings: SimulatorSettings) -> np.ndarray:
    """The time gain at eight equal distances, as a panel has sliders, (8,) dB."""
    return time_gain_db(np.linspace(0, probe.depth_mm, 8), probe, settings.time_gain)
