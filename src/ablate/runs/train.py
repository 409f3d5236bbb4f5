"""Run one job: train a variant, score it on unseen frames, log it. A stopped job resumes, a finished one is skipped.

What a run was made with is written at each start, as a stopped run may go on with other code.
"""

import logging
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
import torch

from ablate import dataset, tracking
from ablate.dataset import CropLoader, Crops, CropSettings, Part
from ablate.evaluation import Scorer, score_run
from ablate.metrics import METRICS_VERSION, choose_metrics, inception_file, load_inception, needs_inception
from ablate.metrics.features import CENTRE
from ablate.networks import Generator, conditions, draws_noise
from ablate.runs.data_set import DataSet, maps_needed
from ablate.runs.job import Job, parameters, precision_of
from ablate.runs.place import claim_place, finished_run, names_of, sources_of, unfinish, with_earlier_metrics
from ablate.runs.prepare import prepare_data
from ablate.runs.run import Run, State
from ablate.runs.store_copy import copying, log_samples
from ablate.setting import plain
from ablate.settings.study import ConfigurationError, Provenance, StudySettings, Verbosity
from ablate.storage import digest, remove_partial, write_json, write_text, written_whole
from ablate.threads import torch_threads
from ablate.tracking import LocalLog
from ablate.training import Validation, chosen_device, generated_images, read_checkpoint, train
from ablate.user_code import source_digest

_LOG = logging.getLogger(__name__)
_OF_ONE_START = ("time", "step", "device", "precision", "git_diff", "source")  # not in `made_with.json`
_VALIDATION_FRAMES = 16
# Metrics of the validation curves; MLflow's comparison of runs shows the first.
_CURVES = ("psnr_fan", "mae_smooth", "pchi2_tissue", "shadow_contrast", "noise_sd", "crps", "fd_speckle")


def run_job(job: Job) -> None:
    """Train, evaluate and log one job; a finished one returns at once.

    Whatever stops the training is raised; the run is then marked failed, and its last checkpoint kept.
    """
    if finished_run(job) is not None:
        return
    job.folder.mkdir(parents=True, exist_ok=True)
    with job.run.lock():  # another process may be running the same job
        if finished_run(job) is None:
            if (target := job.settings.model.target) and source_digest(target) != job.semantic["model"]["source"]:
                raise ConfigurationError(f"model.target={target}: edited since the sweep began; repeat the command")
            claim_place(job)
            with logged(job), torch_threads(job.settings.training.threads):
                _run(job)


def _run(job: Job) -> None:
    data = prepare_data(job, maps_needed([job.settings.model]))
    _LOG.info("%d frames of %s", len(data.pairs), data.name)
    write_provenance(job)
    run, log = job.run, LocalLog(job.folder)  # curves, images and states as the training goes on
    with copying(job.settings, run, log):
        clock, started = time.perf_counter(), _now()
        for file in (run.scores_file, run.pictures_file, run.folder / "result.json"):
            remove_partial(file)
        there = run.result if run.result.get("hash") == job.hash and run.state is not State.unusable else {}
        if not run.checkpoint.exists():  # perhaps removed, to train again: its result tells nothing of that
            unfinish(run, hash="")
        scalars, notes = _train_and_score(job, run, data, log)
        first_scored = _now()
        before = there if scalars["train/resumed_at"] >= job.settings.training.steps else {}
        if before:  # trained by an earlier call; now scored by more metrics, or by another version of them
            scores = {k: v for k, v in scalars.items() if k.startswith(("val/", "test/"))}
            scalars = {k: v for k, v in before["scalars"].items() if not k.startswith(("val/", "test/"))} | scores
            started, first_scored = before.get("started", started), before.get("first_scored", first_scored)
        elif scalars["train/resumed_at"] == 0:
            scalars["seconds"] = time.perf_counter() - clock  # task=plan estimates the time of other jobs from it
        elif run.starts:
            started = str(run.starts[0].get("time", started))
        asked = with_earlier_metrics(job)
        if lost := names_of(there.get("metrics", ())) - names_of(asked.metrics):
            _LOG.warning("values of %s are no longer kept: name them in metrics= too", ", ".join(sorted(lost)))
        result = {
            **{"hash": job.hash, "label": job.label, "seed": job.settings.seed},
            **{"data": data.name, "pixels": data.pixels},
            **{"started": started, "ended": _now(), "first_scored": first_scored},
            **{"metrics": asked.metrics, "sources": sources_of(asked.metrics), "metrics_version": METRICS_VERSION},
            **{"inception": asked.evaluation.inception, "notes": list(notes), "scalars": scalars},
        }
        write_json(run.folder / "result.json", result)  # last of all, because a run that has it is finished
        _LOG.info("finished")


