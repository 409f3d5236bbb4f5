"""A study in the tracking store: its parent run, and what a child run carries."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ablate.config import SceneKind, StudySettings, build, plain
from ablate.dataset import Part, label_values
from ablate.studies.data import dataset_folder, dataset_hash
from ablate.studies.identity import config_hash, write_json
from ablate.studies.results import Finished, data_of
from ablate.studies.sweep import Job
from ablate.tracking import (
    RunLog,
    Store,
    artifact_page,
    child_run,
    comparison_page,
    environment,
    git_state,
    hardware,
    open_store,
    packages,
    parent_run,
)
from ablate.training import LAST, load_generator

_TRAINING = ("steps", "batch_size", "crop", "learning_rate", "loss", "l1_weight", "ema_decay", "precision")
_DATA = {
    "dataset": ("frames", "split", "validation", "test"),
    "simulator": ("rays", "layers", "scanlines", "image_shape"),
}
_SAMPLES = 2  # validation frames shown through training
_EXAMPLE_PX = 64  # of the input that a registered model shows
_SAMPLE_PX = 512  # larger frames are shown smaller: a run keeps a few dozen of them


def open_tracking(settings: StudySettings) -> tuple[Store, str]:
    """The store and the id of the study's parent run, both made when missing."""
    store = _store(settings)
    parent = parent_run(store, settings.study)
    RunLog(store, parent).parameters(_shared(settings))
    return store, parent


def _store(settings: StudySettings) -> Store:
    return open_store(settings.runs, settings.tracking.uri, settings.tracking.experiment)


def _shared(s: StudySettings) -> dict[str, object]:
    """Parameters that all runs of a study have in common."""
    made = {} if s.scene.kind is SceneKind.pairs else _DATA
    data = {f"{group}.{k}": v for group, keys in made.items() for k, v in _of(getattr(s, group), keys).items()}
    about = {"scene": s.scene_name, "preset": s.preset, "model.width": s.model.width}
    return {**about, **data, **{f"training.{k}": v for k, v in _of(s.training, _TRAINING).items()}}


def _own(job: Job) -> dict[str, object]:
    """Parameters that can differ between the runs of a study.

    The label is called `model`, so that it comes before its components: of the parameters that differ, MLflow's
    comparison draws the first three by name.
    """
    s = job.settings
    components = {f"model.{k}": v for k, v in plain(s.model).items() if k != "width" and (k != "noise_start" or v)}
    return {"model": job.label, **components, "encoding": s.encoding.name, "seed": s.seed}


def _of(values: object, keys: tuple[str, ...]) -> dict[str, object]:
    return {k: v for k, v in plain(values).items() if k in keys}


def open_child(job: Job, store: Store, parent: str, frames: int) -> RunLog:
    """The job's run, with its parameters, tags and provenance written.

    Parameters
    ----------
    job : Job
    store : Store
    parent : str
    frames : int
        Of the data set.
    """
    s = job.settings
    code = git_state(Path(__file__).parent)
    made_with = {k: v for k, v in code.items() if k != "git_diff"} | {"hardware": hardware()}
    tags = {"variant": job.label, "seed": str(s.seed), "study": s.study, "data_hash": dataset_hash(s)}
    run = RunLog(store, child_run(store, parent, job.name, config_hash(s), tags))
    run.tags(made_with)
    run.describe(_about(job))
    run.parameters(_own(job))
    run.dataset(dataset_folder(s).name, dataset_hash(s), dataset_folder(s), frames)
    provenance = job.folder / "provenance"
    provenance.mkdir(exist_ok=True)
    write_json(provenance / "config.json", plain(s))
    write_json(provenance / "made_with.json", {**made_with, **packages()})
    (provenance / "environment.txt").write_text(environment())
    (provenance / "uncommitted.diff").write_text(code.get("git_diff", ""))
    for path in sorted(provenance.iterdir()):
        run.artifact(path, "provenance")
    return run


