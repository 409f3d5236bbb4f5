"""Check jobs against the files, folders and devices that they need, before anything expensive starts."""

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

import torch

from ablate.anatomy import load_tissues
from ablate.dataset import label_values
from ablate.metrics import METRICS, FeatureKind, choose_metrics, inception_file, needs_inception
from ablate.networks import Family, Space, check_custom
from ablate.setting import did_you_mean, shown
from ablate.settings.components import components, shown_file
from ablate.settings.conf import variant_names
from ablate.settings.study import ConfigurationError, StudySettings, Task, refusing
from ablate.sources.source import Source, source_of
from ablate.study.job import Job
from ablate.study.training import trainings_in
from ablate.training import TrainingPrecision
from ablate.training.settings import SMALLEST_CROP

_JUDGING = (Task.study, Task.simulate, Task.plan, Task.compare)
_NEED_SCENE = (Task.preview, Task.render, Task.view, Task.precision)


def check(jobs: Sequence[Job], elsewhere: bool = False) -> None:
    """Check every job; a ConfigurationError is one line that names the key or file and what is allowed.

    Jobs that run `elsewhere`, on the nodes of a cluster, must be known by the same hash here and there.
    """
    task, results = jobs[0].settings.task, jobs[0].settings.results
    _check_place_of_runs(jobs[0].settings)
    for job in jobs:
        settings = job.settings
        if elsewhere and task is Task.study and settings.training.precision is TrainingPrecision.auto:
            differ = "it may be another on the node that runs the job than here"
            raise ConfigurationError(f"training.precision=auto: {differ}; allowed on a cluster are fp32 and bf16")
        source = source_of(settings)
        if task in _NEED_SCENE and not source.has_scene:
            scenes = "allowed are scene=fetal and folder"
            raise ConfigurationError(f"task={task}: pairs made elsewhere have no scene; {scenes}")
        _check_plane(settings, source)
        _check_training(job, source.check(job.label), {other.label for other in jobs}, source.has_scene)
        _check_metrics(settings)
    if task in _JUDGING:
        _check_components(jobs)
    odd = set(str(results)) & {"?", "%"}  # they mean something else in the address of a database
    if odd:
        raise ConfigurationError(f"runs_dir={results}: allowed is a path without {' and '.join(sorted(odd))}")
    starts = task in (Task.study, Task.simulate)
    if starts or task in (*_NEED_SCENE, Task.export, Task.stability):
        _check_writable(results)
    if starts or task is Task.compare:
        folders = {results, *(job.settings.study_dir for job in jobs)}
        if starts:
            folders |= {job.folder for job in jobs if not job.training.is_trained}
        for folder in filter(Path.exists, folders):
            _check_writable(folder)


def _check_plane(s: StudySettings, source: Source) -> None:
    """Refuse a plane that the scene has not. Of a folder, what `task=view` can start from is known when it is read."""
    if s.plane is None:
        return
    planes = source.planes()
    if not planes and s.task is Task.render:
        allowed = "allowed are pose and frame"
        raise ConfigurationError(f"plane={s.plane}: scene={s.scene.kind} has no planes; {allowed}")
    if planes and s.plane not in planes:
        hint = did_you_mean(s.plane, planes)
        raise ConfigurationError(f"plane={s.plane}: allowed are {', '.join(planes)}{hint}")


