"""A setting is declared once: what is allowed, what is refused and in which words, and what decides a result."""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import pytest

from ablate.setting import check_name, check_settings, flat, identity, plain, setting, settings_of, shown


class Colour(StrEnum):
    red = "red"
    blue = "blue"


@dataclass(frozen=True)
class Painted:
    colour: Colour = setting(Colour.red)
    layers: int = setting(3, "Of paint.", least=1, most=10)
    share: float = setting(0.5, least=0, below=1)
    width_mm: float | None = setting(None, above=0, unit="mm")
    sizes: tuple[int, int] = setting((2, 3), least=1)
    device: str = setting("cpu", choices=("cpu", "cuda"), incidental=True)
    dry: bool = False

    def __post_init__(self) -> None:
        check_settings(self)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"colour": "green"}, "colour='green': allowed are red, blue"),
        ({"layers": 0}, "layers=0: allowed are whole numbers from 1 to 10"),
        ({"layers": 11}, "layers=11: allowed are whole numbers from 1 to 10"),
        ({"layers": 1.5}, "layers=1.5: allowed are whole numbers from 1 to 10"),
        ({"layers": True}, "layers=True: allowed are whole numbers from 1 to 10"),
        ({"layers": None}, "layers=None: allowed are whole numbers from 1 to 10"),
        ({"share": 1.0}, "share=1.0: allowed are numbers from 0 and below 1"),
        ({"share": math.nan}, "share=nan: allowed are numbers from 0 and below 1"),
        ({"share": -1e-9}, "share=-1e-09: allowed are numbers from 0 and below 1"),
        ({"share": "0.5"}, "share='0.5': allowed are numbers from 0 and below 1"),
        ({"width_mm": 0}, "width_mm=0: allowed are numbers above 0, or null"),
        ({"width_mm": math.inf}, "width_mm=inf: allowed are numbers above 0, or null"),
        ({"sizes": [1]}, "sizes=[1]: allowed are 2 whole numbers from 1"),
        ({"sizes": [0, 1]}, "sizes=[0, 1]: allowed are 2 whole numbers from 1"),
        ({"device": "tpu"}, "device='tpu': allowed are cpu, cuda"),
    ],
)
def test_what_is_not_allowed_is_named_with_what_is(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError) as refused:
        Painted(**values)
    assert str(refused.value) == message


def test_values_get_the_type_that_is_declared() -> None:
    made = Painted(colour="blue", layers=4.0, share=0, width_mm=2, sizes=[5, 6])  # type: ignore[arg-type]
    assert made == Painted(Colour.blue, 4, 0.0, 2.0, (5, 6))
    assert [type(value) for value in (made.layers, made.share, made.width_mm)] == [int, float, float]
    assert (Painted(layers=1), Painted(layers=10), Painted(share=0)) is not None


def test_what_is_incidental_decides_nothing() -> None:
    assert plain(Painted())["device"] == "cpu"
    assert identity(Painted()) == {k: v for k, v in plain(Painted()).items() if k != "device"}
    assert identity(Painted(device="cuda")) == identity(Painted())
    assert dict(flat({"a": plain(Painted()), "b": 1}))["a.sizes"] == [2, 3]


def test_the_words_of_a_table_come_from_the_declaration() -> None:
    allowed = {one.name: (one.allowed, one.declared.unit) for one in settings_of(Painted)}
    assert allowed["width_mm"] == ("numbers above 0, or null", "mm")
    assert allowed["dry"] == ("true, false", "")


@pytest.mark.parametrize(
    "value", ["..", "", "a/b", "a\\b", "-m", "a\n", "a ", " a", "o'neill", "what?", "x" * 201, "\ud800"]
)
def test_what_names_no_folder(value: str) -> None:
    with pytest.raises(ValueError, match=r"^study_name=.*: allowed are at most 200 letters") as refused:
        check_name("study_name", value)
    assert len(str(refused.value)) < 200


@pytest.mark.parametrize("value", ["data", "Data", "data.old"])
def test_names_that_are_taken(value: str) -> None:
    with pytest.raises(ValueError, match=rf"^study_name={value}: the names data, more are taken"):
        check_name("study_name", value, {"more", "data"})


@pytest.mark.parametrize("value", ["a", "sa2h.depth-8", "Läufe 2", "_", "database", "x" * 200])
def test_names(value: str) -> None:
    check_name("study_name", value, {"data"})


def test_a_value_is_shown_short() -> None:
    bomb: list[object] = [0]
    for _ in range(9):
        bomb = [bomb] * 9
    assert len(shown(bomb)) < 1000
    assert shown({"unit": "mm"}) == "{'unit': 'mm'}"
