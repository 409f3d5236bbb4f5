"""One job: train a variant, score it on unseen frames, log it; resumed where it stopped, never repeated."""

from __future__ import annotations

import logging
import time
from dataclasses import replace

import numpy as np
import pandas as pd
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
from ablate.networks import Generator, conditions, count_discriminator, count_generator, draws_noise
from ablate.studies.data import Data, dataset_folder, maps_needed, prepare_data
from ablate.studies.evaluate import Evaluation, Render, evaluate, resimulated
from ablate.studies.identity import claim_place, config_hash, finished, write_json
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
        scalars = _train_and_score(job, data, run)
    except BaseException as error:
        stopped = isinstance(error, KeyboardInterrupt | InterruptedError | SystemExit)
        run.end(Status.killed if stopped else Status.failed)
        raise
    run.end(Status.finished)
    if scalars["train/resumed_at"] == 0:
        scalars["seconds"] = time.perf_counter() - started  # from which task=plan tells how long another will take
    result = {"hash": config_hash(job.settings), "label": job.label, "seed": job.settings.seed}
    where = {"data": dataset_folder(job.settings).name, "mlflow_run_id": run.run_id}
    write_json(job.folder / "result.json", {**result, **where, "scalars": scalars})  # the last word: all is done


def _train_and_score(job: Job, data: Data, run: RunLog) -> dict[str, float]:
    """Everything a job is for; returns the scalars of its result."""
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
    )
    costs = {"train/resumed_at": float(trained.resumed_at)}
    if trained.resumed_at == 0:
        costs["train/seconds"] = time.perf_counter() - started
    render = renderer(trained.generator, data, values, s.training.precision)
    scores = {part: _score(job, data, part, render) for part in (Part.validation, Part.test)}
    floors = {part: floor(data, job, part) for part in scores if "high_again" in data.pairs.maps}
    maps = _inputs(trained.generator, data, data.pairs.frames(Part.test)[:1], values)
    milliseconds = median_ms_per_frame(trained.generator, maps, s.training.precision, s.evaluation.timed_frames)
    return _write(job, data, scores, floors, render, {**costs, "ms_per_frame": milliseconds}, run)


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


def floor(data: Data, job: Job, part: Part) -> Evaluation:
    """Scores of the frames simulated again with other scatterers."""
    settings = replace(job.settings.evaluation, noise_draws=2)
    return evaluate(data.pairs, part, data.tissues, job.settings.probe, resimulated(data.pairs), settings, True)


def _score(job: Job, data: Data, part: Part, render: Render) -> Evaluation:
    s = job.settings
    return evaluate(data.pairs, part, data.tissues, s.probe, render, s.evaluation, draws_noise(s.model))


def _write(
    job: Job,
    data: Data,
    scores: dict[Part, Evaluation],
    floors: dict[Part, Evaluation],
    render: Render,
    costs: dict[str, float],
    run: RunLog,
) -> dict[str, float]:
    """Per-image values and pictures on disk, scalars in the run."""
    s = job.settings
    tables = []
    scalars = dict(costs)
    for part, prefix in ((Part.validation, "val"), (Part.test, "test")):
        for source, mark, scored in (("model", "", scores), ("floor", "floor_", floors)):
            if part in scored:
                tables.append(scored[part].per_image.assign(source=source, split=part.name))
                scalars |= {f"{prefix}/{mark}{k}": v for k, v in scored[part].scalars.items()}
    per_image = pd.concat(tables, ignore_index=True).assign(variant=job.label, seed=s.seed)
    per_image.to_parquet(job.folder / "per_image.parquet")
    shown = equally_spaced(data.pairs.frames(Part.test), s.evaluation.pictures)  # the same for every variant
    np.savez_compressed(job.folder / "pictures.npz", frames=shown, images=render(shown, 0))
    scalars["parameters_generator"] = float(count_generator(s.model))
    scalars["parameters_discriminator"] = float(count_discriminator(s.model))
    run.metrics(logged(scalars))  # at step 0: MLflow draws bars, not curves
    run.artifact(job.folder / "per_image.parquet")
    return scalars
