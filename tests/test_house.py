"""The rules of the house: who may import whom, and how long a file may be."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import ablate

ROOT = Path(ablate.__file__).parent
ROOMS = [
    "anatomy",
    "ultrasound",
    "metrics",
    "networks",
    "dataset",
    "training",
    "analysis",
    "tracking",
    "studies",
]
FRAMEWORKS = {
    "lightning": {"training", "tracking"},
    "mlflow": {"tracking"},
    "hydra": {"__main__", "config", "studies"},
    "omegaconf": {"__main__", "config", "studies"},
}
FILES = sorted(ROOT.rglob("*.py"))


def imported(path: Path) -> set[str]:
    modules: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: absolute imports only"
            modules.add(node.module or "")
    return modules


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_point_down_the_house(path: Path) -> None:
    room = path.relative_to(ROOT).parts[0].removesuffix(".py")
    for module in imported(path):
        head, _, rest = module.partition(".")
        assert room in FRAMEWORKS.get(head, {room}), f"{path.name} imports {module}"
        above = rest.partition(".")[0]
        if head == "ablate" and room in ROOMS and above in ROOMS:
            assert ROOMS.index(above) <= ROOMS.index(room), f"{room} looks up to {above}"
        if head == "ablate" and room in ROOMS[:-1]:
            assert above != "config", f"{room} reads the configuration"


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_a_file_can_be_read_in_one_sitting(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= 300
    assert path.stem not in {"utils", "helpers", "base", "common", "misc", "manager"}


def test_the_list_of_rooms_is_the_folder() -> None:
    assert sorted(ROOMS) == sorted(p.parent.name for p in ROOT.glob("*/__init__.py"))
