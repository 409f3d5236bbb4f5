"""MLflow's run of a training: parameters, curves, images, scores and artifacts, from its folder."""

import json
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from filelock import FileLock
from mlflow import MlflowClient
from mlflow.entities import Dataset, DatasetInput, InputTag, Metric, Param, Run, RunTag
from PIL import Image

from ablate.dataset.pairs import FORMATS
from ablate.metrics.metric import FLOOR_PREFIX, is_bound
from ablate.networks.spec import GeneratorSpec
from ablate.publish.store import Store
from ablate.setting import flat
from ablate.settings.conf import build, components, components_of_networks, named_components
from ablate.sources.data_set import DataSet
from ablate.sources.source import source_of
from ablate.storage import digest
from ablate.study.log import Log, Status, read_log
from ablate.study.provenance import ABOUT_CODE
from ablate.study.scores import read_score
from ablate.study.training import Training

PARENT = "mlflow.parentRunId"
NOTE = "mlflow.note.content"
PUBLISHED = "published"  # a tag: the digest of what was on disk when all of it had been published
_BEGAN = "begun"  # a tag: when the training began
_POINTS, _IMAGES = "points", "images"  # tags: how many of each have been published of a training that goes on
#: Settings that people sort and compare by, beside components.
_SORTED_BY = (
    "model.target",
    "model.width",
    "preset",
    "seed",
    "scene.anatomy_seed",
    "encoding",
    "dataset.frames",
    "dataset.split",
    "dataset.validation",
    "dataset.test",
    "simulator.rays",
    "simulator.layers",
    "simulator.scanlines",
    "simulator.image_shape",
    "training.steps",
    "training.batch_size",
    "training.crop",
    "training.learning_rate",
    "training.schedule",
    "training.reconstruction",
    "training.loss",
    "training.l1_weight",
    "training.ema_decay",
)
_DRAWN = frozenset({"target", "resimulation"})  # the other maps of a data set are what networks read
_BATCH = 500
_LOCK_S = 30.0


def publish_training(
    store: Store, parent: str, training: Training, scores: Sequence[str] = (), goes_on: bool = False
) -> str:
    """Make MLflow's run of a training equal to its folder; returns its id.

    A run that has been published of the same files is left alone. One of a training that went on is continued. Any
    other of this training is deleted, and made anew.

    Parameters
    ----------
    store : Store
        Where runs are published.
    parent : str
        Id of the run of its study.
    training : Training
        As it lies on disk; what it has is read.
    scores : sequence of str
        The names of the score files that are shown.
    goes_on : bool
        Whether the training, or its evaluation, is not yet ended.
    """
    with FileLock(training.folder / ".publish.lock", timeout=_LOCK_S):
        training = Training(training.folder)
        state = digest([training.published_state(), sorted(scores)])
        log = read_log(training.folder)
        client = store.client
        run = store.find({"kind": "job", "config_hash": training.hash, "study": training.folder.parent.name})
        if run is not None and run.data.tags.get(PARENT) != parent:  # the study's run was deleted
            client.set_tag(run.info.run_id, PARENT, parent)
        if run is not None and not goes_on and run.data.tags.get(PUBLISHED) == state:
            return str(run.info.run_id)
        if run is not None and not _goes_on_in(run, log):
            client.delete_run(run.info.run_id)
            run = None
        if run is None:
            run = _begin(store, parent, training, log)
        run_id = str(run.info.run_id)
        if run.info.status != Status.running:
            client.update_run(run_id, status=str(Status.running))
        _publish_log(client, run, log)
        if not goes_on:
            _publish_end(client, run_id, training, log, scores)
            client.set_tag(run_id, PUBLISHED, state)
        return run_id


def _goes_on_in(run: Run, log: Log) -> bool:
    """Whether a run shows the beginning of this log, and nothing that was computed after it."""
    return run.info.status != Status.finished and run.data.tags.get(_BEGAN) == str(log.began_ms)


def _begin(store: Store, parent: str, training: Training, log: Log) -> Run:
    """A new run with parameters, tags, provenance and data set."""
    settings, study = training.settings, training.folder.parent.name
    code = {key: value for key, value in training.made_with.items() if key in ABOUT_CODE}
    tags = {
        "kind": "job",
        "config_hash": training.hash,
        "variant": training.label,
        "study": study,
        "seed": str(training.seed),
        "data_hash": digest(training.identity["data"]),
        PARENT: parent,
        _BEGAN: str(log.began_ms),
        NOTE: _described(training, study),
        **code,
    }
    run = store.create(training.name, tags, log.began_ms)
    run_id, client = run.info.run_id, store.client
    named = named_components(build(GeneratorSpec, training.about["settings"]["model"], stored=True))
    has_scene = source_of(settings).has_scene
    parameters = {"variant": training.label, **named, **_sorted_by(training, has_scene)}
    client.log_batch(run_id, params=[Param(key, _word(value)) for key, value in parameters.items()])
    if training.data_set.exists:
        _publish_data(client, run_id, training.data_set, tags["data_hash"])
    for path in training.provenance_files():
        client.log_artifact(run_id, str(path), "provenance")
    return client.get_run(run_id)


