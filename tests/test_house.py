"""How long a file may be, and what it is not called; who may import whom is a contract in pyproject.toml."""

from pathlib import Path

import pytest

import ablate

ROOT = Path(ablate.__file__).parent
FILES = sorted(ROOT.rglob("*.py"))


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_a_file_can_be_read_in_one_sitting(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= 300
    assert path.stem not in {"utils", "helpers", "base", "common", "misc", "manager"}
