"""docs/settings.md is what scripts/settings_page.py prints."""

from ablate.settings.conf import keys
from support.scripts import ROOT
from support.scripts import script as load

script = load("scripts/settings_page.py")


def test_the_page_is_what_the_script_prints() -> None:
    assert (ROOT / "docs" / "settings.md").read_text("utf-8") == script.page()


def test_every_key_has_a_row() -> None:
    page = script.page()
    assert not [key for key in keys() if f"| `{key}` |" not in page]


def test_values_are_written_as_the_command_line_takes_them() -> None:
    assert [script.written(value) for value in (None, True, (1, 2), 2e-4, 70.0, "all")] == [
        *("null", "true", "[1,2]", "0.0002", "70", "all")
    ]
