"""Provenance tells commit and state of the checkout, the environment and the hardware."""

import subprocess
import tomllib
from pathlib import Path

import numpy as np
import pytest

from ablate.study.provenance import git_state, packages
from ablate.study.source_code import loaded_digest, package_digest, said_of_change


def git(folder: Path, *arguments: str) -> str:
    identity = ["-c", "user.name=a", "-c", "user.email=a@b"]
    command = ["git", "-C", str(folder), *identity, *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def repository(root: Path, place: str, name: str) -> Path:
    """A repository of a project with this name, which has the package in a folder; returns the package."""
    package = root / place / "ablate"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (root / "pyproject.toml").write_text(f'[project]\nname = "{name}"\n')
    git(root, "init")
    return package


def test_git_state_tells_commit_and_diff(tmp_path: Path) -> None:
    package = repository(tmp_path, "src", "ablate-ultrasound")
    assert git_state(package) == {}, "without a commit"
    (package / "a").write_text("one\n")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-m", "first")
    clean = git_state(package)
    assert clean == {"git_commit": git(tmp_path, "rev-parse", "HEAD").strip(), "git_dirty": "false", "git_diff": ""}
    (package / "a").write_bytes(b"two \xe9\n")  # Latin-1
    dirty = git_state(package)
    assert dirty["git_dirty"] == "true"
    assert "+two" in dirty["git_diff"]


@pytest.mark.parametrize(
    ("place", "name", "committed"),
    [
        (".venv/lib/python3.11/site-packages", "thesis", False),
        (".venv/lib/python3.11/site-packages", "ablate-ultrasound", True),
        ("src", "thesis", True),
        ("src", "ablate-ultrasound", False),
        ("src", "ablate", True),
    ],
)
def test_another_repository_tells_nothing(tmp_path: Path, place: str, name: str, committed: bool) -> None:
    package = repository(tmp_path, place, name)
    (tmp_path / "secret.txt").write_text("one\n")
    git(tmp_path, "add", *(["."] if committed else ["secret.txt"]))
    git(tmp_path, "commit", "-m", "first")
    (tmp_path / "secret.txt").write_text("two\n")
    assert git_state(package) == {}


def test_packages_are_those_that_the_project_names() -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    versions = packages()
    assert list(versions)[:2] == ["python", project["name"]]
    assert len(versions) == 2 + len(project["dependencies"])
    assert versions["numpy"] == np.__version__


@pytest.mark.parametrize("name", ["code.py", "tissues.csv", "captions.jinja", "house.mplstyle"])
def test_the_digest_of_the_source_knows_tables_and_templates(tmp_path: Path, name: str) -> None:
    (tmp_path / "deep").mkdir()
    changed = tmp_path / "deep" / name
    changed.write_text("1")
    before = package_digest(tmp_path)
    changed.write_text("2")
    assert package_digest(tmp_path) != before


def test_the_code_that_is_loaded_is_that_of_the_files_when_the_process_began() -> None:
    assert loaded_digest() == package_digest()


@pytest.mark.parametrize(
    ("began", "loaded", "now", "words"),
    [
        ("a", "a", "a", ""),
        ("a", "b", "b", "runs by source b, and its command began with a"),
        ("a", "a", "b", "the files are of source b now, and this job runs by a"),
        ("a", "b", "c", "began with a; the files are of source c now, and this job runs by b"),
        ("a", "b", "a", "began with a; the files are of source a now"),
    ],
)
def test_a_change_of_the_code_is_one_line(began: str, loaded: str, now: str, words: str) -> None:
    said = said_of_change(began, loaded, now)
    assert words in said
    assert bool(said) == bool(words)
    assert "\n" not in said
