"""What an installer is told: the name on the package index, where `ablate` is another project, and the Pythons."""

import re
import tomllib
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

import ablate
from ablate.extras import installing

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
KINDS = (".py", ".pyi", ".md", ".yaml", ".yml", ".toml", ".cff", ".ipynb", ".txt")
PLACES = ("src", "docs", "conf", "notebooks", "scripts", "benchmarks", "tests")
# The old name as an installer takes it: after `install`, with options, or with extras or a version.
OLD = re.compile(r"install (-\S+ )*['\"]?ablate(?![\w./-])|(?<![\w./-])ablate(\[[a-z]|[=<>~]=)")
WITH_EXTRAS = re.compile(r"(?:ablate-ultrasound|-e '\.)\[([a-z, ]+)\]")


def texts() -> dict[Path, str]:
    """Every text of the project, but this one and the built site."""
    placed = [path for place in PLACES for path in (ROOT / place).rglob("*") if path.suffix in KINDS]
    at_root = [path for path in ROOT.iterdir() if path.suffix in KINDS or path.name == "Makefile"]
    return {
        path: path.read_text("utf-8", "replace") for path in [*placed, *at_root] if path != Path(__file__).resolve()
    }


def test_nobody_is_told_to_install_the_other_project() -> None:
    for old in ("pip install ablate", "pip install 'ablate[export]'", "pip install -q ablate==0.1.0", '"ablate[dev]",'):
        assert OLD.search(old)
    for ours in ("install ablate-ultrasound", "install 'ablate-ultrasound[export]'", "-m ablate -m", "import ablate"):
        assert not OLD.search(ours)
    told = {path: match[0] for path, text in texts().items() if (match := OLD.search(text))}
    assert told == {}


def test_a_hint_installs_the_extra_of_a_checkout_or_the_packages_that_it_stands_for(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    assert installing("slurm") == "pip install -e '.[slurm]'"
    monkeypatch.setattr("ablate.extras.__file__", str(tmp_path / "site-packages" / "ablate" / "extras.py"))
    for extra in ("slurm", "volumes", "view", "parallel"):
        named = re.findall(r"'([^']+)'", installing(extra))
        assert {Requirement(one) for one in named} == {Requirement(o) for o in PROJECT["optional-dependencies"][extra]}


def test_the_version_is_the_packages_and_that_of_the_citation() -> None:
    assert f"version: {ablate.__version__}\n" in (ROOT / "CITATION.cff").read_text("utf-8")
    assert metadata.version("ablate-ultrasound") == ablate.__version__


def test_extras_that_are_named_exist() -> None:
    extras = PROJECT["optional-dependencies"]
    named = {e.strip() for text in texts().values() for m in WITH_EXTRAS.finditer(text) for e in m[1].split(",")}
    assert "export" in named
    assert named <= extras.keys()


def test_the_pythons_that_are_classified_are_those_that_are_admitted() -> None:
    admitted = SpecifierSet(PROJECT["requires-python"])
    versions = [f"3.{minor}" for minor in range(8, 20) if f"3.{minor}.5" in admitted]
    assert versions == ["3.11", "3.12", "3.13"]
    classified = [c.rpartition(" ")[2] for c in PROJECT["classifiers"] if "Python ::" in c]
    assert classified == versions


def test_the_container_is_made_of_files_that_exist_and_reach_its_builder() -> None:
    steps = (ROOT / "Dockerfile").read_text("utf-8").splitlines()
    copied = {name for step in steps if step.startswith("COPY ") for name in step.split()[1:-1]}
    sent = {line[1:] for line in (ROOT / ".dockerignore").read_text("utf-8").splitlines() if line.startswith("!")}
    assert copied == sent
    assert all((ROOT / name).exists() for name in copied)
