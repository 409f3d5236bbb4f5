"""Values that settings refuse, whatever room they belong to."""

import pytest

from ablate.setting import check_name, shown


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
