"""Bring the tracking store up to date with the runs of a study on disk: the store is a copy of them."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from ablate import tracking
from ablate.config import StudySettings
from ablate.storage import digest, read_json
from ablate.studies.comparison.results import ABOUT_CODE
from ablate.studies.pairs.data import open_data
from ablate.studies.result_file import read_result
from ablate.studies.tracked import about_run, logged, own_parameters, shared_parameters
from ablate.tracking import STATE, LocalLog, Status, Store, StoredRun

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
    run.parameters(shared_parameters(settings))
    return run


def mark_study(settings: StudySettings, status: Status) -> None:
    """Say in the store that a study runs, or how it has ended; waits 5 s at most."""
    tracking.Background(lambda: open_tracking(settings).mark(status)).close()


@contextmanager
def copying(settings: StudySettings, folder: Path, log: LocalLog) -> Iterator[None]:
    """Copy a run to the store while it is trained inside; what the store does not take is left for `copy_study`."""
    log.status(Status.running)
    copy = _Copy(settings, folder)
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
    for path in sorted(settings.study_dir.glob("*/seed*/spec.json")):
        folder, spec = path.parent, _read(path)
        name = f"{folder.parent.name}/{folder.name}"
        run_id, tags = stored.get((name, str(spec.get("hash"))), ("", {}))
        if spec and tags.get(STATE) != _state(folder) and not _in_training(folder):
            try:
                run_id = _Copy(settings, folder).everything()
            except (KeyError, TypeError) as error:
                _LOG.warning("%s: not copied to the tracking store, %s is not as runs are now", path, error)
        if run_id:
            ids[name] = run_id
    tracking.copy_tasks(parent.store, settings.results, settings.study)
    return parent, ids


class _Copy:
    """The copy of one run. Whatever is raised, the next call begins with what the store has by then."""

    def __init__(self, settings: StudySettings, folder: Path) -> None:
        self.settings, self.folder = settings, folder
        self._run: StoredRun | None = None

    def curves(self) -> StoredRun:
        """Copy what is new in the log."""
        run, self._run = self._run, None
        with FileLock(self.folder / ".copy.lock", timeout=_LOCK_S):
            run = run or _opened(self.settings, self.folder)
            run.copy_log(self.folder)
        self._run = run
        return run

    def everything(self) -> str:
        """Copy the log and, where the run has ended, its scores and state; returns its id."""
        state = _state(self.folder)
        run = self.curves()
        changes = [line for line in tracking.read_log(self.folder)[0] if "status" in line]
        changed_ms = changes[-1]["time"] if changes else None
        result = read_result(self.folder, str(_read(self.folder / "spec.json").get("hash")))
        if result is not None:
            run.scores(logged(result["scalars"]), changed_ms, run.model(str(result["label"])))
            if (scores := self.folder / "per_image.parquet").exists():
                run.artifact(scores)
        ended = Status(changes[-1]["status"]) if changes else Status.killed
        ended = Status.killed if ended is Status.running else ended  # the process itself was killed
        run.mark(Status.finished if result is not None else ended, changed_ms)
        run.tags({STATE: state})
        return run.run_id


def _opened(settings: StudySettings, folder: Path) -> StoredRun:
    """The stored run of a folder, with parameters, tags, provenance and data set."""
    parent = open_tracking(settings)
    spec, store = _read(folder / "spec.json"), parent.store
    label, of_run = str(spec["label"]), spec["settings"]
    data = digest(spec["semantic"]["data"])
    tags = {"variant": label, "seed": str(of_run["seed"]), "study": settings.study, "data_hash": data}
    started = next((line["time"] for line in tracking.read_log(folder)[0]), None)
    name = f"{folder.parent.name}/{folder.name}"
    run = StoredRun(store, tracking.child_run(store, parent.run_id, name, spec["hash"], tags, started))
    run.mark(Status.running)
    made_with = _read(folder / "provenance" / "made_with.json")
    run.tags({k: v for k, v in made_with.items() if k in ABOUT_CODE})
    run.describe(about_run(label, of_run["seed"], settings.study))
    run.parameters(own_parameters(label, of_run))
    for pairs in (settings.results / "data").glob(f"*-{data}"):
        with suppress(OSError, ValueError, KeyError):  # pairs that are being made again
            of = open_data(pairs).pairs
            read, drawn = of.dtypes(of.maps - _DRAWN), of.dtypes(_DRAWN)
            run.dataset(pairs.name, data, pairs, len(of), read, drawn)
    for path in _provenance(folder):
        run.artifact(path, "provenance")
    return run


def _provenance(folder: Path) -> list[Path]:
    return [path for path in sorted((folder / "provenance").glob("*")) if ".partial" not in path.suffixes]


def _state(folder: Path) -> str:
    """A digest that changes with whatever is copied of a run."""
    files = [folder / "log.jsonl", folder / "per_image.parquet", *sorted((folder / "images").glob("*"))]
    sizes = {path.name: path.stat().st_size for path in files if path.exists()}
    texts = [folder / "result.json", folder / "spec.json", *_provenance(folder)]
    return digest([sizes, {path.name: path.read_text("utf-8", "replace") for path in texts if path.exists()}])


def _in_training(folder: Path) -> bool:
    """Whether a process trains this run, itself or another."""
    try:
        with FileLock(folder / ".lock", timeout=0):
            return False
    except Timeout:
        return True


def _read(path: Path) -> dict[str, Any]:
    """A JSON file; empty where there is none that can be read."""
    try:
        return read_json(path)
    except (OSError, ValueError):
        return {}
