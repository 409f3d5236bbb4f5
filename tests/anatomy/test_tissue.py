"""The tissue table: levels, order, sources, and messages."""

import csv
import math
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from ablate.anatomy import Tissue, TissueKind, echogenicity_order, load_tissues

FLUIDS = ("coupling_gel", "amniotic_fluid", "urine", "bile", "csf")


def level_db(name: str) -> float:
    return 10 * math.log10(load_tissues()[name].scatter_power)


def test_scatter_power_is_the_variance_of_the_scatterers() -> None:
    tissue = Tissue("t", scatterer_density=0.4, scatterer_mean=0.7, scatterer_sd=0.2)
    generator = np.random.default_rng(0)
    present = generator.random(1_000_000) <= 0.4
    amplitude = present * generator.normal(0.7, 0.2, 1_000_000)
    assert tissue.scatter_power == pytest.approx(amplitude.var(), rel=5e-3)


def test_every_row_has_a_source_and_a_unique_name() -> None:
    text = files("ablate.anatomy").joinpath("tissues.csv").read_text()
    rows = list(csv.DictReader(text.splitlines()))
    assert all(row["source"] for row in rows)
    assert len({row["name"] for row in rows}) == len(rows) == len(load_tissues())


def test_table_is_in_order_of_echo_apart_from_what_is_seen_by_its_surface() -> None:
    powers = [t.scatter_power for t in load_tissues().values() if t.name not in ("gas", "fetal_bone", "bone")]
    assert powers == sorted(powers)
    assert list(load_tissues())[-2:] == ["fetal_bone", "bone"]


@pytest.mark.parametrize(
    ("dark", "bright"),
    [
        *((name, "soft_tissue") for name in ("brain", "kidney", "liver")),
        *(("myocardium", "lung"), ("muscle", "fat"), ("uterine_wall", "placenta"), ("blood", "myocardium")),
    ],
)
def test_neighbours_stand_out_of_log_speckle(dark: str, bright: str) -> None:
    assert 6.5 <= level_db(bright) - level_db(dark) <= 18


def test_boundaries_between_soft_tissues_are_faint_and_those_to_bone_and_gas_strong() -> None:
    z = {name: tissue.impedance_mrayl for name, tissue in load_tissues().items()}

    def echo_db(a: str, b: str) -> float:
        return 20 * math.log10(abs(z[a] - z[b]) / (z[a] + z[b]))

    assert echo_db("liver", "kidney") < -40
    assert -25 < echo_db("fat", "muscle") < -18
    assert echo_db("soft_tissue", "bone") > -6
    assert echo_db("soft_tissue", "gas") > -0.1


def test_order_is_a_permutation_dark_to_bright() -> None:
    t = load_tissues()
    assert echogenicity_order([t["bone"], t["urine"], t["liver"], t["brain"]]) == (3, 0, 2, 1)
    assert echogenicity_order([]) == ()
    everything = list(t.values())
    assert echogenicity_order(everything) == tuple(range(len(everything)))
    assert echogenicity_order(everything[::-1]) == tuple(range(len(everything)))[::-1]


def test_order_places_an_unknown_tissue_by_its_scatter_power() -> None:
    t = load_tissues()
    between = Tissue("graft", scatterer_density=1.0, scatterer_sd=math.sqrt(10 ** (-0.6)))  # -6 dB: kidney to muscle
    assert echogenicity_order([t["muscle"], between, t["kidney"]]) == (2, 1, 0)
    anechoic = Tissue("cyst", scatterer_density=0.0)
    assert echogenicity_order([t["blood"], anechoic]) == (1, 0)


def test_order_places_bone_and_gas_of_ones_own_as_those_of_the_table_and_follows_changed_values() -> None:
    t = load_tissues()
    others = [t[name] for name in ("coupling_gel", "blood", "kidney", "liver")]
    for name in ("bone", "gas"):
        assert echogenicity_order([*others, replace(t[name], name="mine")]) == echogenicity_order([*others, t[name]])
    assert echogenicity_order([*others[:3], replace(t["liver"], scatterer_sd=0.0), t["bone"]]) == (0, 2, 3, 1, 4)


def test_kind_follows_from_impedance_and_scatterers() -> None:
    kinds = {name: tissue.kind for name, tissue in load_tissues().items()}
    assert {name for name, kind in kinds.items() if kind is TissueKind.fluid} == {*FLUIDS, "blood"}
    assert {load_tissues()[name].scatter_power for name in FLUIDS} == {0}
    assert {name for name, kind in kinds.items() if kind is TissueKind.gas} == {"gas"}
    assert {name for name, kind in kinds.items() if kind is TissueKind.bone} == {"bone", "fetal_bone"}
    assert Tissue("plastic", impedance_mrayl=2.5, scatterer_density=0.0).kind is TissueKind.soft
