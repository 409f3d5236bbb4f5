"""What a training was made with: settings, code, environment, hardware.

It is written at each start, as a training that was stopped may go on with other code, and looked at again at the end:
files may change while it trains.
"""

import logging
import os
import platform
import re
import shlex
import subprocess
import tomllib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

import torch

from ablate.setting import plain
from ablate.settings.study import Provenance
from ablate.storage import digest, write_json, write_text
from ablate.study.job import Job, precision_of
from ablate.study.source_code import PACKAGE, loaded_digest, package_digest, said_of_change
from ablate.study.training import Training
from ablate.training import chosen_device, read_checkpoint

_LOG = logging.getLogger(__name__)
#: What is told of the code and the machine of a training.
ABOUT_CODE = ("git_commit", "git_dirty", "hardware", "threads")
_OF_SOURCE = ("source", "source_of_command", "source_at_start", "source_at_end")
_OF_ONE_START = ("time", "command", "step", "device", "precision", "git_diff", *_OF_SOURCE)  # not in `made_with.json`

_DISTRIBUTION = "ablate-ultrasound"  # what an installer calls this package


def git_state(package: Path = PACKAGE) -> dict[str, str]:
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


def write_provenance(job: Job, training: Training) -> None:
    """Write configuration, code and environment of this start of a training, and keep those of earlier starts.

    `starts.json` lists all starts, each with the step that it begins at. `made_with.json` has the values of all, in
    their order. `uncommitted.diff` is the newest; others have their digest in their names. If an unfinished training
    goes on with anything else than before, the log says with what; and so where the code is not that of the command, or
    no longer that of the files, which then tell no commit.
    """
    folder = training.provenance
    folder.mkdir(exist_ok=True)
    write_json(folder / "config.json", plain(job.settings))
    start, diff = _this_start(job, training)
    starts = [*training.starts, start] if start["step"] else [start]  # nothing is left of those before
    if len(starts) > 1 and not training.is_trained:
        changes = _changes(starts[-2], start)
        if changes:
            _LOG.warning("step %d: training goes on with other code or hardware (%s)", start["step"], changes)
    if not training.is_trained and (told := said_of_change(job.source, loaded_digest(), package_digest())):
        _LOG.warning("%s", told)
    if job.settings.tracking.provenance is Provenance.full:
        write_text(folder / "environment.txt", environment())
        _write_diff(folder / "uncommitted.diff", diff)
    else:
        for path in (folder / "environment.txt", *folder.glob("uncommitted*.diff")):
            path.unlink(missing_ok=True)
    write_json(folder / "starts.json", {"starts": starts})
    write_json(folder / "made_with.json", _in_short(starts))


def end_provenance(training: Training) -> list[str]:
    """Look at the code of the package again when a training ends; returns what a reader of it must know, as a sentence.

    Where files differ from what runs, the newest entry of `starts.json` gets their digest as `source_at_end`.
    """
    loaded, now = loaded_digest(), package_digest()
    starts = training.starts
    if now != loaded and starts:
        if "source_at_start" not in starts[-1]:
            _LOG.warning("%s", said_of_change(loaded, loaded, now))
        write_json(training.provenance / "starts.json", {"starts": [*starts[:-1], starts[-1] | {"source_at_end": now}]})
    sources = list(dict.fromkeys(str(start[key]) for start in starts[-1:] for key in _OF_SOURCE if key in start))
    if len({*sources, now}) < 2:
        return []
    trained = f"It was trained by source {loaded} of ablate, whose files changed while its command ran"
    return [f"{trained} ({', '.join(dict.fromkeys([*sources, now]))})."]


def _this_start(job: Job, training: Training) -> tuple[dict[str, Any], str]:
    """What this process trains with, and the uncommitted changes of its code."""
    loaded, now = loaded_digest(), package_digest()
    code = git_state() if now == loaded else {}
    diff = code.pop("git_diff", "")
    if diff:
        code["git_diff"] = digest(diff)
    settings = job.settings.training
    step = 0
    if training.checkpoint.exists():
        with suppress(ValueError):  # a damaged one is refused when training begins
            step = read_checkpoint(training.checkpoint)["steps_done"]
    start = {
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": shlex.join(["python", "-m", "ablate", *job.words]),
        **code,
        "source": loaded,
        **({} if job.source == loaded else {"source_of_command": job.source}),
        **({} if now == loaded else {"source_at_start": now}),
        "hardware": hardware(),
        "threads": settings.threads or torch.get_num_threads(),
        "step": step,
        "device": str(chosen_device(settings.device)),
        "precision": precision_of(settings).name,
        **packages(),
    }
    return start, diff


def _changes(before: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """What differs between two starts of one training."""
    compared = [key for key in now if key not in ("step", "time", "command") and (key in before or key == "git_diff")]
    differing = [key for key in compared if before.get(key) != now[key]]
    return "; ".join(f"{key} {before.get(key, 'none')}, now {now[key]}" for key in differing)


def _write_diff(path: Path, diff: str) -> None:
    """Write uncommitted changes; others that lie there keep a name of their own."""
    earlier = path.read_text("utf-8", "replace") if path.exists() else ""
    if earlier not in ("", diff):
        path.rename(path.with_stem(f"{path.stem}.{digest(earlier)}"))
    write_text(path, diff)


def _in_short(starts: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """The values of all starts by key, each once; the code is dirty if it was at any."""
    keys = dict.fromkeys(key for start in starts for key in start if key not in _OF_ONE_START)
    short = {}
    for key in keys:
        values = dict.fromkeys(str(start[key]) for start in starts if key in start)
        short[key] = "true" if key == "git_dirty" and "true" in values else ", ".join(values)
    return short
