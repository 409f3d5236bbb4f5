"""What a result was made with: code, environment, hardware."""

import os
import platform
import re
import subprocess
import tomllib
from importlib import metadata
from pathlib import Path

import torch

import ablate
from ablate.storage import digest_of_files

_PACKAGE = Path(ablate.__file__).parent
_DISTRIBUTION = "ablate-ultrasound"  # what an installer calls this package
_SOURCES = (".py", ".csv", ".jinja", ".mplstyle")


def git_state(package: Path = _PACKAGE) -> dict[str, str]:
    """Commit, dirty flag and uncommitted diff of the repository that holds the source of this package.

    Empty where the package is not loaded from its own repository: a package that is installed in an environment inside
    another repository must not publish that repository.
    """
    root = package.parents[1]  # the package lies in src/ablate

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(root), *arguments]
        return subprocess.run(command, capture_output=True, text=True, errors="replace", check=True).stdout

    try:
        if tomllib.loads((root / "pyproject.toml").read_text("utf-8"))["project"]["name"] != _DISTRIBUTION:
            return {}
        if Path(git("rev-parse", "--show-toplevel").rstrip("\n")).resolve() != root.resolve():
            return {}
        git("ls-files", "--error-unmatch", str(package / "__init__.py"))
        commit = git("rev-parse", "HEAD").strip()
        diff = git("diff", "HEAD")
        untracked = git("status", "--porcelain").strip()
    except (OSError, ValueError, KeyError, subprocess.CalledProcessError):
        return {}
    return {"git_commit": commit, "git_dirty": str(bool(diff or untracked)).lower(), "git_diff": diff}


def source_digest(package: Path = _PACKAGE) -> str:
    """Digest of the names and contents of the package's code, tables and templates, which may lie in no repository."""
    return digest_of_files(sorted(path for path in package.rglob("*") if path.suffix in _SOURCES))


def environment() -> str:
    """Installed distributions as `name==version` lines, sorted."""
    read = [installed.metadata for installed in metadata.distributions()]  # a property that parses a file each time
    lines = {f"{about['Name']}=={about['Version']}" for about in read if about["Name"]}
    return "\n".join(["# Python " + platform.python_version(), *sorted(lines, key=str.lower)]) + "\n"


def packages() -> dict[str, str]:
    """Versions of Python and, where it is installed, of this package and of its direct dependencies."""
    try:
        required = metadata.requires(_DISTRIBUTION) or ()
    except metadata.PackageNotFoundError:
        return {"python": platform.python_version()}
    direct = sorted(re.split(r"[ ;<>=~!\[]", line)[0] for line in required if "extra ==" not in line)
    return {"python": platform.python_version()} | {name: metadata.version(name) for name in (_DISTRIBUTION, *direct)}


def hardware() -> str:
    """One line: processor, cores, and the GPU when there is one."""
    info = Path("/proc/cpuinfo")
    text = info.read_text("utf-8", "replace") if info.exists() else ""
    model = re.search(r"^model name\s*:\s*(.+)$", text, re.MULTILINE)
    name = model[1].strip() if model else platform.processor() or platform.machine()
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    gpu = f", {torch.cuda.get_device_name()}" if torch.cuda.is_available() else ""
    return f"{name}, {cores} cores{gpu}"