def _check_training(job: Job, seen: int, labels: set[str], has_scene: bool) -> None:
    s = job.settings
    stride = 2**s.model.depth
    if 0 < s.training.crop < stride:
        smallest = f"2^model.depth = {stride} for variant {job.label}"
        raise ConfigurationError(f"training.crop={s.training.crop}: at least {smallest}")
    if has_scene:
        beam = s.model.space is Space.beam
        height, width = s.simulator.beam_shape if beam else s.simulator.image_shape
        most = max(-(-max(height, width) // stride) * stride, SMALLEST_CROP)
        if s.task is Task.study and s.training.crop == 0 and min(height, width) < SMALLEST_CROP:
            allowed = f"allowed are at least {SMALLEST_CROP} x {SMALLEST_CROP}"
            raise ConfigurationError(f"training.crop=0: whole frames are {height} x {width}; {allowed}")
        if s.training.crop > most:
            covers = f"which covers a frame of {height} x {width}"
            raise ConfigurationError(f"training.crop={s.training.crop}: at most {most}, {covers}")
    if s.model.family is Family.custom:
        with refusing("model."):
            numbers_a_label = label_values(tuple(load_tissues().values()), s.encoding).shape[1]
            check_custom(s.model, s.training.crop or SMALLEST_CROP, numbers_a_label)
    if s.training.batch_size > seen:
        raise ConfigurationError(f"training.batch_size={s.training.batch_size}: more than the {seen} training frames")
    for key, device in (("training", s.training.device), ("simulator", s.simulator.device)):
        if device.startswith("cuda") and not torch.cuda.is_available():
            raise ConfigurationError(f"{key}.device={device}: this machine has no usable GPU; allowed is cpu")
    known = {*labels, *variant_names(), *(str(t.about.get("label")) for t in trainings_in(s.study_dir))}
    if s.reference not in known:
        hint = did_you_mean(s.reference, known)
        raise ConfigurationError(f"reference={s.reference}: allowed are {', '.join(sorted(known))}{hint}")


def _check_components(jobs: Sequence[Job]) -> None:
    """Check the metrics that judge components: those of a user's are known where the command names them."""
    known = {*METRICS, *(name for job in jobs for name in choose_metrics(job.settings.metrics))}
    for component in components():
        if component.metric is not None and component.metric not in known:
            allowed = f"allowed are {', '.join(METRICS)}, and one of yours that metrics= names"
            hint = did_you_mean(component.metric, known)
            raise ConfigurationError(f"{shown_file(component.name)}: metric={component.metric}: {allowed}{hint}")


def _check_metrics(s: StudySettings) -> None:
    """Check the names of metrics, and get the network of FID, which may be downloaded here."""
    with refusing():
        chosen = choose_metrics(s.metrics)
    if not any(metric.of_image or metric.of_draws for metric in chosen.values()):
        raise ConfigurationError(f"metrics={', '.join(sorted(chosen))}: name one that every image has too, as psnr")
    scores = [f"{part}/{name}" for part in ("val", "test") for name in chosen]
    if s.objective is not None and s.objective not in scores:
        hint = did_you_mean(s.objective, scores)
        raise ConfigurationError(f"objective={s.objective}: allowed are {', '.join(scores)}{hint}")
    where = s.evaluation.inception
    asked = [s.metrics] if isinstance(s.metrics, str) else s.metrics
    named = [name for name, metric in METRICS.items() if metric.uses(FeatureKind.inception) and name in asked]
    if named and where is None:
        raise ConfigurationError(f"metrics={named[0]}: needs evaluation.inception=path/to/file or =download")
    if where is not None and needs_inception(chosen) and (s.task is Task.study or where != "download"):
        with refusing(f"evaluation.inception={where}: "):
            inception_file(where)


def _check_place_of_runs(s: StudySettings) -> None:
    """Refuse a `runs_dir` that can hold no folder, whatever the task."""
    try:
        if s.results.exists() and not s.results.is_dir():
            raise ConfigurationError(f"runs_dir: {shown(str(s.results))} is a file; allowed is a folder")
        s.study_dir.exists()
    except OSError as error:
        raise ConfigurationError(f"runs_dir={shown(s.runs_dir)}: {os.strerror(error.errno or 0)}") from error


def _check_writable(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise ConfigurationError(f"runs_dir: {folder} cannot be written: {os.strerror(error.errno or 0)}") from error
    for file in (*folder.glob(".*lock"), folder / "mlflow.db"):
        if file.exists() and not os.access(file, os.W_OK):
            share = "docs/cluster.md says how a group shares a folder"
            raise ConfigurationError(f"runs_dir: {file} belongs to {_owner(file)}, and you may not write it; {share}")


def _owner(file: Path) -> str:
    try:
        return file.owner()
    except (KeyError, NotImplementedError):  # a number without a name, or Windows
        return f"user {file.stat().st_uid}"
