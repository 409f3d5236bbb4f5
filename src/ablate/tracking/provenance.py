"""What a result was made with: code, environment, hardware."""

import os
import platform
import re
import subprocess
from importlib import metadata
from pathlib import Path

import torch


def git_state(folder: Path) -> dict[str, str]:
    """Commit, dirty flag and uncommitted diff of the checkout that `folder` lies in; empty outside one."""

    def git(*arguments: str) -> str:
        done = subprocess.run(["git", "-C", str(folder), *arguments], capture_output=True, text=True, check=True)
        return done.stdout

    try:
        commit = git("rev-parse", "HEAD").strip()
        diff = git("diff", "HEAD")
        untracked = git("status", "--porcelain").strip()
    except (OSError, subprocess.CalledProcessError):
        return {}
    return {"git_commit": commit, "git_dirty": str(bool(diff or untracked)).lower(), "git_diff": diff}


def environment() -> str:
    """Installed distributions as `name==version` lines, sorted."""
    lines = {f"{d.metadata['Name']}=={d.version}" for d in metadata.distributions() if d.metadata["Name"]}
    return "\n".join(["# Python " + platform.python_version(), *sorted(lines, key=str.lower)]) + "\n"


def packages() -> dict[str, str]:
    """Versions of Python, of this package and of its direct dependencies."""
    required = [re.split(r"[ ;<>=~!\[]", r)[0] for r in metadata.requires("ablate") or () if "extra ==" not in r]
    return {"python": platform.python_version()} | {
        name: metadata.version(name) for name in ("ablate", *sorted(required))
    }


def hardware() -> str:
    """One line: processor, cores, and the GPU when there is one."""
    info = Path("/proc/cpuinfo")
    model = re.search(r"^model name\s*:\s*(.+)$", info.read_text(), re.MULTILINE) if info.exists() else None
    name = model[1].strip() if model else platform.processor() or platform.machine()
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    gpu = f", {torch.cuda.get_device_name()}" if torch.cuda.is_available() else ""
    return f"{name}, {cores} cores{gpu}"
