"""What a study shows in MLflow: its parent run, a child run for each job, and the registered model."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ablate import tracking
from ablate.config import SceneKind, StudySettings, build, json_ready
from ablate.dataset import Part, label_values
from ablate.metrics.stored_names import FLOOR_PREFIX, FRAME_TIME, is_bound
from ablate.networks import conditions
from ablate.studies.comparison.results import Finished, data_of
from ablate.tracking import LocalLog, Store, StoredRun
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


def shared_parameters(s: StudySettings) -> dict[str, object]:
    """Parameters that all runs of a study have in common."""
    made = {} if s.scene.kind is SceneKind.pairs else _DATA
    data = {f"{group}.{k}": v for group, keys in made.items() for k, v in _of(getattr(s, group), keys).items()}
    about = {"scene": s.scene_name, "preset": s.preset, "model.width": s.model.width}
    return {**about, **data, **{f"training.{k}": v for k, v in _of(s.training, _TRAINING).items()}}


def own_parameters(label: str, settings: Mapping[str, Any]) -> dict[str, object]:
    """Parameters that can differ between the runs of a study, from the settings in `spec.json`.

    The label is called `model`, so that it comes before its components: of the parameters that differ, MLflow's
    comparison draws the first three by name.
    """
    model = settings["model"].items()
    components = {f"model.{k}": v for k, v in model if k != "width" and (k not in ("noise_start", "target") or v)}
    own = {"encoding": settings["encoding"], "training.loss": settings["training"]["loss"], "seed": settings["seed"]}
    return {"model": label, **components, **own}


def _of(values: object, keys: tuple[str, ...]) -> dict[str, object]:
    return {k: v for k, v in json_ready(values).items() if k in keys}


def about_run(label: str, seed: int, study: str) -> str:
    """The description of a job's run."""
    return (
        f"`{label}`, seed {seed}, of the study `{study}`. **Model metrics**: `frames/` are validation "
        "frames as training went on, rendered above, their target below; `train/` and `val/` are curves; "
        "the step of all these is the number of images seen. `test/` was measured once, on frames of unseen probe "
        "sites; `test/floor_` is what the same frames simulated with other scatterers and ray paths score. "
        "**Artifacts**: every metric of every frame in `per_image.parquet`; configuration, code and environment in "
        "`provenance`."
    )


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


def describe_study(
    run: StoredRun, runs: Sequence[Finished], ids: Mapping[str, str], comparison: str, cautions: Sequence[str]
) -> None:
    """Write the parent run's description (links, the table in Markdown, cautions) and the re-simulation's scores.

    `ids` are those of the stored runs, by name.
    """
    first: dict[str, str] = {}
    for finished in sorted(runs, key=lambda r: r.seed):
        if finished.name in ids:
            first.setdefault(finished.label, ids[finished.name])
    report = tracking.artifact_page(run.store, run.run_id, "report.html")
    compared = tracking.comparison_page(run.store, list(first.values()))
    links = f"[The report]({report}) · [the variants side by side]({compared})"
    rows = comparison.splitlines()  # MLflow's pages show no space between the columns of a table
    spaced = [row if set(row) <= set("|-: ") else row.replace(" |", "\u00a0\u00a0|") for row in rows]
    run.describe("\n\n".join([links, "\n".join(spaced), *cautions]))
    floors = {k: v for k, v in logged(runs[0].result["scalars"]).items() if k.startswith(f"test/{FLOOR_PREFIX}")}
    run.scores(floors)


def logged(scalars: Mapping[str, float]) -> dict[str, float]:
    """The scalars that a run's page shows: not the bounds of intervals, nor the re-simulation on validation frames.

    Runs of earlier versions stored a time a frame that was measured beside other work; that of the comparison is shown.
    """
    hidden = f"val/{FLOOR_PREFIX}"
    return {k: v for k, v in scalars.items() if not k.startswith(hidden) and not is_bound(k) and k != FRAME_TIME}


def register_reference(settings: StudySettings, runs: Sequence[Finished], store: Store, ids: Mapping[str, str]) -> str:
    """Register the reference's generator of the seed with the best validation PSNR; returns a line for the screen.

    `ids` are those of the stored runs, by name.
    """
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
        store,
        str(name),
        ids[chosen.name],
        load_generator(chosen.folder / LAST),
        label_values(data.tissues, trained.encoding, trained.encoding_seed),
        trained.training.precision,
        {name: data.pairs.read(name, frame)[:, *middle] for name in conditions(trained.model)},
        f"{chosen.name} of the study {settings.study}, the seed that validates best.",
    )
    return f"models:/{name}/{version}    ({chosen.name})"
