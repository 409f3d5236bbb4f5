"""Do one job: train its network unless it is trained, and compute the scores that it asks for and that are missing.

A training that was stopped goes on where it was; nothing that is finished is repeated.
"""

import logging
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from ablate import dataset
from ablate.dataset import CropLoader, Crops, CropSettings, Part
from ablate.evaluation import ImageSource, Scorer, Scores, averaged, baselines, score_run
from ablate.metrics import choose_metrics, inception_file, load_inception, needs_inception
from ablate.metrics.features import CENTRE
from ablate.networks import Generator, Space, conditions, draws_noise
from ablate.settings.study import ConfigurationError, StudySettings, Verbosity
from ablate.sources.data_set import DataSet, maps_needed
from ablate.sources.prepare import prepare_data
from ablate.storage import held, remove_partial, written_whole
from ablate.study.job import Job, claim, parameters, refuse_lost_network
from ablate.study.log import LocalLog, Status
from ablate.study.provenance import end_provenance, write_provenance
from ablate.study.scores import ScoreKey, by_metric, wanted_scores, write_score
from ablate.study.training import Training
from ablate.threads import torch_threads
from ablate.training import TrainedGenerator, Validation, chosen_device, generated_images, train
from ablate.user_code import code_digest

_LOG = logging.getLogger(__name__)
_VALIDATION_FRAMES = 16
# Metrics of the validation curves; MLflow's comparison of runs shows the first.
_CURVES = ("psnr_fan", "mae_smooth", "pchi2_tissue", "shadow_contrast", "noise_sd", "crps", "fd_speckle")
_SAMPLES = 2  # validation frames shown through training
_SAMPLE_PX = 512  # larger frames are shrunk before they are logged: a training keeps a few dozen of them


def do(job: Job) -> None:
    """Train and score one job; one that is finished returns at once.

    Whatever stops it is raised; the last checkpoint and every score that was computed are kept.
    """
    if job.finished:
        return
    training = claim(job)
    with held(training.lock_file, f"trains and scores {job.name}"):
        if job.finished:
            return
        refuse_lost_network(job)
        target = job.settings.model.target
        if target and code_digest(target) != job.identity["model"]["source"]:
            raise ConfigurationError(f"model.target={target}: edited since the sweep began; repeat the command")
        with _logged(job, training.folder), torch_threads(job.settings.training.threads):
            _train_and_score(job, Training(training.folder))


def _train_and_score(job: Job, training: Training) -> None:
    settings = job.settings
    data = prepare_data(settings, job.data, job.identity["data"], maps_needed([settings.model]))
    _LOG.info("%d frames of %s", len(data.pairs), data.name)
    anew = not training.checkpoint.exists()
    if anew:  # and its result, if there is one, cannot be used
        training.begin_again()
        training = Training(training.folder)
    log = LocalLog(training.folder, anew)  # curves, images and states as the training goes on
    with _stated(log):
        began, clock = _now(), time.perf_counter()
        if not training.is_trained:
            write_provenance(job, training)
        values = dataset.label_values(data.tissues, settings.encoding, settings.label_seed)
        trained = _train(settings, training, data, values, log)
        render = generated_images(trained.generator, data.pairs, values, settings.training.precision)
        if not training.pictures_file.exists():
            _write_pictures(training, data, render, settings.evaluation.pictures)
        if not training.is_trained:
            scalars = {
                "train/resumed_at": float(trained.resumed_at),
                **parameters(settings, settings.model, values.shape[1]),
            }
            if trained.resumed_at == 0:
                scalars["train/seconds"] = time.perf_counter() - clock  # task=plan estimates other jobs from it
            training.write_result(
                {
                    "pixels": data.pixels,
                    "scalars": scalars,
                    "notes": [*dataset.alike_labels(data.tissues, values), *end_provenance(training)],
                    "started": training.starts[0].get("time", began),
                    "ended": _now(),
                }
            )
        wanted = wanted_scores(settings.metrics, settings.evaluation, data.pixels)
        lacking = training.lacking(wanted)
        if lacking:
            generators = (*trained.snapshots, trained.generator)
            scores = averaged([_scored(settings, data, generator, values, lacking) for generator in generators])
            for key, score in by_metric(scores, lacking).items():
                write_score(training.scores, key, score)
        _LOG.info("finished")


@contextmanager
def _stated(log: LocalLog) -> Iterator[None]:
    """Log when the work inside begins, and how it ends."""
    log.status(Status.running)
    try:
        yield
    except BaseException as error:
        stopped = isinstance(error, KeyboardInterrupt | InterruptedError | SystemExit)
        log.status(Status.killed if stopped else Status.failed)
        raise
    log.status(Status.finished)


