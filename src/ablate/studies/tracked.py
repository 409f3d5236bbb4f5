"""A study in MLflow: its parent run, a child run for each job, and the registered model."""

from collections.abc import Mapping, Sequence

import numpy as np

from ablate import tracking
from ablate.config import SceneKind, StudySettings, build, json_ready
from ablate.dataset import Part, label_values
from ablate.metrics.stored_names import FLOOR_PREFIX, is_bound
from ablate.networks import conditions
from ablate.storage import write_json, write_text
from ablate.studies.comparison.results import Finished, data_of
from ablate.studies.identity import config_hash
from ablate.studies.jobs.job import Job
from ablate.studies.pairs.data import dataset_folder, dataset_hash
from ablate.tracking import RunLog, Store
from ablate.training import LAST, load_generator

_TRAINING = (
    *("steps", "batch_size", "crop", "learning_rate", "schedule"),
    *("reconstruction", "l1_weight", "ema_decay", "precision"),
)
_DATA = {
    "dataset": ("frames", "split", "validation", "test"),
    "simulator": ("rays", "layers", "scanlines", "image_shape"),
}
_SAMPLES = 2  # validation frames shown through training
_EXAMPLE_PX = 64  # size of the example input of a registered model
_SAMPLE_PX = 512  # larger frames are shrunk before they are logged: a run keeps a few dozen of them


def open_tracking(settings: StudySettings) -> tuple[Store, str]:
    """The store and the id of the study's parent run; both are created when they are missing."""
    store = _store(settings)
    parent = tracking.parent_run(store, settings.study)
    RunLog(store, parent).parameters(_shared(settings))
    return store, parent


def _store(settings: StudySettings) -> Store:
    return tracking.open_store(settings.runs, settings.tracking.uri, settings.tracking.experiment)


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
    components = {f"model.{k}": v for k, v in json_ready(s.model).items() if k != "width" and (k != "noise_start" or v)}
    own = {"encoding": s.encoding.name, "training.loss": s.training.loss.name, "seed": s.seed}
    return {"model": job.label, **components, **own}


def _of(values: object, keys: tuple[str, ...]) -> dict[str, object]:
    return {k: v for k, v in json_ready(values).items() if k in keys}


def open_child(job: Job, store: Store, parent: str, frames: int) -> RunLog:
    """Open the job's run, and write its parameters, tags, provenance and the number of frames of its data set."""
    s = job.settings
    code = tracking.git_state()
    made_with = {k: v for k, v in code.items() if k != "git_diff"} | {"hardware": tracking.hardware()}
    tags = {"variant": job.label, "seed": str(s.seed), "study": s.study, "data_hash": dataset_hash(s)}
    run = RunLog(store, tracking.child_run(store, parent, job.name, config_hash(s), tags))
    run.tags(made_with)
    run.describe(_about(job))
    run.parameters(_own(job))
    run.dataset(dataset_folder(s).name, dataset_hash(s), dataset_folder(s), frames)
    provenance = job.folder / "provenance"
    provenance.mkdir(exist_ok=True)
    write_json(provenance / "config.json", json_ready(s))
    write_json(provenance / "made_with.json", {**made_with, **tracking.packages()})
    write_text(provenance / "environment.txt", tracking.environment())
    write_text(provenance / "uncommitted.diff", code.get("git_diff", ""))
    for name in ("config.json", "environment.txt", "made_with.json", "uncommitted.diff"):
        run.artifact(provenance / name, "provenance")
    return run


def _about(job: Job) -> str:
    study = job.settings.study
    return (
        f"`{job.label}`, seed {job.settings.seed}, of the study `{study}`. **Model metrics**: `frames/` are validation "
        "frames as training went on, rendered above, their target below; `train/` and `val/` are curves; "
        "the step of all these is the number of images seen. `test/` was measured once, on frames of unseen probe "
        "sites; `test/floor_` is what the same frames simulated with other scatterers and ray paths score. "
        "**Artifacts**: every metric of every frame in `per_image.parquet`; configuration, code and environment in "
        "`provenance`."
    )


def log_samples(run: RunLog, frames: np.ndarray, images: np.ndarray, targets: np.ndarray, images_seen: int) -> None:
    """Log some of the validation frames of these numbers, (n,), each rendered above its target: MLflow shows squares.

    `images` and `targets` are (n, H, W) uint8.
    """
    step = -(-images.shape[1] // _SAMPLE_PX)
    height, width = (size // step * step for size in images.shape[1:])
    for k in range(0, len(frames), -(-len(frames) // _SAMPLES)):
        both = np.stack([images[k], targets[k]])[:, :height, :width]
        blocks = both.reshape(2 * height // step, step, width // step, step)
        run.image(f"frames/{frames[k]}", blocks.mean((1, 3)).round().astype(np.uint8), images_seen)


def describe_study(run: RunLog, runs: Sequence[Finished], comparison: str, cautions: Sequence[str]) -> None:
    """Write the parent run's description (links, the table in Markdown, cautions) and the re-simulation's scores."""
    first: dict[str, str] = {}
    for finished in sorted(runs, key=lambda r: r.seed):
        first.setdefault(finished.label, finished.result["mlflow_run_id"])
    report = tracking.artifact_page(run.store, run.run_id, "report.html")
    compared = tracking.comparison_page(run.store, list(first.values()))
    links = f"[The report]({report}) · [the variants side by side]({compared})"
    rows = comparison.splitlines()  # MLflow's pages show no space between the columns of a table
    spaced = [row if set(row) <= set("|-: ") else row.replace(" |", "\u00a0\u00a0|") for row in rows]
    run.describe("\n\n".join([links, "\n".join(spaced), *cautions]))
    run.metrics({k: v for k, v in logged(runs[0].result["scalars"]).items() if k.startswith(f"test/{FLOOR_PREFIX}")})


def logged(scalars: Mapping[str, float]) -> dict[str, float]:
    """The scalars that a run's page shows: not the bounds of intervals, nor the re-simulation on validation frames."""
    return {k: v for k, v in scalars.items() if not k.startswith(f"val/{FLOOR_PREFIX}") and not is_bound(k)}


def register_reference(settings: StudySettings, runs: Sequence[Finished]) -> str:
    """Register the reference's generator of the seed with the best validation PSNR; returns a line for the screen."""
    from ablate.tracking.registration import register_generator  # its import takes seconds

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
        {name: data.pairs.read(name, frame)[:, *middle] for name in conditions(trained.model)},
        f"{chosen.name} of the study {settings.study}, the seed that validates best.",
    )
    return f"models:/{name}/{version}    ({chosen.name})"
