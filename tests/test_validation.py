"""Values that settings refuse, whatever room they belong to."""

import math
from dataclasses import dataclass
from enum import StrEnum

import pytest

from ablate.validation import check_count, check_name, check_number, coerce_enums, shown


class Colour(StrEnum):
    red = "red"
    blue = "blue"


@dataclass(frozen=True)
class Painted:
    colour: Colour = Colour.red
    sizes: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        coerce_enums(self)


def test_a_string_becomes_its_enum() -> None:
    assert Painted("blue").colour is Colour.blue  # type: ignore[arg-type]


def test_a_string_of_no_member_is_refused_with_those_allowed() -> None:
    with pytest.raises(ValueError, match=r"^colour='green': allowed are red, blue$"):
        Painted("green")  # type: ignore[arg-type]


@pytest.mark.parametrize("value", [math.nan, math.inf, -1, 1.5, "1", None])
def test_numbers_outside_their_range(value: object) -> None:
    with pytest.raises(ValueError, match="share must be between 0 and 1, not"):
        check_number("share", value, 0, 1)


@pytest.mark.parametrize("value", [0, True, 2.0, "3"])
def test_counts_that_are_none(value: object) -> None:
    with pytest.raises(ValueError, match="rays must be a whole number of at least 1"):
        check_count("rays", value, 1)


def test_values_within_their_range() -> None:
    check_number("share", 1, 0, 1)
    check_count("rays", 1, 1)


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