@contextmanager
def _logged(job: Job, folder: Path) -> Iterator[None]:
    """Log what `ablate` says inside: on the terminal as `verbose` says, and in `log.txt` of the training.

    The handlers of the program around it stay, and none is left behind.
    """
    terminal = logging.StreamHandler()
    terminal.setFormatter(logging.Formatter(f"{job.name}: %(message)s"))
    terminal.setLevel(logging.WARNING if job.settings.verbose is Verbosity.quiet else logging.DEBUG)
    terminal.addFilter(lambda record: not getattr(record, "in_bar", False))
    file = logging.FileHandler(folder / "log.txt", encoding="utf-8")
    file.handleError = lambda record: None  # type: ignore[method-assign]  # noqa: ARG005  # on a full disk
    file.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    logger = logging.getLogger(None if job.settings.verbose is Verbosity.debug else "ablate")
    level = logger.level
    logger.setLevel(logging.INFO)
    for handler in (terminal, file):
        logger.addHandler(handler)
    try:
        yield
    except BaseException as error:  # told on the terminal by what called this
        arguments = (type(error).__name__, " ".join(str(error).split()))
        file.handle(_LOG.makeRecord(__name__, logging.ERROR, "", 0, "stopped by %s: %s", arguments, None))
        raise
    finally:
        for handler in (terminal, file):
            logger.removeHandler(handler)
        logger.setLevel(level)
        file.close()


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def _train(
    settings: StudySettings, training: Training, data: DataSet, values: np.ndarray, log: LocalLog
) -> TrainedGenerator:
    """Train, or read what is trained; `values` is what networks read for each label."""
    pairs, spec = data.pairs, settings.model
    cut = CropSettings(
        settings.training.crop,
        settings.training.batch_size,
        settings.crops.fan_fraction,
        settings.crops.flip,
        settings.seed,
        spec.space,
    )
    crops = Crops(pairs, pairs.frames(Part.train), frozenset(conditions(spec)), values, cut)
    return train(
        spec,
        settings.training,
        lambda start, stop: CropLoader(crops, start, stop, settings.crops.workers),
        training.folder,
        sink=log.metrics,
        validation=_validation(settings, data, values, log),
        labels=values.shape[1],
        title=training.name,
    )


def _write_pictures(training: Training, data: DataSet, render: ImageSource, count: int) -> None:
    """Keep some rendered test frames, the same for every variant."""
    shown = dataset.equally_spaced(data.pairs.frames(Part.test), count)
    remove_partial(training.pictures_file)
    with written_whole(training.pictures_file) as partial:
        np.savez_compressed(partial, frames=shown, images=render(shown, 0))


def _scored(
    settings: StudySettings, data: DataSet, generator: Generator, values: np.ndarray, asked: Sequence[ScoreKey]
) -> Scores:
    """Compute scores of a generator on the frames of a data set, and on those after motions."""
    asked_scorer = scorer(replace(settings, metrics=[key.asked for key in asked]), data)
    precision = settings.training.precision
    render = generated_images(generator, data.pairs, values, precision)
    render_moved = None
    if data.moved is not None:
        render_moved = generated_images(generator, data.moved.pairs, values, precision, data.moved.before)
    render_beam = None
    if settings.model.space is Space.beam:
        render_beam = generated_images(generator, data.pairs, values, precision, shown_in=Space.beam)
    return score_run(
        asked_scorer,
        render,
        draws_noise(settings.model),
        moved_images=render_moved,
        beam_images=render_beam,
        beside=baselines(asked_scorer, settings.model),
    )


def scorer(settings: StudySettings, data: DataSet) -> Scorer:
    """The scorer that evaluates a training with these settings."""
    metrics, weights, inception = choose_metrics(settings.metrics), settings.evaluation.inception, None
    if weights is not None and min(data.pairs.shape) >= CENTRE and needs_inception(metrics):
        inception = load_inception(inception_file(weights), str(chosen_device(settings.training.device)))
    probe = data.pairs.probe or settings.probe
    return Scorer(data.pairs, data.tissues, probe, settings.evaluation, metrics, inception, data.moved)


def _validation(settings: StudySettings, data: DataSet, values: np.ndarray, log: LocalLog) -> Validation:
    """A function that scores a few validation frames and logs them as images: the curves of a training."""
    frames = dataset.equally_spaced(data.pairs.frames(Part.validation), _VALIDATION_FRAMES)
    targets = data.pairs.read("target", frames)
    curve_scorer = scorer(replace(settings, metrics=_CURVES), data)

    def validate(generator: Generator, images_seen: int) -> dict[str, float]:
        render = generated_images(generator, data.pairs, values, settings.training.precision)
        log_samples(log, frames, render(frames, 0), targets, images_seen)
        scalars = curve_scorer.score(Part.validation, render, draws_noise(settings.model), frames).scalars
        return {f"val/{name}_curve": scalars[name] for name in _CURVES if name in scalars}

    return validate


def log_samples(log: LocalLog, frames: np.ndarray, images: np.ndarray, targets: np.ndarray, images_seen: int) -> None:
    """Log some validation frames, each rendered above its target: MLflow shows squares.

    Parameters
    ----------
    log : LocalLog
        Of the training.
    frames : (n,) int
        Numbers of the frames.
    images, targets : (n, H, W) uint8
        Rendered and simulated; larger ones are shrunk.
    images_seen : int
        By the generator so far.
    """
    step = -(-images.shape[1] // _SAMPLE_PX)
    height, width = (size // step * step for size in images.shape[1:])
    for k in range(0, len(frames), -(-len(frames) // _SAMPLES)):
        both = np.stack([images[k], targets[k]])[:, :height, :width]
        blocks = both.reshape(2 * height // step, step, width // step, step)
        log.image(f"frames/{frames[k]}", blocks.mean((1, 3)).round().astype(np.uint8), images_seen)
