"""One job: train a variant, score it on unseen frames, log it; resumed where it stopped, never repeated."""

from __future__ import annotations

import logging
import time

import numpy as np
import torch
from filelock import FileLock
from torch import Tensor

from ablate.dataset import (
    CropLoader,
    Crops,
    CropSettings,
    Part,
    end_with_parent,
    equally_spaced,
    label_values,
    network_inputs,
)
from ablate.metrics import psnr
from ablate.networks import Generator, conditions, count_discriminator, count_generator
from ablate.studies.data import Data, dataset_folder, maps_needed, prepare_data
from ablate.studies.evaluate import Render
from ablate.studies.identity import claim_place, config_hash, finished, read_result, with_earlier_metrics, write_json
from ablate.studies.scores import Scores, score
from ablate.studies.sweep import Job
from ablate.studies.tracked import log_samples, logged, open_child, open_tracking
from ablate.tracking import RunLog, Status
from ablate.training import Precision, Validation, generate, median_ms_per_frame, train

_VALIDATION_FRAMES = 8


def run_job(job: Job) -> None:
    """Train, evaluate and log one job; a finished one returns at once.

    Raises
    ------
    Exception
        Whatever stopped the training; the run is marked failed and its last checkpoint kept.
    """
    if finished(job) is not None:
        return
    end_with_parent()
    job.folder.mkdir(parents=True, exist_ok=True)
    with FileLock(job.folder / ".lock"):  # another call of the same command may be at it
        if finished(job) is None:
            _run(job)


def _run(job: Job) -> None:
    logging.basicConfig(format=f"{job.name}: %(message)s", force=True)
    logging.getLogger("ablate").setLevel(logging.INFO)
    claim_place(job)
    data = prepare_data(job.settings, maps_needed([job.settings.model]))
    store, parent = open_tracking(job.settings)
    run = open_child(job, store, parent, len(data.pairs))
    started = time.perf_counter()
    try:
        scalars, notes = _train_and_score(job, data, run)
    except BaseException as error:
        stopped = isinstance(error, KeyboardInterrupt | InterruptedError | SystemExit)
        run.end(Status.killed if stopped else Status.failed)
        raise
    run.end(Status.finished)
    before = read_result(job.folder, config_hash(job.settings))
    if before is not None:  # trained by an earlier call; now scored by more metrics
        scalars = before["scalars"] | {k: v for k, v in scalars.items() if k.startswith(("val/", "test/"))}
    elif scalars["train/resumed_at"] == 0:
        scalars["seconds"] = time.perf_counter() - started  # from which task=plan tells how long another will take
    result = {"hash": config_hash(job.settings), "label": job.label, "seed": job.settings.seed}
    where = {"data": dataset_folder(job.settings).name, "mlflow_run_id": run.run_id}
    asked = with_earlier_metrics(job)
    scored = {"metrics": asked.metrics, "inception": asked.evaluation.inception}
    # The last word: all is done.
    write_json(job.folder / "result.json", {**result, **where, **scored, "notes": notes, "scalars": scalars})


def _train_and_score(job: Job, data: Data, run: RunLog) -> tuple[dict[str, float], tuple[str, ...]]:
    """Everything a job is for; returns the scalars of its result, and what was left out of it."""
    s = job.settings
    started = time.perf_counter()
    values = label_values(data.tissues, s.encoding, s.encoding_seed)
    settings = CropSettings(s.training.crop, s.training.batch_size, s.crops.fan_fraction, s.crops.flip, s.seed)
    crops = Crops(data.pairs, data.pairs.frames(Part.train), frozenset(conditions(s.model)), values, settings)
    trained = train(
        s.model,
        s.training,
        lambda start, stop: CropLoader(crops, start, stop, s.crops.workers),
        job.folder,
        sink=run.metrics,
        validation=_validation(job, data, values, run),
        epoch=len(data.pairs.frames(Part.train)) // s.training.batch_size,
    )
    costs = {"train/resumed_at": float(trained.resumed_at)}
    if trained.resumed_at == 0:
        costs["train/seconds"] = time.perf_counter() - started
    render = renderer(trained.generator, data, values, s.training.precision)
    scores = score(with_earlier_metrics(job), data, render)
    maps = _inputs(trained.generator, data, data.pairs.frames(Part.test)[:1], values)
    milliseconds = median_ms_per_frame(trained.generator, maps, s.training.precision, s.evaluation.timed_frames)
    return _write(job, data, scores, render, {**costs, "ms_per_frame": milliseconds}, run), scores.notes


def _validation(job: Job, data: Data, values: np.ndarray, run: RunLog) -> Validation:
    """PSNR in the fan over a few validation frames, for the curve; presets are chosen on it. Some of them are shown."""
    frames = equally_spaced(data.pairs.frames(Part.validation), _VALIDATION_FRAMES)
    targets, mask = data.pairs.read("high", frames), data.pairs.mask()

    def validate(generator: Generator, images_seen: int) -> dict[str, float]:
        images = renderer(generator, data, values, job.settings.training.precision)(frames, 0)
        log_samples(run, frames, images, targets, images_seen)
        scores = [psnr(image, target, mask) for image, target in zip(images, targets, strict=True)]
        return {"val/psnr_fan_curve": float(np.mean(scores))}

    return validate


def _inputs(generator: Generator, data: Data, frames: np.ndarray, values: np.ndarray) -> dict[str, Tensor]:
    """The maps of some frames that a generator reads, (k, 1, H, W) float32 each."""
    maps = {name: data.pairs.read(name, frames) for name in conditions(generator.spec)}
    return network_inputs(maps, values, data.pairs.mask())


def renderer(generator: Generator, data: Data, values: np.ndarray, precision: Precision) -> Render:
    """Frames of a data set through a trained generator; a frame's noise depends on its number and the draw."""
    mask = torch.from_numpy(data.pairs.mask())

    def render(frames: np.ndarray, draw: int) -> np.ndarray:
        maps = _inputs(generator, data, frames, values)
        seeds = torch.from_numpy(np.asarray(frames, np.int64)) * 1_000_003 + draw
        return generate(generator, maps, mask, seeds, precision)

    return render


def _write(
    job: Job,
    data: Data,
    scores: Scores,
    render: Render,
    costs: dict[str, float],
    run: RunLog,
) -> dict[str, float]:
    """Per-image values and pictures on disk, scalars in the run."""
    s = job.settings
    scalars = {**costs, **scores.scalars}
    per_image = scores.per_image.assign(variant=job.label, seed=s.seed)
    per_image.to_parquet(job.folder / "per_image.parquet")
    shown = equally_spaced(data.pairs.frames(Part.test), s.evaluation.pictures)  # the same for every variant
    np.savez_compressed(job.folder / "pictures.npz", frames=shown, images=render(shown, 0))
    scalars["parameters_generator"] = float(count_generator(s.model))
    scalars["parameters_discriminator"] = float(count_discriminator(s.model))
    run.metrics(logged(scalars))  # at step 0: MLflow draws bars, not curves
    run.artifact(job.folder / "per_image.parquet")
    return scalars
