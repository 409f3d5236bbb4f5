"""MLflow's run of a training: parameters, curves, images, scores and artifacts, from its folder."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock
from mlflow import MlflowClient
from mlflow.entities import Metric, Param, Run, RunTag
from PIL import Image

from ablate.networks.spec import GeneratorSpec
from ablate.publish.results_view import NOTE, publish_results
from ablate.publish.store import Store, plain_files
from ablate.setting import flat
from ablate.settings.components import OF_OWN_NETWORK, components, components_of_networks, named_components
from ablate.settings.conf import build
from ablate.sources.source import source_of
from ablate.storage import check_unpacked, digest
from ablate.study.log import Log, LoggedImage, Status, read_log
from ablate.study.provenance import ABOUT_CODE
from ablate.study.training import Training

PARENT = "mlflow.parentRunId"
JOB = "job"  # the kind of its run
_VIEW = 3  # changes when runs that were published before are to be published again
# Tags that MLflow's pages do not show, as their names begin with its own.
PUBLISHED = "mlflow.ablate.published"  # the digest of what was on disk when all of it had been published
_BEGAN = "mlflow.ablate.begun"  # when the training began
_POINTS = "mlflow.ablate.points"  # how many of them have been published of a training that goes on
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
        state = digest([_VIEW, training.published_state(), sorted(scores)])
        log = read_log(training.folder)
        client = store.client
        run = store.find(JOB, {"config_hash": training.hash, "study": training.folder.parent.name})
        if run is not None and run.data.tags.get(PARENT) != parent:  # the study's run was deleted
            client.set_tag(run.info.run_id, PARENT, parent)
        if run is not None and run.data.tags.get(PUBLISHED) == state:
            return str(run.info.run_id)
        if run is not None and not _goes_on_in(client, run, log):
            store.discard(run)
            run = None
        if run is None:
            run = _begin(store, parent, training, log)
        run_id = str(run.info.run_id)
        if run.info.status != Status.running:
            client.update_run(run_id, status=str(Status.running))
        ended_ms, status = log.states[-1] if log.states else (None, Status.killed)
        if training.is_trained and not goes_on:  # before curves, as MLflow's pages keep the order
            publish_results(store, run_id, training, scores, ended_ms or 0)
            status = Status.finished
        elif status is Status.running:  # the process itself was killed
            status = Status.killed
        _publish_curves(client, run, log)
        _publish_images(client, run_id, log.images)
        if not goes_on:
            client.set_terminated(run_id, str(status), ended_ms)
            client.set_tag(run_id, PUBLISHED, state)
        return run_id


def _goes_on_in(client: MlflowClient, run: Run, log: Log) -> bool:
    """Whether a run shows the beginning of this log, and nothing that was computed after it.

    Of each image there are two files: where their number is odd, publishing was stopped between them.
    """
    if run.info.status == Status.finished or run.data.tags.get(_BEGAN) != str(log.began_ms):
        return False
    return len(client.list_artifacts(run.info.run_id, "images")) % 2 == 0


def _begin(store: Store, parent: str, training: Training, log: Log) -> Run:
    """A new run with parameters, tags and provenance."""
    settings, study = training.settings, training.folder.parent.name
    code = {key: value for key, value in training.made_with.items() if key in ABOUT_CODE}
    known_by = {"config_hash": training.hash, "study": study}
    about = {
        "variant": training.label,
        "seed": str(training.seed),
        "data_hash": digest(training.identity["data"]),
        PARENT: parent,
        NOTE: "Not ended: there are no scores yet.",
    }
    command = training.starts[-1].get("command") if training.starts else None
    if command:  # the column Source
        about |= {"mlflow.source.name": command, "mlflow.source.type": "LOCAL"}
    run = store.create(training.name, JOB, known_by | about | code, log.began_ms)
    run_id, client = run.info.run_id, store.client
    named = named_components(build(GeneratorSpec, training.about["settings"]["model"], stored=True))
    has_scene = source_of(settings).has_scene
    parameters = {"variant": training.label, **named, **_sorted_by(training, has_scene)}
    client.log_batch(run_id, params=[Param(key, _word(value)) for key, value in parameters.items()])
    for path in plain_files(training.provenance_files()):
        client.log_artifact(run_id, str(path), "provenance")
    client.set_tag(run_id, _BEGAN, str(log.began_ms))  # a run that was begun only in part is not gone on with
    return client.get_run(run_id)


def _word(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return str(value)


def _sorted_by(training: Training, has_scene: bool) -> dict[str, Any]:
    """What is told of a training beside its components; the precision is that which `auto` stood for."""
    settings = dict(flat(training.about["settings"]))
    others = {c.key for c in components()} - {c.key for c in components_of_networks().values()}
    changed = {key for key in training.changed if not key.startswith("model.")}
    keys = others | set(_SORTED_BY) | changed | {key for key in settings if key.startswith(OF_OWN_NETWORK)}
    if not has_scene:  # pairs were not simulated
        keys = {key for key in keys if not key.startswith("simulator.")}
    values = {key: settings[key] for key in sorted(keys) if settings.get(key) is not None}
    return {**values, "training.precision": training.identity["training"]["precision"]}


def _publish_curves(client: MlflowClient, run: Run, log: Log) -> None:
    """The points of curves since the run was published last."""
    points = [Metric(point.key, point.value, point.time_ms, point.step) for point in log.points]
    first = int(run.data.tags.get(_POINTS, 0))
    for start in range(first, len(points), _BATCH):
        batch = points[start : start + _BATCH]
        client.log_batch(run.info.run_id, metrics=batch, tags=[RunTag(_POINTS, str(start + len(batch)))])


def _publish_images(client: MlflowClient, run_id: str, images: Sequence[LoggedImage]) -> None:
    """The images that the run has not yet, in the order of their making; MLflow decides the names of their files."""
    files = client.list_artifacts(run_id, "images") if images else []
    published = {Path(file.path).name.partition("+timestamp+")[0] for file in files}
    for image in sorted(images, key=lambda image: (image.step, image.key)):
        if f"{image.key.replace('/', '~')}+step+{image.step}" not in published:
            with Image.open(image.path, formats=["PNG"]) as opened:
                check_unpacked(image.path, opened.width * opened.height * len(opened.getbands()))
                client.log_image(run_id, np.asarray(opened), key=image.key, step=image.step)
