"""Bring the tracking store up to date with the runs of a study on disk: the store is a copy, with texts, of them."""

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
from filelock import FileLock, Timeout

from ablate import tracking
from ablate.dataset.pairs import FORMATS
from ablate.metrics.metric import FLOOR_PREFIX, FRAME_TIME, is_bound
from ablate.networks.spec import GeneratorSpec
from ablate.runs.data_set import DataSet
from ablate.runs.run import Run, State, runs_of
from ablate.setting import flat
from ablate.settings.conf import build, components, components_of_networks, named_components
from ablate.settings.study import SceneKind, StudySettings
from ablate.storage import digest
from ablate.tracking import STATE, LocalLog, Status, Store, StoredRun

#: What is told of the code and the machine of a run.
ABOUT_CODE = ("git_commit", "git_dirty", "hardware", "threads")
#: Settings of a run that people sort and compare by, beside its components.
_SORTED_BY = (
    *("model.target", "model.width", "preset", "seed", "scene.anatomy_seed", "encoding"),
    *("dataset.frames", "dataset.split", "dataset.validation", "dataset.test"),
    *("simulator.rays", "simulator.layers", "simulator.scanlines", "simulator.image_shape"),
    *("training.steps", "training.batch_size", "training.crop", "training.learning_rate", "training.schedule"),
    *("training.reconstruction", "training.loss", "training.l1_weight", "training.ema_decay"),
)
_SAMPLES = 2  # validation frames shown through training
_SAMPLE_PX = 512  # larger frames are shrunk before they are logged: a run keeps a few dozen of them
_LOG = logging.getLogger(__name__)
_LOCK_S = 30.0
_DRAWN = frozenset({"target", "resimulation"})  # the other maps of a data set are what networks read


def open_store(settings: StudySettings) -> Store:
    """The tracking store that the settings name."""
    return tracking.open_store(settings.results, settings.tracking.uri, settings.tracking.experiment)


def open_tracking(settings: StudySettings) -> StoredRun:
    """The study's parent run; it and the store are created when they are missing."""
    store = open_store(settings)
    run = StoredRun(store, tracking.parent_run(store, settings.study))
    run.parameters({"scene": settings.scene_name})
    return run


def mark_study(settings: StudySettings, status: Status) -> None:
    """Say in the store that a study runs, or how it has ended; waits 5 s at most."""
    tracking.Background(lambda: open_tracking(settings).mark(status)).close()


@contextmanager
def copying(settings: StudySettings, run: Run, log: LocalLog) -> Iterator[None]:
    """Copy a run to the store while it is trained inside; what the store does not take is left for `copy_study`."""
    log.status(Status.running)
    copy = _Copy(settings, run)
    background = tracking.Background(copy.curves)
    try:
        yield
    except BaseException as error:
        stopped = isinstance(error, KeyboardInterrupt | InterruptedError | SystemExit)
        log.status(Status.killed if stopped else Status.failed)
        raise
    else:
        log.status(Status.finished)
    finally:
        background.close(copy.everything)


def copy_study(settings: StudySettings) -> tuple[StoredRun, dict[str, str]]:
    """Copy what the store lacks of all runs and tasks of a study; gives its parent run, and the runs' ids by name.

    A run that another process trains is left to that process. A store that cannot be used is one of
    `tracking.UNAVAILABLE`.
    """
    parent = open_tracking(settings)
    stored = tracking.child_runs(parent.store, parent.run_id)
    ids: dict[str, str] = {}
    for run in runs_of(settings.study_dir):
        run_id, tags = stored.get((run.label, run.hash), ("", {}))
        if run.spec and tags.get(STATE) != run.copied_state():
            try:
                with run.lock(timeout=0):
                    run_id = _Copy(settings, run).everything()
            except Timeout:
                pass  # another process trains it
            except tracking.RunDeletedError as error:
                _LOG.warning("%s", error)
            except (KeyError, TypeError, AttributeError, ValueError) as error:
                _LOG.warning("%s: not copied to the tracking store, %s is not as runs are now", run.folder, error)
        if run_id:
            ids[run.name] = run_id
    tracking.copy_tasks(parent.store, settings.results, settings.study)
    return parent, ids


class _Copy:
    """The copy of one run. Whatever is raised, the next call begins with what the store has by then."""

    def __init__(self, settings: StudySettings, run: Run) -> None:
        self.settings, self.folder = settings, run.folder
        self._stored: StoredRun | None = None

    def curves(self) -> StoredRun:
        """Copy what is new in the log."""
        stored, self._stored = self._stored, None
        with FileLock(self.folder / ".copy.lock", timeout=_LOCK_S):
            stored = stored or _opened(self.settings, Run(self.folder))
            stored.copy_log(self.folder)
        self._stored = stored
        return stored

    def everything(self) -> str:
        """Copy the log and, where the run has ended, its scores and state; returns its id."""
        run = Run(self.folder)  # as it is now
        state = run.copied_state()
        stored = self.curves()
        changes = [line for line in tracking.read_log(self.folder)[0] if "status" in line]
        changed_ms = changes[-1]["time"] if changes else None
        ended = Status(changes[-1]["status"]) if changes else Status.killed
        ended = Status.killed if ended is Status.running else ended  # the process itself was killed
        if run.state is State.finished:
            ended = Status.finished
            stored.scores(logged(run.result["scalars"]), changed_ms, stored.model(run.label), whole=True)
            stored.artifact(run.scores_file)
            stored.copy_newest(self.folder)
        stored.mark(ended, changed_ms)
        stored.tags({STATE: state})
        return stored.run_id


