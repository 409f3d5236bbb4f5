"""MLflow's run of a study: its comparison, and the runs of its trainings below it."""

import json
import logging
import re
from collections.abc import Mapping, Sequence
from urllib.parse import quote

import pandas as pd
from filelock import FileLock
from mlflow.entities import Metric, Param, Run

from ablate import analysis
from ablate.metrics import Shown, shown_in
from ablate.metrics.metric import FRAME_TIME
from ablate.publish.store import UNAVAILABLE, Store, open_store, reason, store_uri
from ablate.publish.task_view import publish_tasks
from ablate.publish.training_view import NOTE, PARENT, PUBLISHED, publish_training
from ablate.publish.waiting import in_time
from ablate.settings.study import StudySettings
from ablate.storage import digest
from ablate.study.log import Status
from ablate.study.opened import Study
from ablate.study.reading import provenance
from ablate.study.run import COMPARISON

_LOG = logging.getLogger(__name__)
_LOCK_S = 60.0
_WAIT_S = 120.0  # a server that answers slowly or not at all is not waited for longer
_MARK_S = 20.0


def mark_study(settings: StudySettings, status: Status) -> None:
    """Say in the store that a study runs, or how it has ended; a store that does not answer stops nothing."""

    def mark() -> None:
        store = open_store(settings)
        store.client.update_run(study_run(store, settings), status=str(status))

    try:
        in_time(_MARK_S, mark)
    except UNAVAILABLE as error:
        _LOG.warning("%s is not in MLflow for now, work goes on (%s)", settings.study, reason(error))


def study_run(store: Store, settings: StudySettings) -> str:
    """Id of the run of a study; it is created when there is none."""
    known_by = {"kind": "study", "study": settings.study}
    with FileLock(store.lock, timeout=_LOCK_S):
        run = store.find(known_by)
        if run is None:
            run = store.create(settings.study, known_by)
            store.client.log_batch(run.info.run_id, params=[Param("scene", settings.scene_name)])
        return str(run.info.run_id)


def publish_study(settings: StudySettings, study: Study, notes: Sequence[str]) -> str:
    """Publish the runs of a study and its comparison; returns where they are, in words.

    What a reader must know of the comparison are its `notes`. A store that does not answer is named, and not waited
    for.
    """
    uri = store_uri(settings)
    where = uri if uri.startswith("http") else f"make ui, or: mlflow ui --backend-store-uri {uri} --workers 1"
    try:
        in_time(_WAIT_S, lambda: _publish(open_store(settings), settings, study, notes))
    except UNAVAILABLE as error:
        return f"{where}\nNote: not all is in MLflow yet ({reason(error)}); the same command publishes the rest."
    return where


def _publish(store: Store, settings: StudySettings, study: Study, notes: Sequence[str]) -> None:
    parent = study_run(store, settings)
    ids: dict[str, str] = {}
    for run in study.usable.all:
        ids[run.name] = publish_training(store, parent, run.training, run.score_names)
    _publish_times(store, study, ids)
    publish_tasks(store, settings)
    files = sorted(path for path in (study.folder / COMPARISON).iterdir() if path.is_file())
    state = digest([sorted(ids.values()), {path.name: path.stat().st_mtime_ns for path in files}])
    with FileLock(store.lock, timeout=_LOCK_S):
        run = store.client.get_run(parent)
        if run.data.tags.get(PUBLISHED) != state:
            run = _fresh(store, settings, run, ids)
            for path in files:
                folder = "vector" if path.suffix == ".pdf" else None
                store.client.log_artifact(run.info.run_id, str(path), folder)
            for key, value in provenance(study.usable.all).items():
                store.client.set_tag(run.info.run_id, key, value)
            _describe(store, run, study, ids, notes)
            store.client.set_tag(run.info.run_id, PUBLISHED, state)
        store.client.set_terminated(run.info.run_id, str(Status.finished))


def _fresh(store: Store, settings: StudySettings, run: Run, ids: Mapping[str, str]) -> Run:
    """A run of the study without files of an earlier comparison, which MLflow cannot remove from a run."""
    client = store.client
    if PUBLISHED not in run.data.tags and not client.list_artifacts(run.info.run_id):
        return run
    anew = store.create(settings.study, {"kind": "study", "study": settings.study})
    client.log_batch(anew.info.run_id, params=[Param("scene", settings.scene_name)])
    children = client.search_runs([store.experiment_id], f"tags.`{PARENT}` = '{run.info.run_id}'")
    for run_id in {*ids.values(), *(child.info.run_id for child in children)}:
        client.set_tag(run_id, PARENT, anew.info.run_id)
    client.delete_run(run.info.run_id)
    return anew


def _publish_times(store: Store, study: Study, ids: Mapping[str, str]) -> None:
    """The time of a frame with each network, which is measured when a study is compared."""
    for row in study.runs.to_dict("records"):
        run_id = ids.get(f"{row['variant']}/seed{row['seed']}")
        ms = row.get(FRAME_TIME)
        if run_id is None or ms is None or pd.isna(ms):
            continue
        run = store.client.get_run(run_id)
        if run.data.metrics.get(FRAME_TIME) != ms:
            history = store.client.get_metric_history(run_id, FRAME_TIME) if FRAME_TIME in run.data.metrics else []
            store.client.log_batch(run_id, metrics=[Metric(FRAME_TIME, float(ms), run.info.end_time, len(history))])


def _describe(store: Store, run: Run, study: Study, ids: Mapping[str, str], notes: Sequence[str]) -> None:
    """The description of a study's run (links, its table, what a reader must know) and the means of the table."""
    first: dict[str, str] = {}
    for one in sorted(study.usable.runs, key=lambda r: r.seed):
        first.setdefault(one.label, ids[one.name])
    table = study.table[study.table["metric"].isin(shown_in(Shown.headline))]
    rows = analysis.to_markdown(table).splitlines()  # MLflow's pages show no space between the columns of a table
    spaced = [row if set(row) <= set("|-: ") else row.replace(" |", "\u00a0\u00a0|") for row in rows]
    report, compared = _pages(store, run.info.run_id, list(first.values()))
    links = f"[The report]({report}) · [the variants side by side]({compared})"
    store.client.set_tag(run.info.run_id, NOTE, "\n\n".join([links, "\n".join(spaced), *notes]))
    means = table[["metric", "variant", "mean"]].dropna().itertuples(index=False)
    logged = [
        Metric(re.sub(r"[^\w/. -]", "_", f"test/{metric}/{variant}"), float(mean), run.info.start_time, 0)
        for metric, variant, mean in means
        if abs(float(mean)) < float("inf")
    ]
    store.client.log_batch(run.info.run_id, metrics=logged)


def _pages(store: Store, run_id: str, run_ids: Sequence[str]) -> tuple[str, str]:
    """Links, relative to MLflow's address, to the report of a study's run, and to the comparison of some runs."""
    runs, experiments = (quote(json.dumps(list(ids))) for ids in (run_ids, [store.experiment_id]))
    report = f"#/experiments/{store.experiment_id}/runs/{run_id}/artifacts/report.html"
    return report, f"#/compare-runs?runs={runs}&experiments={experiments}"