def _about(job: Job) -> str:
    study = job.settings.study
    return (
        f"`{job.label}`, seed {job.settings.seed}, of the study `{study}`. **Model metrics**: `frames/` are validation "
        "frames as training went on, rendered above, their target below; `train/` and `val/` are curves; "
        "the step of all these is the number of images seen. `test/` was measured once, on frames of unseen probe "
        "sites; `test/floor_` is what the same frames simulated with other scatterers score. **Artifacts**: every "
        "metric of every frame in `per_image.parquet`; configuration, code and environment in `provenance`."
    )


def log_samples(run: RunLog, frames: np.ndarray, images: np.ndarray, targets: np.ndarray, images_seen: int) -> None:
    """Some validation frames as they are rendered now, each above its target: MLflow shows images in squares.

    Parameters
    ----------
    run : RunLog
    frames : (n,) int
        Their numbers in the data set.
    images, targets : (n, H, W) uint8
    images_seen : int
    """
    step = -(-images.shape[1] // _SAMPLE_PX)
    height, width = (size // step * step for size in images.shape[1:])
    for k in range(0, len(frames), -(-len(frames) // _SAMPLES)):
        blocks = [
            i[:height, :width].reshape(height // step, step, width // step, step) for i in (images[k], targets[k])
        ]
        smaller = [b.mean((1, 3)).round().astype(np.uint8) for b in blocks]
        run.image(f"frames/{frames[k]}", np.vstack(smaller), images_seen)


def describe_study(run: RunLog, runs: Sequence[Finished], comparison: str, cautions: Sequence[str]) -> None:
    """The parent run's first page: where to look, the comparison, what not to conclude; and its metrics, the floors.

    Parameters
    ----------
    run : RunLog
    runs : sequence of Finished
    comparison : str
        The table in Markdown.
    cautions : sequence of str
    """
    first: dict[str, str] = {}
    for finished in sorted(runs, key=lambda r: r.seed):
        first.setdefault(finished.label, finished.result["mlflow_run_id"])
    report = artifact_page(run.store, run.run_id, "report.html")
    compared = comparison_page(run.store, list(first.values()))
    links = f"[The report]({report}) · [the variants side by side]({compared})"
    run.describe("\n\n".join([links, _spaced(comparison), *cautions]))
    run.metrics({k: v for k, v in logged(runs[0].result["scalars"]).items() if k.startswith("test/floor_")})


def _spaced(table: str) -> str:
    """A Markdown table with room between its columns, which MLflow's pages leave none."""
    lines = [line if set(line) <= set("|-: ") else line.replace(" |", "\u00a0\u00a0|") for line in table.splitlines()]
    return "\n".join(lines)


def logged(scalars: Mapping[str, float]) -> dict[str, float]:
    """Those of a run's scalars that its page shows; bounds of intervals and what validates only are in the tables."""
    return {k: v for k, v in scalars.items() if not k.startswith("val/floor_") and not k.endswith(("_low", "_high"))}


def register_reference(settings: StudySettings, runs: Sequence[Finished]) -> str:
    """Register the reference's generator, that of the seed that validates best; a line for the screen tells where."""
    from ablate.tracking.registration import register_generator  # takes seconds, and few want it

    name = settings.tracking.register
    of_reference = [run for run in runs if run.label == settings.reference]
    if not of_reference:
        return f"not registered: {settings.reference} has no finished run"
    chosen = max(of_reference, key=lambda run: run.result["scalars"]["val/psnr_fan"])
    trained, data = build(StudySettings, chosen.spec["settings"]), data_of(runs)
    middle = [slice(size // 2 - _EXAMPLE_PX // 2, size // 2 + _EXAMPLE_PX // 2) for size in data.pairs.shape]
    frame = data.pairs.frames(Part.test)[:1]
    version = register_generator(
        _store(settings),
        str(name),
        chosen.result["mlflow_run_id"],
        load_generator(chosen.folder / LAST),
        label_values(data.tissues, trained.encoding, trained.encoding_seed),
        trained.training.precision,
        {name: data.pairs.read(name, frame)[:, *middle] for name in data.pairs.maps},
        f"{chosen.name} of the study {settings.study}, the seed that validates best.",
    )
    return f"models:/{name}/{version}    ({chosen.name})"
