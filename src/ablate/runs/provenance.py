"""What a run was made with, in its folder `provenance`: at each start, as a stopped run may go on with other code."""

import logging
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any

import torch

from ablate import tracking
from ablate.runs.job import Job, precision_of
from ablate.setting import plain
from ablate.settings.study import Provenance
from ablate.storage import digest, write_json, write_text
from ablate.training import chosen_device, read_checkpoint

_LOG = logging.getLogger(__name__)
_OF_ONE_START = ("time", "step", "device", "precision", "git_diff", "source")  # not in `made_with.json`


def write_provenance(job: Job) -> None:
    """Write configuration, code and environment of this start of a run, and keep what earlier starts were made with.

    `starts.json` lists all starts, each with the step that it begins at. `made_with.json` has the values of all, in
    their order. `uncommitted.diff` is the newest; others have their digest in their names. If an unfinished training
    goes on with anything else than before, the log says with what.
    """
    folder = job.folder / "provenance"
    folder.mkdir(exist_ok=True)
    write_json(folder / "config.json", plain(job.settings))
    code = tracking.git_state()
    diff = code.pop("git_diff", "")
    now: dict[str, Any] = {**code, **({"git_diff": digest(diff)} if diff else {}), "source": tracking.source_digest()}
    training, step = job.settings.training, 0
    if job.run.checkpoint.exists():
        with suppress(ValueError):  # a damaged one is refused when training begins
            step = read_checkpoint(job.run.checkpoint)["steps_done"]
    now |= {"hardware": tracking.hardware(), "threads": training.threads or torch.get_num_threads(), "step": step}
    now |= {"device": str(chosen_device(training.device)), "precision": precision_of(training).name}
    now |= tracking.packages()
    starts = [*job.run.starts, {"time": datetime.now(UTC).isoformat(timespec="seconds"), **now}]
    if len(starts) > 1 and now["step"] and job.run.result.get("hash") != job.hash:
        before = starts[-2]
        known = [key for key in now if key != "step" and (key in before or key == "git_diff")]
        changed = [f"{key} {before.get(key, 'none')}, now {now[key]}" for key in known if before.get(key) != now[key]]
        if changed:
            told = "; ".join(changed)
            _LOG.warning("step %d: training goes on with other code or hardware (%s)", now["step"], told)
    if job.settings.tracking.provenance is Provenance.full:
        write_text(folder / "environment.txt", tracking.environment())
        path = folder / "uncommitted.diff"
        earlier = path.read_text("utf-8", "replace") if path.exists() else ""
        if earlier not in ("", diff):
            path.rename(path.with_stem(f"{path.stem}.{digest(earlier)}"))
        write_text(path, diff)
    else:
        for left in (folder / "environment.txt", *folder.glob("uncommitted*.diff")):
            left.unlink(missing_ok=True)
    write_json(folder / "starts.json", {"starts": starts})
    write_json(folder / "made_with.json", _in_short(starts))


def _in_short(starts: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """The values of all starts by key, each once; the code is dirty if it was at any."""
    keys = dict.fromkeys(key for start in starts for key in start if key not in _OF_ONE_START)
    values = {key: dict.fromkeys(str(start[key]) for start in starts if key in start) for key in keys}
    dirty = {"git_dirty": "true"} if "true" in values.get("git_dirty", ()) else {}
    return {key: ", ".join(several) for key, several in values.items()} | dirty
