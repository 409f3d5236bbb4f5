"""The built-in tissue table and the order, dark to bright, that labels are encoded in."""

from __future__ import annotations

import csv
from bisect import bisect_right
from collections.abc import Sequence
from functools import cache
from importlib.resources import files

from ablate.anatomy.scene import Tissue

TEXTURE_COLUMNS = ("texture_x_mm", "texture_y_mm", "texture_z_mm")
#: Tissues that look brighter than the speckle inside them, because their surface is what is seen.
BRIGHT_BY_SURFACE = ("gas", "fetal_bone", "bone")


@cache
def _table() -> tuple[Tissue, ...]:
    with files("ablate.anatomy").joinpath("tissues.csv").open(encoding="utf-8") as stream:
        return tuple(_from_row(row) for row in csv.DictReader(stream))


def _from_row(row: dict[str, str]) -> Tissue:
    texture_mm = tuple(float(row[column]) for column in TEXTURE_COLUMNS)
    numbers = {key: float(value) for key, value in row.items() if key not in ("name", "source", *TEXTURE_COLUMNS)}
    return Tissue(name=row["name"], texture_mm=texture_mm, **numbers)  # type: ignore[arg-type]


def load_tissues() -> dict[str, Tissue]:
    """The built-in table, in its order from dark to bright.

    Returns
    -------
    dict of str to Tissue
        A new dictionary; each row's origin is in the `source` column of `tissues.csv`.
    """
    return {tissue.name: tissue for tissue in _table()}


def echogenicity_order(tissues: Sequence[Tissue]) -> tuple[int, ...]:
    """Rank of each tissue from dark to bright, by name in the built-in table.

    A tissue of another name is placed by its `scatter_power` among the table's tissues (those seen by their
    surface, gas and bone, left out); what remains equal keeps the order of `tissues`.

    Parameters
    ----------
    tissues : sequence of Tissue
        As in `Scene.tissues`.

    Returns
    -------
    tuple of int
        A permutation of range(len(tissues)): entry i is the rank of tissues[i], 0 the darkest.
    """
    table = _table()
    place = {tissue.name: float(i) for i, tissue in enumerate(table)}
    ruled_by_speckle = [tissue for tissue in table if tissue.name not in BRIGHT_BY_SURFACE]
    powers = [tissue.scatter_power for tissue in ruled_by_speckle]

    def key(i: int) -> tuple[float, float, int]:
        tissue = tissues[i]
        if tissue.name in place:
            return place[tissue.name], 0.0, i
        below = bisect_right(powers, tissue.scatter_power)
        anchor = place[ruled_by_speckle[below - 1].name] if below else -1.0
        return anchor + 0.5, tissue.scatter_power, i

    by_brightness = sorted(range(len(tissues)), key=key)
    ranks = [0] * len(tissues)
    for rank, i in enumerate(by_brightness):
        ranks[i] = rank
    return tuple(ranks)
