"""Check jobs against the files, folders and devices that they need, before anything expensive starts."""

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

import torch

from ablate.anatomy import SiteGrid, fetal_sites, validate_scene_folder
from ablate.dataset import Part, read_poses, resample_grid
from ablate.jobs.compose import variant_model
from ablate.metrics import METRICS, FeatureKind, choose_metrics, inception_file, needs_inception
from ablate.networks import Attenuation, Family, Position, Space, check_custom, conditions
from ablate.networks.spec import OF_POSITION, OF_SURFACES
from ablate.runs.data_set import checked_folder
from ablate.runs.job import Job, not_shared
from ablate.runs.place import check_place
from ablate.setting import shown
from ablate.settings.conf import variant_names
from ablate.settings.study import ConfigurationError, SceneKind, StudySettings, Task, refusing
from ablate.training import TrainingPrecision
from ablate.training.settings import SMALLEST_CROP
from ablate.ultrasound.settings import SimulatorSettings, TimeGain

_NEED_SCENE = (Task.preview, Task.render, Task.view, Task.precision)


def check(jobs: Sequence[Job], elsewhere: bool = False) -> None:
    """Check every job; a ConfigurationError is one line that names the key or file and what is allowed.

    Jobs that run `elsewhere`, on the nodes of a cluster, must be known by the same hash here and there.
    """
    task, results = jobs[0].settings.task, jobs[0].settings.results
    _check_place_of_runs(jobs[0].settings)
    for job in jobs:
        if elsewhere and task is Task.study and job.settings.training.precision is TrainingPrecision.auto:
            differ = "it may be another on the node that runs the job than here"
            raise ConfigurationError(f"training.precision=auto: {differ}; allowed on a cluster are fp32 and bf16")
        seen = _check_pairs(job) if job.settings.scene.kind is SceneKind.pairs else _check_scene(job.settings)
        _check_training(job, seen, {other.label for other in jobs})
        _check_metrics(job.settings)
    if odd := set(str(results)) & {"?", "%"}:  # they mean something else in the address of a database
        raise ConfigurationError(f"runs_dir={results}: allowed is a path without {' and '.join(odd)}")
    starts = task in (Task.study, Task.simulate)
    if starts or task in (*_NEED_SCENE, Task.export, Task.stability):
        _check_writable(results)
    if starts or task is Task.compare:
        waiting = {job.folder for job in jobs if starts and not (job.folder / "result.json").exists()}
        for folder in filter(Path.exists, {results, *(job.settings.study_dir for job in jobs), *waiting}):
            _check_writable(folder)
    if starts or task is Task.plan:
        _check_one_study(jobs)


def _check_one_study(jobs: Sequence[Job]) -> None:
    """Check each job against what lies in its place, and against the other jobs of its study."""
    first, of_study = dict[object, Job](), dict[object, Job]()
    for job in jobs:
        check_place(job)
        other = of_study.setdefault(job.settings.study_dir, job)
        labelled, preset = {*dict(other.changed), *dict(job.changed)}, (other.settings.preset, job.settings.preset)
        unlike = not_shared(other.semantic, job.semantic, labelled, preset)
        if unlike and job.settings.task is not Task.simulate:
            values = ", ".join(f"{key}: {there} there, {here} here" for key, there, here in unlike)
            raise ConfigurationError(f"{other.name} and {job.name} cannot be one study: {values}; make them equal")
        if (other := first.setdefault((job.settings.study_dir, job.hash), job)).folder != job.folder:
            keys = ", ".join(sorted({key for key, _ in {*job.changed} ^ {*other.changed}})) or "variant"
            raise ConfigurationError(f"{keys}: decides nothing here, {other.name} and {job.name} are the same run")