def _opened(settings: StudySettings, run: Run) -> StoredRun:
    """The stored run of a folder, with parameters, tags, provenance and data set."""
    parent = open_tracking(settings)
    label, of_run, store = run.label, run.spec["settings"], parent.store
    data = digest(run.spec["semantic"]["data"])
    tags = {"variant": label, "seed": str(of_run["seed"]), "study": settings.study, "data_hash": data}
    started = next((line["time"] for line in tracking.read_log(run.folder)[0]), None)
    stored = StoredRun(store, tracking.child_run(store, parent.run_id, run.name, run.hash, tags, started))
    stored.mark(Status.running)
    again, begun = "", stored.tag("begun") or str(started)
    if started is not None and begun != str(started):
        again = " **Trained again**: curves and pictures of steps that an earlier training has logged are that one's."
        _LOG.warning("%s: MLflow has a run of an earlier training, begun %s; its curves stay there", run.name, begun)
    stored.tags({k: v for k, v in run.made_with.items() if k in ABOUT_CODE} | ({"begun": begun} if started else {}))
    stored.describe(
        f"`{label}`, seed {of_run['seed']}, of the study `{settings.study}`. **Model metrics**: `test/` was measured "
        "at the end; `test/floor_` is what the same frames score, simulated with other scatterers and ray paths. "
        "`newest/` are validation frames as rendered last, above their target, and `frames/` as training went on; "
        "`train/` and `val/` are curves; the step of all these is the number of images seen. **Artifacts**: every "
        "metric of every frame in `per_image.parquet`; configuration, code and environment in `provenance`. **Tags**: "
        "`config_hash` is a digest of the settings that decide the result; `git_dirty`: not all code was committed."
        + again
    )
    stored.parameters({"variant": label, **named_components(build(GeneratorSpec, of_run["model"])), **_sorted_by(run)})
    for folder in (settings.results / "data").glob(f"*-{data}"):
        with FileLock(store.lock, timeout=_LOCK_S), suppress(OSError, ValueError, KeyError):  # of pairs in the making
            pairs = DataSet(folder).pairs
            halves = pairs.maps - _DRAWN, pairs.maps & _DRAWN
            stored_as = [{name: FORMATS[name][0] for name in sorted(maps)} for maps in halves]
            stored.dataset(folder.name, data, folder, len(pairs), *stored_as)
    for path in run.provenance:
        stored.artifact(path, "provenance")
    return stored


def _sorted_by(run: Run) -> dict[str, Any]:
    """What is told of a run beside its components; the precision is that which `auto` stood for."""
    settings = dict(flat(run.spec["settings"]))
    others = {c.key for c in components()} - {c.key for c in components_of_networks().values()}
    keys = others.union(_SORTED_BY, (key for key in run.changed if not key.startswith("model.")))
    if settings["scene.kind"] == SceneKind.pairs:  # which were made elsewhere
        keys = {key for key in keys if not key.startswith("simulator.")}
    told = {key: settings[key] for key in sorted(keys) if settings.get(key) is not None}
    return {**told, "training.precision": run.spec["semantic"]["training"]["precision"]}


def log_samples(log: LocalLog, frames: np.ndarray, images: np.ndarray, targets: np.ndarray, images_seen: int) -> None:
    """Log some of the validation frames of these numbers, (n,), each rendered above its target: MLflow shows squares.

    `images` and `targets` are (n, H, W) uint8.
    """
    step = -(-images.shape[1] // _SAMPLE_PX)
    height, width = (size // step * step for size in images.shape[1:])
    for k in range(0, len(frames), -(-len(frames) // _SAMPLES)):
        both = np.stack([images[k], targets[k]])[:, :height, :width]
        blocks = both.reshape(2 * height // step, step, width // step, step)
        log.image(f"frames/{frames[k]}", blocks.mean((1, 3)).round().astype(np.uint8), images_seen)


def logged(scalars: Mapping[str, float]) -> dict[str, float]:
    """The scalars that a run's page shows: not the bounds of intervals, nor the re-simulation on validation frames."""
    hidden = f"val/{FLOOR_PREFIX}"
    return {k: v for k, v in scalars.items() if not k.startswith(hidden) and not is_bound(k) and k != FRAME_TIME}
