"""What MLflow shows of a job's run: parameters, description, sample images, scores."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ablate.metrics.stored_names import FLOOR_PREFIX, FRAME_TIME, is_bound
from ablate.setting import plain
from ablate.settings.study import SceneKind, StudySettings
from ablate.tracking import LocalLog

#: What is told of the code and the machine of a run.
ABOUT_CODE = ("git_commit", "git_dirty", "hardware", "threads")
_TRAINING = (
    *("steps", "batch_size", "crop", "learning_rate", "schedule"),
    *("reconstruction", "l1_weight", "ema_decay", "precision"),
)
_DATA = {
    "dataset": ("frames", "split", "validation", "test"),
    "simulator": ("rays", "layers", "scanlines", "image_shape"),
}
_SAMPLES = 2  # validation frames shown through training
_SAMPLE_PX = 512  # larger frames are shrunk before they are logged: a run keeps a few dozen of them


def shared_parameters(s: StudySettings) -> dict[str, object]:
    """Parameters that all runs of a study have in common."""
    made = {} if s.scene.kind is SceneKind.pairs else _DATA
    data = {f"{group}.{k}": v for group, keys in made.items() for k, v in _of(getattr(s, group), keys).items()}
    about = {"scene": s.scene_name, "preset": s.preset, "model.width": s.model.width}
    return {**about, **data, **{f"training.{k}": v for k, v in _of(s.training, _TRAINING).items()}}


def own_parameters(label: str, settings: Mapping[str, Any], changed: Mapping[str, Any]) -> dict[str, object]:
    """Parameters that can differ between the runs of a study, from the settings in `spec.json`.

    The label is called `model`, so that it comes before its components: of the parameters that differ, MLflow's
    comparison draws the first three by name.
    """
    model = settings["model"].items()
    components = {f"model.{k}": v for k, v in model if k != "width" and (k not in ("noise_start", "target") or v)}
    own = {"encoding": settings["encoding"], "training.loss": settings["training"]["loss"], "seed": settings["seed"]}
    return {"model": label, **components, **own, **changed}


def _of(values: object, keys: tuple[str, ...]) -> dict[str, object]:
    return {k: v for k, v in plain(values).items() if k in keys}


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


def logged(scalars: Mapping[str, float]) -> dict[str, float]:
    """The scalars that a run's page shows: not the bounds of intervals, nor the re-simulation on validation frames."""
    hidden = f"val/{FLOOR_PREFIX}"
    return {k: v for k, v in scalars.items() if not k.startswith(hidden) and not is_bound(k) and k != FRAME_TIME}
