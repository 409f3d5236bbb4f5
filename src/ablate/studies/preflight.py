"""Everything that can be refused is refused here, before anything expensive starts."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Sequence
from pathlib import Path

import torch

from ablate.anatomy import SiteGrid, fetal_sites, validate_scene_folder
from ablate.config import SceneKind, StudySettings, Task
from ablate.dataset import Part, resample_grid
from ablate.metrics import FID_METRICS, choose_metrics, inception_file
from ablate.networks import conditions
from ablate.studies.identity import check_place
from ablate.studies.imported import checked_folder
from ablate.studies.sweep import ConfigurationError, Job
from ablate.studies.variants import variant_model, variant_names

_NEED_SCENE = (Task.preview, Task.precision)


def check(jobs: Sequence[Job]) -> None:
    """Check every job of a sweep against the files, folders and devices it will meet.

    Raises
    ------
    ConfigurationError
        One line that names the key or file and what is allowed.
    """
    for job in jobs:
        seen = _check_pairs(job) if job.settings.scene.kind is SceneKind.pairs else _check_scene(job.settings)
        _check_training(job, seen, {other.label for other in jobs})
        _check_metrics(job.settings)
    starts = jobs[0].settings.task in (Task.study, Task.simulate)
    if starts or jobs[0].settings.task in (*_NEED_SCENE, Task.stability):
        _check_writable(jobs[0].settings.runs)
    if starts or jobs[0].settings.task is Task.plan:
        for job in jobs:
            check_place(job)


def _check_pairs(job: Job) -> int:
    """Number of frames to train on in a folder of pairs that has what the variant reads."""
    s = job.settings
    if s.task in _NEED_SCENE:
        raise ConfigurationError(
            f"task={s.task}: pairs made elsewhere have no scene; allowed are scene=fetal and folder"
        )
    try:
        checked = checked_folder(s)
    except (ValueError, OSError) as error:
        raise ConfigurationError(str(error)) from error
    for name in conditions(s.model):
        if name not in checked.maps:
            allowed = [v for v in variant_names() if checked.maps.issuperset(conditions(variant_model(v)))]
            raise ConfigurationError(
                f"variant {job.label} reads {name}, but {checked.folder} has no folder {name}; "
                f"allowed are variants without it: {', '.join(allowed)}"
            )
    if checked.parts is not None:
        return int((checked.parts == Part.train).sum())
    return _training_frames(s, len(checked.names))


def _check_scene(s: StudySettings) -> int:
    """Number of frames to train on; those asked for are at most the poses of the grid."""
    sites: SiteGrid | None = fetal_sites()
    if s.scene.kind is SceneKind.folder:
        if not s.scene.folder:
            raise ConfigurationError("scene=folder needs scene.folder=path/to/folder")
        try:
            sites = validate_scene_folder(Path(s.scene.folder)).sites
        except (ValueError, OSError) as error:
            raise ConfigurationError(str(error)) from error
        if sites is None:
            raise ConfigurationError(f"{s.scene.folder}/scene.yaml has no `sites`: where to put the probe")
    assert sites is not None
    grid = resample_grid(sites, s.dataset.grid)
    poses = len(grid.heights_mm) * len(grid.angles_deg) * len(grid.tilts_deg) * len(grid.rolls_deg)
    if s.dataset.frames > poses:
        raise ConfigurationError(
            f"dataset.frames={s.dataset.frames}: at most {poses}, the poses of the probe sites; "
            "more of them: dataset.grid=[heights,angles,tilts,rolls]"
        )
    return _training_frames(s, s.dataset.frames)


def _training_frames(s: StudySettings, frames: int) -> int:
    return round(frames * (1 - s.dataset.validation - s.dataset.test))


def _check_training(job: Job, seen: int, labels: set[str]) -> None:
    s = job.settings
    stride = 2**s.model.depth
    if s.training.crop < stride:
        raise ConfigurationError(
            f"training.crop={s.training.crop}: at least 2^model.depth = {stride} for variant {job.label}"
        )
    if s.training.batch_size > seen:
        raise ConfigurationError(f"training.batch_size={s.training.batch_size}: more than the {seen} training frames")
    for key, device in (("training", s.training.device), ("simulator", s.simulator.device)):
        if device.partition(":")[0] not in ("auto", "cpu", "cuda"):
            raise ConfigurationError(f"{key}.device={device}: allowed are cpu and cuda")
        if device.startswith("cuda") and not torch.cuda.is_available():
            raise ConfigurationError(f"{key}.device={device}: this machine has no usable GPU; allowed is cpu")
    known = {*labels, *variant_names(), *(path.name for path in s.study_dir.glob("*"))}
    if s.reference not in known:
        raise ConfigurationError(f"reference={s.reference}: allowed are {', '.join(sorted(known))}")
    if not re.fullmatch(r"[\w.+ -]+", s.study):
        raise ConfigurationError(f"study_name={s.study}: letters, digits, '.', '_', '+', '-' and spaces only")


def _check_metrics(s: StudySettings) -> None:
    """Names that exist, and for FID its network, which is fetched here if need be."""
    try:
        chosen = choose_metrics(s.metrics)
    except ValueError as error:
        raise ConfigurationError(str(error)) from error
    if not chosen.of_image:
        names = ", ".join(sorted(chosen.names))
        raise ConfigurationError(f"metrics={names}: name one that every image has too, such as psnr")
    where = s.evaluation.inception
    named = [name for name in FID_METRICS if name in ([s.metrics] if isinstance(s.metrics, str) else s.metrics)]
    if named and where is None:
        raise ConfigurationError(f"metrics={named[0]}: needs evaluation.inception=path/to/file or =download")
    if where is not None and s.task is Task.study and not chosen.of_set.isdisjoint(FID_METRICS):
        try:
            inception_file(where)
        except (ValueError, OSError) as error:
            raise ConfigurationError(f"evaluation.inception={where}: {error}") from error


def _check_writable(runs: Path) -> None:
    try:
        runs.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=runs):
            pass
    except OSError as error:
        raise ConfigurationError(f"runs_dir={runs} cannot be written: {os.strerror(error.errno or 0)}") from error
