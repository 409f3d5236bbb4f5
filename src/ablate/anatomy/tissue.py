"""Tissues: their acoustic properties and kinds, the built-in table, and their order from dark to bright."""

import csv
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from importlib.resources import files

from ablate.validation import check_number

#: Lowest and highest value of each number of a tissue; wide, because extreme cases are meant to run.
TISSUE_RANGES: dict[str, tuple[float, float]] = {
    "speed_m_s": (1.0, 1e5),
    "impedance_mrayl": (1e-6, 1e4),
    "attenuation_db_cm_mhz": (0.0, 1e4),
    "scatterer_density": (0.0, 1.0),
    "scatterer_mean": (-1e3, 1e3),
    "scatterer_sd": (0.0, 1e3),
    "attenuation_power": (0.0, 4.0),
    "roughness": (0.0, 10.0),
    "thickness_mm": (0.0, 100.0),
    "specularity": (0.0, 1e6),
    "texture_contrast_db": (0.0, 40.0),
}
_GAS_BELOW_MRAYL, _BONE_ABOVE_MRAYL = 0.5, 3.0  # soft tissue and fluid lie between
_FLUID_UP_TO_MRAYL = 2.0
_FLUID_UP_TO_POWER = 0.01  # of the scatterers: blood has 0.006; the darkest soft tissue, the thalamus, has 0.017


class TissueKind(StrEnum):
    """What a tissue is to ultrasound."""

    fluid = "fluid"
    gas = "gas"
    bone = "bone"
    soft = "soft"


@dataclass(frozen=True)
class Tissue:
    """Acoustic properties of one tissue.

    Attributes
    ----------
    impedance_mrayl
        Characteristic impedance, MRayl (10^6 kg m^-2 s^-1).
    attenuation_db_cm_mhz
        Amplitude attenuation, one way, dB/cm at 1 MHz.
    scatterer_density, scatterer_mean, scatterer_sd
        A lattice point scatters with probability `scatterer_density`; its amplitude is then normal with this
        mean and standard deviation, relative to the simulator's scatterer level (Burger et al. 2013, eq. 15).
    attenuation_power
        Exponent b of alpha f^b.
    roughness
        0 is a mirror; otherwise the normal is drawn from a power-cosine lobe of exponent 1 / roughness.
    thickness_mm
        Standard deviation of the depth over which the surface reflects, mm.
    specularity
        Exponent n of the echo's lobe max(0, cos)^n; larger is more mirror-like.
    texture_contrast_db
        Standard deviation of the slow variation of scatterer amplitude within the tissue, dB; 0 is uniform.
    texture_mm
        Correlation lengths of that variation along the world's x, y and z, mm.

    Raises
    ------
    ValueError
        When a value is not finite or outside its physical range; the message names tissue and field.

    Examples
    --------
    >>> cyst = Tissue("cyst", impedance_mrayl=1.5, scatterer_density=0.0)
    >>> cyst.kind.value, cyst.scatter_power
    ('fluid', 0.0)
    """

    name: str
    speed_m_s: float = 1540.0
    impedance_mrayl: float = 1.63
    attenuation_db_cm_mhz: float = 0.5
    scatterer_density: float = 0.6
    scatterer_mean: float = 0.0
    scatterer_sd: float = 0.3
    attenuation_power: float = 1.0
    roughness: float = 0.02
    thickness_mm: float = 0.0
    specularity: float = 8.0
    texture_contrast_db: float = 0.0
    texture_mm: tuple[float, float, float] = (4.0, 4.0, 4.0)

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise ValueError(f"tissue name must be a non-empty string, not {self.name!r}")
        for name, (lower, upper) in TISSUE_RANGES.items():
            check_number(f"tissue {self.name!r}: {name}", getattr(self, name), lower, upper)
        if not isinstance(self.texture_mm, Iterable) or len(lengths := tuple(self.texture_mm)) != 3:
            raise ValueError(f"tissue {self.name!r}: texture_mm must be 3 lengths, not {self.texture_mm!r}")
        object.__setattr__(self, "texture_mm", lengths)  # a list would not hash
        for length_mm in self.texture_mm:
            check_number(f"tissue {self.name!r}: texture_mm", length_mm, 1e-3, 1e6)

    @property
    def scatter_power(self) -> float:
        """Variance of the scatterers, which the speckle's power follows: p (sd^2 + (1 - p) mean^2)."""
        p, m, s = self.scatterer_density, self.scatterer_mean, self.scatterer_sd
        return p * (s * s + (1 - p) * m * m)

    @property
    def kind(self) -> TissueKind:
        """Follows from impedance and scatterers, so tissues outside the built-in table have a kind too."""
        if self.impedance_mrayl < _GAS_BELOW_MRAYL:
            return TissueKind.gas
        if self.impedance_mrayl > _BONE_ABOVE_MRAYL:
            return TissueKind.bone
        is_fluid = self.impedance_mrayl <= _FLUID_UP_TO_MRAYL and self.scatter_power <= _FLUID_UP_TO_POWER
        return TissueKind.fluid if is_fluid else TissueKind.soft


@cache
def _table() -> tuple[Tissue, ...]:
    tissues = []
    with files("ablate.anatomy").joinpath("tissues.csv").open(encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            numbers = {key: float(value) for key, value in row.items() if key not in ("name", "source")}
            texture_mm = tuple(numbers.pop(f"texture_{axis}_mm") for axis in "xyz")
            tissues.append(Tissue(name=row["name"], texture_mm=texture_mm, **numbers))  # type: ignore[arg-type]
    return tuple(tissues)


def load_tissues() -> dict[str, Tissue]:
    """The built-in tissues by name, from dark to bright; `tissues.csv` has the source of each row.

    Examples
    --------
    >>> load_tissues()["liver"].attenuation_db_cm_mhz
    0.5
    """
    return {tissue.name: tissue for tissue in _table()}


def echogenicity_order(tissues: Sequence[Tissue]) -> tuple[int, ...]:
    """Rank of each tissue from dark to bright: a permutation of range(len(tissues)), 0 the darkest.

    Tissues of the built-in table have its order. A tissue of another name is placed by its `scatter_power` among those
    of the table that are neither gas nor bone. Tissues that are still equal keep the order of `tissues`.

    Examples
    --------
    >>> table = load_tissues()
    >>> echogenicity_order([table["bone"], table["urine"], table["liver"]])
    (2, 0, 1)
    """
    table = _table()
    place = {tissue.name: float(i) for i, tissue in enumerate(table)}
    # gas and bone look brighter than the speckle inside them, because their surface reflects strongly
    scattering = [tissue for tissue in table if tissue.kind not in (TissueKind.gas, TissueKind.bone)]
    powers = [tissue.scatter_power for tissue in scattering]

    def brightness(i: int) -> tuple[float, float]:
        if tissues[i].name in place:
            return place[tissues[i].name], 0.0
        below = bisect_right(powers, tissues[i].scatter_power)
        anchor = place[scattering[below - 1].name] if below else -1.0
        return anchor + 0.5, tissues[i].scatter_power

    order = sorted(range(len(tissues)), key=brightness)
    return tuple(order.index(i) for i in range(len(tissues)))
