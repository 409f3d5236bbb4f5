"""Run one job: train a variant, score it on unseen frames, log it. A stopped job resumes, a finished one is skipped."""

import logging
import time
from contextlib import nullcontext

import numpy as np
import torch
from filelock import FileLock
from torch import Tensor

from ablate import dataset
from ablate.config import StudySettings
from ablate.dataset import CropLoader, Crops, CropSettings, Part
from ablate.evaluation import ImageSource, Scorer, inception_for, score_run
from ablate.metrics import METRICS_VERSION, choose_metrics
from ablate.networks import Generator, conditions, draws_noise
from ablate.storage import remove_partial, write_json, written_whole
from ablate.studies.copied import copying
from ablate.studies.identity import claim_place, config_hash, finished, with_earlier_metrics
from ablate.studies.jobs.describe import parameters
from ablate.studies.jobs.job import Job
from ablate.studies.made_with import write_provenance
from ablate.studies.pairs.data import Data, dataset_folder, maps_needed, prepare_data
from ablate.studies.result_file import read_result
from ablate.studies.tracked import log_samples
from ablate.tracking import LocalLog, system_metrics
from ablate.training import TrainingPrecision, Validation, chosen_device, generate, train

_VALIDATION_FRAMES = 16
# Metrics of the validation curves; MLflow's comparison of runs shows the first.
_CURVES = ("psnr_fan", "mae_smooth", "pchi2_tissue", "shadow_contrast", "noise_sd", "crps", "fd_speckle")


def run_job(job: Job) -> None:
    """Train, evaluate and log one job; a finished one returns at once.

    Whatever stops the training is raised; the run is then marked failed, and its last checkpoint kept.
    """
    if finished(job) is not None:
        return
    job.folder.mkdir(parents=True, exist_ok=True)
    with FileLock(job.folder / ".lock"):  # another process may be running the same job
        if finished(job) is None:
            _run(job)


def _run(job: Job) -> None:
    logging.basicConfig(format=f"{job.name}: %(message)s", force=True)
    logging.getLogger("ablate").setLevel(logging.INFO)
    claim_place(job)
    data = prepare_data(job.settings, maps_needed([job.settings.model]))
    write_provenance(job)
    log = LocalLog(job.folder)
    watch = system_metrics(job.folder, log) if job.settings.tracking.system_metrics else nullcontext()
    with copying(job.settings, job.folder, log), watch:
        _train_score_and_store(job, data, log)


def _train_score_and_store(job: Job, data: Data, log: LocalLog) -> None:
    started = time.perf_counter()
    for left in ("per_image.parquet", "pictures.npz", "result.json"):
        remove_partial(job.folder / left)
    scalars, notes = _train_and_score(job, data, log)
    before = read_result(job.folder, config_hash(job.settings))
    if before is not None:  # trained by an earlier call; now scored by more metrics, or by another version of them
        scores = {k: v for k, v in scalars.items() if k.startswith(("val/", "test/"))}
        scalars = {k: v for k, v in before["scalars"].items() if not k.startswith(("val/", "test/"))} | scores
    elif scalars["train/resumed_at"] == 0:
        scalars["seconds"] = time.perf_counter() - started  # task=plan estimates the time of other jobs from it
    result = {"hash": config_hash(job.settings), "label": job.label, "seed": job.settings.seed}
    result["data"] = dataset_folder(job.settings).name
    asked = with_earlier_metrics(job)
    scored = {"metrics": asked.metrics, "metrics_version": METRICS_VERSION, "inception": asked.evaluation.inception}
    # Written last: a run with this file is finished.
    write_json(job.folder / "result.json", {**result, **scored, "notes": notes, "scalars": scalars})


def _train_and_score(job: Job, data: Data, log: LocalLog) -> tuple[dict[str, float], tuple[str, ...]]:
    """Train and score a job, write and log the scores; returns its scalars and notes on what was left out."""
    s = job.settings
    started = time.perf_counter()
    values = dataset.label_values(data.tissues, s.encoding, s.encoding_seed)
    settings = CropSettings(s.training.crop, s.training.batch_size, s.crops.fan_fraction, s.crops.flip, s.seed)
    crops = Crops(data.pairs, data.pairs.frames(Part.train), frozenset(conditions(s.model)), values, settings)
    trained = train(
        s.model,
        s.training,
        lambda start, stop: CropLoader(crops, start, stop, s.crops.workers),
        job.folder,
        sink=log.metrics,
        validation=_validation(job, data, values, log),
        epoch=len(data.pairs.frames(Part.train)) // s.training.batch_size,
    )
    costs = {"train/resumed_at": float(trained.resumed_at)}
    if trained.resumed_at == 0:
        costs["train/seconds"] = time.perf_counter() - started
    render = generated_images(trained.generator, data, values, s.training.precision)
    scores = score_run(scorer(with_earlier_metrics(job), data), render, draws_noise(s.model))
    generator, discriminator = parameters(s)
    sizes = {"parameters_generator": float(generator), "parameters_discriminator": float(discriminator)}
    scalars = {**costs, **scores.scalars, **sizes}
    with written_whole(job.folder / "per_image.parquet") as partial:
        scores.per_image.assign(variant=job.label, seed=s.seed).to_parquet(partial)
    shown = dataset.equally_spaced(data.pairs.frames(Part.test), s.evaluation.pictures)  # the same for every variant
    images = render(shown, 0)
    with written_whole(job.folder / "pictures.npz") as partial:
        np.savez_compressed(partial, frames=shown, images=images)
    return scalars, scores.notes


def scorer(settings: StudySettings, data: Data) -> Scorer:
    """The scorer that evaluates runs with these settings."""
    metrics = choose_metrics(settings.metrics)
    device = str(chosen_device(settings.training.device))
    inception = inception_for(metrics, data.pairs.shape, settings.evaluation.inception, device)
    return Scorer(data.pairs, data.tissues, settings.probe, settings.evaluation, metrics, inception)


def _validation(job: Job, data: Data, values: np.ndarray, log: LocalLog) -> Validation:
    """A function that scores a few validation frames and logs them as images: the curves of a training."""
    s = job.settings
    frames = dataset.equally_spaced(data.pairs.frames(Part.validation), _VALIDATION_FRAMES)
    targets = data.pairs.read("target", frames)
    of_curves = Scorer(data.pairs, data.tissues, s.probe, s.evaluation, choose_metrics(list(_CURVES)))

    def validate(generator: Generator, images_seen: int) -> dict[str, float]:
        render = generated_images(generator, data, values, s.training.precision)
        log_samples(log, frames, render(frames, 0), targets, images_seen)
        found = of_curves.score(Part.validation, render, draws_noise(s.model), frames).scalars
        return {f"val/{name}_curve": found[name] for name in _CURVES if name in found}

    return validate


def _inputs(generator: Generator, data: Data, frames: np.ndarray, values: np.ndarray) -> dict[str, Tensor]:
    """The maps of some frames that a generator reads, (k, 1, H, W) float32 each."""
    maps = {name: data.pairs.read(name, frames) for name in conditions(generator.spec)}
    return dataset.network_inputs(maps, values, data.pairs.mask())


def generated_images(generator: Generator, data: Data, values: np.ndarray, precision: TrainingPrecision) -> ImageSource:
    """A function that renders frames of a data set with a generator; the noise depends on frame number and draw."""
    mask = torch.from_numpy(data.pairs.mask())

    def render(frames: np.ndarray, draw: int) -> np.ndarray:
        seeds = torch.from_numpy(dataset.noise_seeds(frames, draw))
        return generate(generator, _inputs(generator, data, frames, values), mask, seeds, precision)

    return render
