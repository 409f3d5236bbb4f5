"""How many triangles the built-in anatomy has, and the grid spacings that give them."""

import math

FEWEST_TRIANGLES = 4_000
#: Triangles that the mother and the fetus have at grid scale 1, and the mother's share (the paper's 275k of 675k).
_MOTHER_AT_SCALE_1, _FETUS_AT_SCALE_1 = 420_000, 680_000
_MOTHER_SHARE = 275 / 675


def grid_scales(triangles: int) -> tuple[float, float]:
    """Factors on the spacings of the mother's and of the fetus's grids that give about this many triangles.

    Raises ValueError when `triangles` is below `FEWEST_TRIANGLES`.
    """
    if triangles < FEWEST_TRIANGLES:
        raise ValueError(f"fetal_abdomen: triangles must be at least {FEWEST_TRIANGLES}, not {triangles}")
    mother = math.sqrt(_MOTHER_AT_SCALE_1 / (_MOTHER_SHARE * triangles))
    return mother, math.sqrt(_FETUS_AT_SCALE_1 / ((1.0 - _MOTHER_SHARE) * triangles))