def _check_pairs(job: Job) -> int:
    """Check that a folder of pairs has all maps that the variant reads; returns its number of training frames."""
    s = job.settings
    if s.task in _NEED_SCENE:
        scenes = "allowed are scene=fetal and folder"
        raise ConfigurationError(f"task={s.task}: pairs made elsewhere have no scene; {scenes}")
    with refusing():
        checked = checked_folder(s)
    if s.model.attenuation is Attenuation.compensated:
        raise ConfigurationError(
            f"model.attenuation=compensated in variant {job.label}: pairs made elsewhere do not tell the time gain of "
            "their images; allowed are integral and none"
        )
    for key, allowed in () if checked.probe else (("space", Space.image), ("position", Position.none)):
        if (value := getattr(s.model, key)) != allowed:
            raise ConfigurationError(
                f"model.{key}={value} in variant {job.label}: needs {checked.folder / 'fan.yaml'}, the geometry of the "
                f"fan; allowed without it is {allowed}"
            )
    there = checked.maps | OF_POSITION
    for name in conditions(s.model):
        if name in OF_SURFACES:
            setting = "interfaces=echo" if name == "interfaces" else "attenuation=illumination"
            others = "none" if name == "interfaces" else "integral and none"
            why = "only a simulator makes this map; for pairs made elsewhere allowed are"
            raise ConfigurationError(f"model.{setting} in variant {job.label}: {why} {others}")
        if name not in there:
            others = ", ".join(v for v in variant_names() if there.issuperset(conditions(variant_model(v))))
            raise ConfigurationError(
                f"variant {job.label} reads {name}, but {checked.folder} has no folder {name}; "
                f"allowed are variants without it: {others}"
            )
    if checked.parts is not None:
        return int((checked.parts == Part.train).sum())
    return _training_frames(s, len(checked.names))


def _check_scene(s: StudySettings) -> int:
    """Check that there is a scene with probe sites; returns the number of training frames that they can give."""
    sites: SiteGrid | None = fetal_sites()
    of_render = s.pose or s.plane  # then the folder may do without sites
    given = s.simulator
    if given.tgc_db_cm_mhz != SimulatorSettings.tgc_db_cm_mhz and (given.tgc is TimeGain.patient or given.time_gain_db):
        raise ConfigurationError("simulator.tgc_db_cm_mhz: allowed with simulator.tgc=fixed and no time_gain_db")
    if s.scene.kind is SceneKind.folder:
        if not s.scene.folder:
            raise ConfigurationError("scene=folder needs scene.folder=path/to/folder")
        with refusing():
            sites = validate_scene_folder(Path(s.scene.folder)).sites
        if sites is None and not (s.dataset.poses or of_render):
            raise ConfigurationError(f"{s.scene.folder}/scene.yaml has no `sites`: where to put the probe")
    if of_render or s.task is Task.view:  # the grid and its frames do not matter
        return _training_frames(s, s.dataset.frames)
    if s.dataset.poses:
        with refusing():
            offered = len(read_poses(Path(s.dataset.poses))[0])
    else:
        assert sites is not None
        grid = resample_grid(sites, s.dataset.grid)
        offered = len(grid.heights_mm) * len(grid.angles_deg) * len(grid.tilts_deg) * len(grid.rolls_deg)
    return _training_frames(s, min(s.dataset.frames, offered))


def _training_frames(s: StudySettings, frames: int) -> int:
    return round(frames * (1 - s.dataset.validation - s.dataset.test))


def _check_training(job: Job, seen: int, labels: set[str]) -> None:
    s = job.settings
    stride = 2**s.model.depth
    if 0 < s.training.crop < stride:
        smallest = f"2^model.depth = {stride} for variant {job.label}"
        raise ConfigurationError(f"training.crop={s.training.crop}: at least {smallest}")
    if s.scene.kind is not SceneKind.pairs:
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
            check_custom(s.model, s.training.crop or SMALLEST_CROP)
    if s.training.batch_size > seen:
        raise ConfigurationError(f"training.batch_size={s.training.batch_size}: more than the {seen} training frames")
    for key, device in (("training", s.training.device), ("simulator", s.simulator.device)):
        if device.startswith("cuda") and not torch.cuda.is_available():
            raise ConfigurationError(f"{key}.device={device}: this machine has no usable GPU; allowed is cpu")
    known = {*labels, *variant_names(), *(path.parent.name for path in s.study_dir.glob("*/seed*"))}
    if s.reference not in known:
        raise ConfigurationError(f"reference={s.reference}: allowed are {', '.join(sorted(known))}")


def _check_metrics(s: StudySettings) -> None:
    """Check the names of metrics, and get the network of FID, which may be downloaded here."""
    with refusing():
        chosen = choose_metrics(s.metrics)
    if not any(metric.of_image or metric.of_draws for metric in chosen.values()):
        raise ConfigurationError(f"metrics={', '.join(sorted(chosen))}: name one that every image has too, as psnr")
    scores = [f"{part}/{name}" for part in ("val", "test") for name in chosen]
    if s.objective is not None and s.objective not in scores:
        raise ConfigurationError(f"objective={s.objective}: allowed are {', '.join(scores)}")
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
