"""One colour a tissue, by what it is to ultrasound, and how much of what lies behind it is seen."""

from collections.abc import Sequence

from matplotlib.colors import hsv_to_rgb

from ablate.anatomy import Tissue, TissueKind

Colour = tuple[float, float, float]

BACKGROUND: Colour = (0.88, 0.90, 0.92)
BONE: Colour = (0.95, 0.90, 0.76)
GAS: Colour = (0.50, 0.55, 0.62)
BLOOD: Colour = (0.75, 0.10, 0.15)
_GOLDEN = 0.618034
_SATURATIONS, _VALUES = (0.35, 0.60, 0.48), (0.93, 0.72)
_BLOOD_POWER = 0.02  # what scatters less is red: blood, and the thalamus, which is not a fluid


def tissue_colours(tissues: Sequence[Tissue]) -> list[Colour]:
    """A colour in [0, 1]^3 a tissue, for all of `Scene.tissues`, of which the first is the background.

    The background is pale, bone ivory, gas grey, blood red; clear fluids are blue and all others warm.
    """
    colours: list[Colour] = []
    fluids = others = 0
    for i, tissue in enumerate(tissues):
        if tissue.kind is TissueKind.bone:
            colour = BONE
        elif tissue.kind is TissueKind.gas:
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
