"""The maps that a generator reads, of one simulated frame, in the space that the generator works in."""

from collections.abc import Sequence

import numpy as np

from ablate.networks.spec import OF_POSITION, OF_SURFACES, Space
from ablate.ultrasound import Beam, Probe, compensated_attenuation, compensated_beam, position_maps, scan_converter

#: S and A of an image, and the frame in beam space.
FrameMaps = tuple[np.ndarray, np.ndarray, Beam]


def maps_read(
    names: Sequence[str], space: Space, maps: FrameMaps, probe: Probe, tgc: float | Sequence[float]
) -> dict[str, np.ndarray]:
    """The maps of these names in one space, (H, W) or (rows, scanlines) each, from those of one simulated frame.

    Given are S and A of the image and the frame in beam space, of this probe and time gain. `low` is not made.
    """
    segmentation, attenuation, beam = maps
    image_shape, beam_shape = segmentation.shape[:2], beam.segmentation.shape[:2]
    in_beam = Space(space) is Space.beam
    if in_beam:
        segmentation, attenuation = beam.segmentation, beam.attenuation
    read = {"segmentation": segmentation, "attenuation": attenuation}
    if "compensated" in names:
        compensate = compensated_beam if in_beam else compensated_attenuation
        read["compensated"] = compensate(attenuation, probe, tgc)
    for name in OF_SURFACES & set(names):
        echo = getattr(beam, name)
        read[name] = echo if in_beam else scan_converter(probe, beam_shape, image_shape).to_image(echo)
    if OF_POSITION & set(names):
        read |= position_maps(probe, None if in_beam else image_shape, beam_shape)
    return {name: read[name] for name in names if name in read}
