"""Tissues: their acoustic properties and kinds, the built-in table, and their order from dark to bright."""

import csv
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from importlib.resources import files

from ablate.setting import check_settings, naming, setting

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
    """Acoustic properties of one tissue; their ranges are wide, because extreme cases are meant to run.

    A lattice point scatters with probability `scatterer_density`; its amplitude is then normal with `scatterer_mean`
    and `scatterer_sd` (Burger et al. 2013, eq. 15). Attenuation is `attenuation_db_cm_mhz` f^`attenuation_power`.

    Raises
    ------
    ValueError
        When a value is not finite or outside its physical range; the message names tissue and field.
    """

    name: str
    speed_m_s: float = setting(1540.0, "Speed of sound.", least=1, most=1e5)
    impedance_mrayl: float = setting(1.63, "Characteristic impedance, 10^6 kg m^-2 s^-1.", least=1e-6, most=1e4)
    attenuation_db_cm_mhz: float = setting(0.5, "Amplitude lost, one way, dB/cm at 1 MHz.", least=0, most=1e4)
    scatterer_density: float = setting(0.6, "Probability that a lattice point scatters.", least=0, most=1)
    scatterer_mean: float = setting(0.0, "Relative to the simulator's scatterer level.", least=-1e3, most=1e3)
    scatterer_sd: float = setting(0.3, "Relative to the simulator's scatterer level.", least=0, most=1e3)
    attenuation_power: float = setting(1.0, "Exponent of the frequency in MHz.", least=0, most=4)
    # otherwise the normal is drawn from a power-cosine lobe of exponent 1 / roughness
    roughness: float = setting(0.02, "0 is a mirror.", least=0, most=10)
    thickness_mm: float = setting(0.0, "Standard deviation of the depth over which it reflects.", least=0, most=100)
    specularity: float = setting(8.0, "Exponent n of the echo's lobe max(0, cos)^n.", least=0, most=1e6)
    # the slow variation of scatterer amplitude within the tissue
    texture_contrast_db: float = setting(0.0, "Its standard deviation; 0 is uniform.", least=0, most=40)
    texture_mm: tuple[float, float, float] = setting(
        (4.0, 4.0, 4.0), "Its correlation lengths along the world's x, y and z.", least=1e-3, most=1e6
    )

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise ValueError(f"tissue name must be a non-empty string, not {self.name!r}")
        with naming(f"tissue {self.name!r}: "):
            check_settings(self)

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
    """The built-in tissues by name, from dark to bright; `tissues.csv` has the source of each row."""
    return {tissue.name: tissue for tissue in _table()}


def echogenicity_order(tissues: Sequence[Tissue]) -> tuple[int, ...]:
    """Rank of each tissue from dark to bright: a permutation of range(len(tissues)), 0 the darkest.

    Tissues of the built-in table have its order. A gas or bone of another name is placed after those of the table, any
    other tissue by its `scatter_power` among those that are neither; so is one of the table with other properties.
    Tissues that are still equal keep the order of `tissues`.
    """
    table = _table()
    place = {tissue: float(i) for i, tissue in enumerate(table)}
    # gas and bone look brighter than the speckle inside them, because their surface reflects strongly
    hard = (TissueKind.gas, TissueKind.bone)
    reflecting: dict[TissueKind, float] = {tissue.kind: i for tissue, i in place.items() if tissue.kind in hard}
    scattering = [tissue for tissue in table if tissue.kind not in reflecting]
    powers = [tissue.scatter_power for tissue in scattering]

    def brightness(i: int) -> tuple[float, float]:
        tissue = tissues[i]
        if tissue in place:
            return place[tissue], 0.0
        below = bisect_right(powers, tissue.scatter_power)
        anchor = reflecting.get(tissue.kind, place[scattering[below - 1]] if below else -1.0)
        return anchor + 0.5, tissue.scatter_power

    order = sorted(range(len(tissues)), key=brightness)
    return tuple(order.index(i) for i in range(len(tissues)))
