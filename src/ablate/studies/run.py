"""One job: train a variant, score it on unseen frames, log it; resumed where it stopped, never repeated."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pandas as pd
import torch

from ablate.dataset import Crops, CropSettings, Part, crop_loader, label_values
from ablate.networks import count_discriminator, count_generator, draws_noise
from ablate.studies.data import Data, maps_needed, prepare_data
from ablate.studies.evaluate import Evaluation, Render, evaluate, resimulated
from ablate.studies.identity import claim_place, config_hash, finished, write_json
from ablate.studies.sweep import Job
from ablate.studies.tracked import open_child, open_tracking
from ablate.tracking import RunLog, Status
from ablate.training import TrainedGenerator, generate, median_ms_per_frame, train


def run_job(job: Job) -> None:
    """Train, evaluate and log one job; a finished one returns at once.

    Raises
    ------
    Exception
        Whatever stopped the training; the run is marked failed and its last checkpoint kept.
    """
    if finished(job) is not None:
        return
    claim_place(job)
    data = prepare_data(job.settings, maps_needed([job.settings.model]))
    store, parent = open_tracking(job.settings)
    run = open_child(job, store, parent)
    try:
        _train_and_score(job, data, run)
    except BaseException as error:
        run.end(Status.killed if isinstance(error, KeyboardInterrupt) else Status.failed)
        raise
    run.end(Status.finished)


def _train_and_score(job: Job, data: Data, run: RunLog) -> None:
    s = job.settings
    started = time.perf_counter()
    values = label_values(data.tissues, s.encoding, s.encoding_seed)
    crops = Crops(
        data.pairs,
        data.pairs.frames(Part.train),
        maps_needed([s.model]),
        values,
        CropSettings(s.training.crop, s.training.batch_size, s.training.fan_fraction, s.training.flip, s.seed),
    )
    trained = train(
        s.model,
        s.training,
        lambda start, stop: crop_loader(crops, start, stop, s.training.workers),
        job.folder,
        seed=s.seed,
        name=job.name,
        log=run.metrics,
    )
    render = renderer(trained, data, values)
    scores = {part: _score(job, data, part, render) for part in (Part.validation, Part.test)}
    floors = {part: floor(data, job, part) for part in (Part.validation, Part.test)}
    _write(job, data, scores, floors, render, trained, time.perf_counter() - started, run)


def renderer(trained: TrainedGenerator, data: Data, values: np.ndarray) -> Render:
    """Frames of a data set through a trained generator; the noise of a frame depends on its number and the draw."""
    pairs = data.pairs
    mask = torch.from_numpy(pairs.mask())

    def render(frames: np.ndarray, draw: int) -> np.ndarray:
        images = []
        for frame in frames:
            inputs = {"segmentation": torch.from_numpy(values[pairs.read("segmentation", [frame])])[None]}
            if "attenuation" in trained.conditions:
                inputs["attenuation"] = torch.from_numpy(pairs.read("attenuation", [frame]))[None]
            if "low" in trained.conditions:
                low = torch.from_numpy(pairs.read("low", [frame])).float()[None] / 127.5 - 1
                inputs["low"] = torch.where(mask, low, -1.0)
            seed = torch.tensor([int(frame) * 1_000_003 + draw])
            images.append(generate(trained, inputs, mask, seed)[0])
        return np.stack(images)

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
    trained: TrainedGenerator,
    seconds: float,
    run: RunLog,
) -> None:
    s = job.settings
    tables = []
    for source, found in (("model", scores), ("floor", floors)):
        for part, evaluation in found.items():
            tables.append(evaluation.per_image.assign(source=source, split=part.name))
    per_image = pd.concat(tables, ignore_index=True).assign(variant=job.label, seed=s.seed)
    per_image.to_parquet(job.folder / "per_image.parquet")
    shown = picture_frames(data, s.evaluation.pictures)
    images = render(shown, 0)
    np.savez_compressed(job.folder / "pictures.npz", frames=shown, images=images)
    scalars: dict[str, float] = {}
    for part, prefix in ((Part.validation, "val"), (Part.test, "test")):
        scalars |= {f"{prefix}/{k}": v for k, v in scores[part].scalars.items()}
        scalars |= {f"{prefix}/floor_{k}": v for k, v in floors[part].scalars.items()}
    scalars["ms_per_frame"] = median_ms_per_frame(trained, data.pairs.shape, s.evaluation.timed_frames)
    scalars["parameters_generator"] = count_generator(s.model)
    scalars["parameters_discriminator"] = count_discriminator(s.model)
    run.metrics(scalars, step=s.training.steps * s.training.batch_size)
    run.artifact(job.folder / "per_image.parquet")
    write_json(
        job.folder / "result.json",
        {
            "hash": config_hash(s),
            "label": job.label,
            "seed": s.seed,
            "seconds": seconds,
            "scalars": scalars,
            "mlflow_run_id": run.run_id,
        },
    )


def picture_frames(data: Data, count: int) -> np.ndarray:
    """The test frames that every variant of a study shows, equally spaced."""
    test = data.pairs.frames(Part.test)
    return test[np.linspace(0, len(test) - 1, min(count, len(test))).round().astype(int)]
