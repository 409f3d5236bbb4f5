"""How long a file may be, and what it is not called; who may import whom is a contract in pyproject.toml."""

import ast
import importlib
from pathlib import Path

import ablate

ROOT = Path(ablate.__file__).parent
FILES = sorted(ROOT.rglob("*.py"))


def test_a_file_can_be_read_in_one_sitting() -> None:
    too_long = {str(path.relative_to(ROOT)) for path in FILES if len(path.read_text().splitlines()) > 300}
    assert not too_long


def test_a_file_has_a_name_that_says_what_it_holds() -> None:
    assert not {path.stem for path in FILES} & {"utils", "helpers", "base", "common", "misc", "manager"}


def test_scripts_benchmarks_and_notebooks_import_what_there_is() -> None:
    """Also where a function imports it, which happens hours after a long benchmark has begun."""
    root = Path(__file__).resolve().parents[1]
    for path in (p for folder in ("scripts", "benchmarks", "notebooks") for p in (root / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("ablate"):
                module = importlib.import_module(str(node.module))
                assert not [a.name for a in node.names if not hasattr(module, a.name)], (path, node.lineno)