def _word(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return str(value)


def _described(training: Training, study: str) -> str:
    """What the run's page says of it."""
    return (
        f"`{training.label}`, seed {training.seed}, of the study `{study}`. **Model metrics**: `test/` was measured "
        "at the end; `test/floor_` is what the same frames score, simulated with other scatterers and ray paths. "
        "`newest/` are validation frames as rendered last, above their target, and `frames/` as training went on; "
        "`train/` and `val/` are curves; the step of all these is the number of images seen. **Artifacts**: every "
        "metric of every frame in `per_image.parquet`; configuration, code and environment in `provenance`. **Tags**: "
        "`config_hash` is a digest of the settings that decide the weights; `git_dirty`: not all code was committed."
    )


def _sorted_by(training: Training, has_scene: bool) -> dict[str, Any]:
    """What is told of a training beside its components; the precision is that which `auto` stood for."""
    settings = dict(flat(training.about["settings"]))
    others = {c.key for c in components()} - {c.key for c in components_of_networks().values()}
    changed = {key for key in training.changed if not key.startswith("model.")}
    keys = others | set(_SORTED_BY) | changed
    if not has_scene:  # pairs were not simulated
        keys = {key for key in keys if not key.startswith("simulator.")}
    values = {key: settings[key] for key in sorted(keys) if settings.get(key) is not None}
    return {**values, "training.precision": training.identity["training"]["precision"]}


def _publish_data(client: MlflowClient, run_id: str, data: DataSet, data_hash: str) -> None:
    """The data set that the run is trained on, with the maps that networks read and those that they render."""
    from mlflow.data.schema import TensorDatasetSchema  # its import takes a second
    from mlflow.types import Schema, TensorSpec

    def schema(maps: frozenset[str]) -> Schema:
        return Schema([TensorSpec(np.dtype(FORMATS[name][0]), (-1, -1, -1), name) for name in sorted(maps)])

    pairs = data.pairs
    tensors = TensorDatasetSchema(schema(pairs.maps - _DRAWN), schema(pairs.maps & _DRAWN))
    published = Dataset(
        name=data.name,
        digest=data_hash,
        source_type="local",
        source=json.dumps({"uri": str(data.folder)}),
        schema=json.dumps(tensors.to_dict()),
        profile=json.dumps({"num_rows": len(pairs)}),
    )
    client.log_inputs(run_id, [DatasetInput(published, [InputTag("mlflow.data.context", "training")])])


def _publish_log(client: MlflowClient, run: Run, log: Log) -> None:
    """Curves and images since the run was published last."""
    run_id, tags = run.info.run_id, run.data.tags
    points = [Metric(point.key, point.value, point.time_ms, point.step) for point in log.points]
    first = int(tags.get(_POINTS, 0))
    for start in range(first, len(points), _BATCH):
        batch = points[start : start + _BATCH]
        client.log_batch(run_id, metrics=batch, tags=[RunTag(_POINTS, str(start + len(batch)))])
    images = sorted(log.images, key=lambda image: (image.step, image.key))  # in the order of their making
    for number, image in enumerate(images[int(tags.get(_IMAGES, 0)) :], start=int(tags.get(_IMAGES, 0))):
        _publish_image(client, run_id, image.path, image.key, image.step)
        client.set_tag(run_id, _IMAGES, str(number + 1))


def _publish_image(client: MlflowClient, run_id: str, path: Path, key: str, step: int) -> None:
    with Image.open(path) as image:
        client.log_image(run_id, np.asarray(image), key=key, step=step)


def _publish_end(client: MlflowClient, run_id: str, training: Training, log: Log, scores: Sequence[str]) -> None:
    """The scores of a training, the newest images, and how it has ended."""
    ended_ms, status = log.states[-1] if log.states else (None, Status.killed)
    status = Status.killed if status is Status.running else status  # the process itself was killed
    if training.is_trained:
        status = Status.finished
        read = [read_score(training.scores / name) for name in scores]
        scalars = dict(training.result["scalars"])
        for score in read:
            scalars |= score.scalars
        time_ms = ended_ms or 0
        metrics = [Metric(key, value, time_ms, 0) for key, value in _shown(scalars).items()]
        client.log_batch(run_id, metrics=metrics)
        values = [score.values for score in read if len(score.values)]
        if values:
            with tempfile.TemporaryDirectory() as folder:
                table = Path(folder) / "per_image.parquet"
                pd.concat(values, ignore_index=True).to_parquet(table)
                client.log_artifact(run_id, str(table))
        newest = {image.key: image for image in log.images}
        for key, image in newest.items():  # of a series MLflow shows the first
            _publish_image(client, run_id, image.path, f"newest/{Path(key).name}", image.step)
    client.set_terminated(run_id, str(status), ended_ms)


def _shown(scalars: Mapping[str, float]) -> dict[str, float]:
    """The finite scalars, without the bounds of intervals and the re-simulation on validation frames."""
    hidden = f"val/{FLOOR_PREFIX}"
    finite = {name: value for name, value in scalars.items() if abs(value) < float("inf")}
    return {name: value for name, value in finite.items() if not name.startswith(hidden) and not is_bound(name)}
