"""The maps that a generator reads, of one simulated frame, in the space that the generator works in."""

from collections.abc import Callable, Sequence

import numpy as np

from ablate.networks.spec import Space
from ablate.ultrasound import (
    Beam,
    Probe,
    compensated_attenuation,
    compensated_beam,
    position_maps,
    scan_converter,
)


def maps_read(
    names: Sequence[str],
    space: Space,
    maps: tuple[np.ndarray, np.ndarray, Beam],
    probe: Probe,
    tgc: float | Sequence[float],
) -> dict[str, np.ndarray]:
    """The maps of these names in one space, (H, W) or (rows, scanlines) each, from those of one simulated frame.

    Given are S and A of the image and the frame in beam space, of this probe and time gain. `low` is not made.
    """
    segmentation, attenuation, beam = maps
    image_shape = segmentation.shape[0], segmentation.shape[1]
    rows, lines = beam.segmentation.shape
    if space is Space.beam:
        made: dict[str, Callable[[], np.ndarray]] = {
            "segmentation": lambda: beam.segmentation,
            "attenuation": lambda: beam.attenuation,
            "compensated": lambda: compensated_beam(beam.attenuation, probe, tgc),
            "interfaces": lambda: beam.interfaces,
            "illumination": lambda: beam.illumination,
        }
    else:
        made = {
            "segmentation": lambda: segmentation,
            "attenuation": lambda: attenuation,
            "compensated": lambda: compensated_attenuation(attenuation, probe, tgc),
            "interfaces": lambda: scan_converter(probe, (rows, lines), image_shape).to_image(beam.interfaces),
            "illumination": lambda: scan_converter(probe, (rows, lines), image_shape).to_image(beam.illumination),
        }
    read = {name: made[name]() for name in names if name in made}
    if {"depth", "lateral"} & set(names):
        places = position_maps(probe, None if space is Space.beam else image_shape, (rows, lines))
        read |= {name: places[name] for name in names if name in places}
    return read