@contextmanager
def logged(job: Job) -> Iterator[None]:
    """Log what happens inside: on the terminal as `verbose` says, and in `log.txt` of the run with time and level."""
    terminal, file = logging.StreamHandler(), logging.FileHandler(job.folder / "log.txt", encoding="utf-8")
    file.handleError = lambda record: None  # type: ignore[method-assign]  # noqa: ARG005  # on a full disk
    terminal.setFormatter(logging.Formatter(f"{job.name}: %(message)s"))
    file.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    terminal.setLevel(logging.WARNING if job.settings.verbose is Verbosity.quiet else logging.DEBUG)
    terminal.addFilter(lambda record: not getattr(record, "in_bar", False))
    of_all = logging.INFO if job.settings.verbose is Verbosity.debug else logging.WARNING
    logging.basicConfig(handlers=[terminal, file], level=of_all, force=True)
    logging.getLogger("ablate").setLevel(logging.INFO)
    try:
        yield
    except BaseException as error:  # told on the terminal by what called this
        why = type(error).__name__, " ".join(str(error).split())
        file.handle(_LOG.makeRecord(__name__, logging.ERROR, "", 0, "stopped by %s: %s", why, None))
        raise
    finally:
        logging.getLogger().removeHandler(file)
        file.close()


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
    starts = [*job.run.starts, {"time": _now(), **now}]
    if step == 0 and any("metrics" in line for line in tracking.read_log(job.folder)[0]):
        _LOG.warning("training begins again at step 0; curves and pictures of the earlier start stay as they are")
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


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def _train_and_score(job: Job, run: Run, data: DataSet, log: LocalLog) -> tuple[dict[str, float], tuple[str, ...]]:
    """Train and score a job, write and log the scores; returns its scalars and notes on what was left out."""
    s, pairs = job.settings, data.pairs
    started = time.perf_counter()
    values = dataset.label_values(data.tissues, s.encoding, s.label_seed)
    spec, labels, cut = s.model, values.shape[1], s.crops
    settings = CropSettings(s.training.crop, s.training.batch_size, cut.fan_fraction, cut.flip, s.seed, spec.space)
    crops = Crops(pairs, pairs.frames(Part.train), frozenset(conditions(spec)), values, settings)
    trained = train(
        spec,
        s.training,
        lambda start, stop: CropLoader(crops, start, stop, s.crops.workers),
        run.folder,
        sink=log.metrics,
        validation=_validation(s, data, values, log),
        labels=labels,
    )
    costs = {"train/resumed_at": float(trained.resumed_at)}
    if trained.resumed_at == 0:
        costs["train/seconds"] = time.perf_counter() - started
    render = generated_images(trained.generator, pairs, values, s.training.precision)
    scores = score_run(scorer(with_earlier_metrics(job), data), render, draws_noise(s.model))
    scalars = {**costs, **scores.scalars, **parameters(s, spec, labels)}
    unfinish(run)
    with written_whole(run.scores_file) as partial:
        scores.per_image.assign(variant=job.label, seed=s.seed).to_parquet(partial)
    shown = dataset.equally_spaced(pairs.frames(Part.test), s.evaluation.pictures)  # the same for every variant
    images = render(shown, 0)
    with written_whole(run.pictures_file) as partial:
        np.savez_compressed(partial, frames=shown, images=images)
    return scalars, (*scores.notes, *dataset.alike_labels(data.tissues, values))


def scorer(settings: StudySettings, data: DataSet) -> Scorer:
    """The scorer that evaluates runs with these settings."""
    metrics, weights, inception = choose_metrics(settings.metrics), settings.evaluation.inception, None
    if weights is not None and min(data.pairs.shape) >= CENTRE and needs_inception(metrics):
        inception = load_inception(inception_file(weights), str(chosen_device(settings.training.device)))
    probe = data.pairs.probe or settings.probe
    return Scorer(data.pairs, data.tissues, probe, settings.evaluation, metrics, inception)


def _validation(s: StudySettings, data: DataSet, values: np.ndarray, log: LocalLog) -> Validation:
    """A function that scores a few validation frames and logs them as images: the curves of a training."""
    frames = dataset.equally_spaced(data.pairs.frames(Part.validation), _VALIDATION_FRAMES)
    targets = data.pairs.read("target", frames)
    of_curves = scorer(replace(s, metrics=_CURVES), data)

    def validate(generator: Generator, images_seen: int) -> dict[str, float]:
        render = generated_images(generator, data.pairs, values, s.training.precision)
        log_samples(log, frames, render(frames, 0), targets, images_seen)
        scalars = of_curves.score(Part.validation, render, draws_noise(s.model), frames).scalars
        return {f"val/{name}_curve": scalars[name] for name in _CURVES if name in scalars}

    return validate
