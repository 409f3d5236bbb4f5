"""The maps that a generator reads, of one simulated frame, in the space that the generator works in."""

from collections.abc import Sequence

import numpy as np

from ablate.networks.spec import COMPOUND, GRAIN, OF_POSITION, OF_SURFACES, Space
from ablate.ultrasound import Beam, Probe, compensated_attenuation, compensated_beam, position_maps, scan_converter
from ablate.ultrasound.time_gain import Gain

#: S and A of an image, and the frame in beam space.
FrameMaps = tuple[np.ndarray, np.ndarray, Beam]


def maps_read(names: Sequence[str], space: Space, maps: FrameMaps, probe: Probe, tgc: Gain) -> dict[str, np.ndarray]:
    """The maps that a generator reads, from those of one simulated frame; `low` is not made.

    Parameters
    ----------
    names : sequence of str
        Of the maps.
    space : Space
        In which they are wanted.
    maps : FrameMaps
        S and A of the image, and the frame in beam space.
    probe : Probe
        That of the frame.
    tgc : float, sequence of float or LimitedGain
        Time gain of the frame, dB/cm/MHz or a curve.

    Returns
    -------
    dict of str to (H, W) or (rows, scanlines), of grain (rows, scanlines, 2)
        By name, in the order of the names.

    Raises
    ------
    ValueError
        Where a map is wanted that the frame does not have.
    """
    image_maps, attenuation_of_image, beam = maps
    image_shape = image_maps.shape[:2]
    beam_shape = beam.segmentation.shape[:2]
    in_beam = Space(space) is Space.beam
    read = {
        "segmentation": beam.segmentation if in_beam else image_maps,
        "attenuation": beam.attenuation if in_beam else attenuation_of_image,
    }
    if "compensated" in names:
        compensate = compensated_beam if in_beam else compensated_attenuation
        read["compensated"] = compensate(read["attenuation"], probe, tgc)
    for name in (OF_SURFACES | {COMPOUND}) & set(names):
        values = getattr(beam, name)
        if not values.size:
            raise ValueError(f"the frame has no `{name}`, which this generator reads: `Simulator.beam_maps` makes it")
        read[name] = values if in_beam else scan_converter(probe, beam_shape, image_shape).to_image(values)
    if GRAIN in names:
        if not beam.grain.size:
            raise ValueError("the frame has no grain, which this generator reads: `Simulator.grain` makes it")
        read[GRAIN] = beam.grain
    if OF_POSITION & set(names):
        read |= position_maps(probe, None if in_beam else image_shape, beam_shape)
    return {name: read[name] for name in names if name in read}
