"""Provenance tells commit and state of the checkout, the environment and the hardware."""

import subprocess
import tomllib
from pathlib import Path

import numpy as np

from ablate.tracking import environment, git_state, hardware, packages


def test_git_state_tells_commit_and_diff(tmp_path: Path) -> None:
    def git(*arguments: str) -> str:
        identity = ["-c", "user.name=a", "-c", "user.email=a@b"]
        command = ["git", "-C", str(tmp_path), *identity, *arguments]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout

    assert git_state(tmp_path) == {}
    git("init")
    (tmp_path / "a").write_text("one\n")
    git("add", "a")
    git("commit", "-m", "first")
    clean = git_state(tmp_path)
    assert clean == {"git_commit": git("rev-parse", "HEAD").strip(), "git_dirty": "false", "git_diff": ""}
    (tmp_path / "a").write_text("two\n")
    dirty = git_state(tmp_path)
    assert dirty["git_dirty"] == "true"
    assert "+two" in dirty["git_diff"]


def test_environment_names_versions() -> None:
    assert f"numpy=={np.__version__}" in environment().splitlines()


def test_packages_are_those_that_the_project_names() -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    found = packages()
    assert list(found)[:2] == ["python", "ablate"]
    assert len(found) == 2 + len(project["dependencies"])
    assert found["numpy"] == np.__version__


def test_hardware_is_one_line() -> None:
    assert "core" in hardware()
    assert "\n" not in hardware()
