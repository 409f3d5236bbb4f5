"""One colour a tissue, by what it is to ultrasound, and how much of what lies behind it is seen."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.colors import hsv_to_rgb

from ablate.anatomy import Tissue

Colour = tuple[float, float, float]

BACKGROUND: Colour = (0.88, 0.90, 0.92)
BONE: Colour = (0.95, 0.90, 0.76)
GAS: Colour = (0.50, 0.55, 0.62)
BLOOD: Colour = (0.75, 0.10, 0.15)
_GOLDEN = 0.618034
_SATURATIONS, _VALUES = (0.35, 0.60, 0.48), (0.93, 0.72)
_BONE_MRAYL, _GAS_MRAYL, _BLOOD_POWER = 3.0, 0.5, 0.02


def is_bone(tissue: Tissue) -> bool:
    """Whether the tissue's impedance is out of soft tissue's reach."""
    return tissue.impedance_mrayl > _BONE_MRAYL


def is_gas(tissue: Tissue) -> bool:
    return tissue.impedance_mrayl < _GAS_MRAYL


def tissue_colours(tissues: Sequence[Tissue]) -> list[Colour]:
    """A colour a tissue: the background pale, bone ivory, gas grey, blood red, clear fluids blue, all others warm.

    Parameters
    ----------
    tissues : sequence of Tissue
        As in `Scene.tissues`, the background first.

    Returns
    -------
    list of 3 floats in [0, 1]
    """
    colours: list[Colour] = []
    fluids = others = 0
    for i, tissue in enumerate(tissues):
        if is_bone(tissue):
            colour = BONE
        elif is_gas(tissue):
            colour = GAS
        elif i == 0:
            colour = BACKGROUND
        elif tissue.scatter_power == 0:
            colour = _hsv(0.52 + 0.045 * (fluids % 4), 0.5, 0.9)
            fluids += 1
        elif tissue.scatter_power < _BLOOD_POWER:
            colour = BLOOD
        else:
            hue = (0.9 + 0.24 * (others * _GOLDEN % 1)) % 1  # from pink over red to yellow
            colour = _hsv(hue, _SATURATIONS[others % 3], _VALUES[others % 2])
            others += 1
        colours.append(colour)
    return colours


def _hsv(hue: float, saturation: float, value: float) -> Colour:
    red, green, blue = hsv_to_rgb((hue, saturation, value))
    return float(red), float(green), float(blue)
