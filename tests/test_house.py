"""How long a file may be, and what it is not called; who may import whom is a contract in pyproject.toml."""

from pathlib import Path

import ablate

ROOT = Path(ablate.__file__).parent
FILES = sorted(ROOT.rglob("*.py"))


def test_a_file_can_be_read_in_one_sitting() -> None:
    too_long = {str(path.relative_to(ROOT)) for path in FILES if len(path.read_text().splitlines()) > 300}
    assert not too_long


def test_a_file_has_a_name_that_says_what_it_holds() -> None:
    assert not {path.stem for path in FILES} & {"utils", "helpers", "base", "common", "misc", "manager"}
