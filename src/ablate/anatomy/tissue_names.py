"""The tissue that the name of a structure points to, and which of two tissues is drawn over the other."""

import csv
import re
from functools import cache
from importlib.resources import files

from ablate.anatomy.tissue import TissueKind, load_tissues

_UNKNOWN = "soft_tissue"
_MISLEADING = {"skin", "lung"}  # a closed skin is the whole body, and the lung of the table is a fetus's
#: What is filled with something hard or empty cuts into what is soft, so it comes later.
_ORDER = (TissueKind.soft, TissueKind.fluid, TissueKind.gas, TissueKind.bone)


def place_of_tissue(tissue: str) -> int:
    """Which comes earlier in a list of structures that overlap: soft ones, then fluid, gas and bone."""
    return _ORDER.index(load_tissues()[tissue].kind)


def tissue_of_name(name: str) -> tuple[str, str]:
    """The tissue that the name of a structure points to, and why."""
    stem = re.sub(r"[^a-z]+", "_", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()).strip("_")
    known = load_tissues().keys() - _MISLEADING
    if stem in known:
        return stem, "its name is that of a tissue"
    # beginnings of words, the first that fits decides
    for pattern, tissue in _names():
        if match := re.search(rf"(?:^|_)(?:{pattern})", stem):
            return tissue, f"its name has {match.group().strip('_')}"
    if longest := max((tissue for tissue in known if tissue in stem), key=len, default=None):
        return longest, f"its name has {longest}"
    return _UNKNOWN, "its name says nothing"


@cache
def _names() -> list[tuple[str, str]]:
    """Beginnings of words in the names of files, as a regular expression, and the tissue that each points to."""
    with files("ablate.anatomy").joinpath("names.csv").open(encoding="utf-8") as stream:
        return [(row["beginnings"], row["tissue"]) for row in csv.DictReader(stream)]
