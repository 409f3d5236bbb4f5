"""Everything that can be refused is refused here, before anything expensive starts."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

import torch

from ablate.anatomy import validate_scene_folder
from ablate.config import SceneKind, Task
from ablate.networks import Family
from ablate.studies.identity import check_place
from ablate.studies.sweep import ConfigurationError, Job


def check(jobs: Sequence[Job]) -> None:
    """Check every job of a sweep against the files and folders it will meet.

    Raises
    ------
    ConfigurationError
        One line that names the key or file and what is allowed.
    """
    for job in jobs:
        s = job.settings
        if s.scene.kind is SceneKind.folder:
            if not s.scene.folder:
                raise ConfigurationError("scene=folder needs scene.folder=path/to/folder")
            try:
                validate_scene_folder(Path(s.scene.folder))
            except (ValueError, OSError) as error:
                raise ConfigurationError(str(error)) from error
        if s.dataset.frames < 1:
            raise ConfigurationError(f"dataset.frames={s.dataset.frames}: at least 1")
        stride = 2**s.model.depth
        if s.training.crop < stride:
            raise ConfigurationError(
                f"training.crop={s.training.crop}: at least 2^model.depth = {stride} for variant {job.label}"
            )
        if s.model.family is Family.unet and s.training.crop % stride:
            raise ConfigurationError(f"training.crop={s.training.crop}: a multiple of {stride} for variant {job.label}")
        for key, device in (("training", s.training.device), ("simulator", s.simulator.device)):
            if device.startswith("cuda") and not torch.cuda.is_available():
                raise ConfigurationError(f"{key}.device={device}: this machine has no usable GPU; allowed is cpu")
    _check_writable(jobs[0].settings.runs)
    if jobs[0].settings.task in (Task.study, Task.plan):
        for job in jobs:
            check_place(job)


def _check_writable(runs: Path) -> None:
    try:
        runs.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=runs):
            pass
    except OSError as error:
        raise ConfigurationError(f"runs_dir={runs} cannot be written: {os.strerror(error.errno or 0)}") from error
