"""A study in the tracking store: its parent run, and what a child run carries."""

from __future__ import annotations

from pathlib import Path

from ablate.config import StudySettings, plain
from ablate.studies.data import dataset_hash
from ablate.studies.identity import config_hash, write_json
from ablate.studies.sweep import Job
from ablate.tracking import RunLog, Store, child_run, environment, git_state, hardware, open_store, parent_run


def open_tracking(settings: StudySettings) -> tuple[Store, str]:
    """The store and the id of the study's parent run, both made when missing."""
    tracking = settings.tracking
    store = open_store(settings.runs, tracking.uri, tracking.experiment)
    return store, parent_run(store, settings.study)


def open_child(job: Job, store: Store, parent: str) -> RunLog:
    """The job's run, with its parameters, tags and provenance written."""
    s = job.settings
    code = git_state(Path(__file__).parent)
    tags = {
        "variant": job.label,
        "seed": str(s.seed),
        "study": s.study,
        "data_hash": dataset_hash(s),
        **{k: v for k, v in code.items() if k != "git_diff"},
    }
    run = RunLog(store, child_run(store, parent, job.name, config_hash(s), tags))
    model = {f"model.{k}": v for k, v in plain(s.model).items()}
    chosen = ("steps", "batch_size", "crop", "l1_weight", "ema_decay", "precision")
    training = {f"training.{k}": v for k, v in plain(s.training).items() if k in chosen}
    run.parameters({"variant": job.label, "seed": s.seed, "encoding": s.encoding.name, **model, **training})
    run.tags({"hardware": hardware()})
    provenance = job.folder / "provenance"
    provenance.mkdir(exist_ok=True)
    write_json(provenance / "config.json", plain(s))
    (provenance / "environment.txt").write_text(environment())
    if code.get("git_diff"):
        (provenance / "uncommitted.diff").write_text(code["git_diff"])
    for path in sorted(provenance.iterdir()):
        run.artifact(path, "provenance")
    return run
