"""MLflow's run of a study: its comparison, and the runs of its trainings below it."""

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd
from filelock import FileLock
from mlflow.entities import Metric, Run

from ablate import analysis
from ablate.metrics import Shown, shown_in
from ablate.metrics.metric import FRAME_TIME
from ablate.publish.results_view import NOTE
from ablate.publish.shared_views import share_charts, share_leaderboard, share_studies
from ablate.publish.store import ABOUT, MOST_FOUND, Store, default_uri, open_store, plain_files, reason, store_uri
from ablate.publish.task_view import publish_tasks
from ablate.publish.training_view import PARENT, PUBLISHED, publish_training
from ablate.publish.waiting import in_time, tried
from ablate.settings.study import StudySettings
from ablate.storage import digest, digest_of_files
from ablate.study.log import Status
from ablate.study.opened import Study
from ablate.study.reading import provenance
from ablate.study.run import COMPARISON
from ablate.study.source_code import PACKAGE

_STUDY = "study"  # the kind of its run
_VIEW = 2  # changes when comparisons that were published before are to be published again
_LOCK_S = 60.0
_WAIT_S = 120.0  # a server that answers slowly or not at all is not waited for longer
_MARK_S = 20.0


def mark_study(settings: StudySettings, status: Status) -> None:
    """Say in the store that a study runs, or how it has ended; a store that does not answer stops nothing."""

    def mark() -> None:
        store = open_store(settings)
        store.client.update_run(study_run(store, settings), status=str(status))

    tried(lambda: in_time(_MARK_S, mark))


def study_run(store: Store, settings: StudySettings) -> str:
    """Id of the run of a study; it is created when there is none."""
    with FileLock(store.lock, timeout=_LOCK_S):
        run = store.find(_STUDY, {"study": settings.study})
        return _new_run(store, settings) if run is None else str(run.info.run_id)


def _new_run(store: Store, settings: StudySettings) -> str:
    command = f"python -m ablate task=compare study_name={shlex.quote(settings.study)}"
    source = {"mlflow.source.name": command, "mlflow.source.type": "LOCAL"}  # the column Source
    run_id = str(store.create(settings.study, _STUDY, {"study": settings.study} | source).info.run_id)
    store.client.log_param(run_id, "scene", settings.scene_name)
    return run_id


def publish_study(settings: StudySettings, study: Study, notes: Sequence[str]) -> str:
    """Publish the runs of a study and its comparison; returns where they are, in words.

    What a reader must know of the comparison are its `notes`. A store that does not answer is named, and not waited
    for.
    """
    uri = store_uri(settings)
    where = f"{_how_to_look(uri)}, and open {settings.study}"
    try:
        in_time(_WAIT_S, lambda: _publish(open_store(settings), settings, study, notes))
    except Exception as error:  # whatever it is, the comparison is on disk
        return f"{where}\nNote: not all is in MLflow yet ({reason(error)}); the same command publishes the rest."
    return where


def _how_to_look(uri: str) -> str:
    """The address of a server, or the command that starts one for a database."""
    if uri.startswith("http"):
        return uri
    here = Path.cwd()
    has_make = here == PACKAGE.resolve().parents[1] and uri == default_uri(here / "runs")
    return "make ui" if has_make else f"mlflow ui --workers 1 --backend-store-uri {shlex.quote(uri)}"


def _publish(store: Store, settings: StudySettings, study: Study, notes: Sequence[str]) -> None:
    parent = study_run(store, settings)
    ids = {run.name: publish_training(store, parent, run.training, run.score_names) for run in study.usable.all}
    _publish_times(store, study, ids)
    publish_tasks(store, settings)
    _publish_comparison(store, settings, study, ids, notes)


def _publish_comparison(
    store: Store, settings: StudySettings, study: Study, ids: Mapping[str, str], notes: Sequence[str]
) -> None:
    """Make the run of a study equal to its folder of comparison; `ids` are the runs of its trainings by name."""
    client = store.client
    files = plain_files((study.folder / COMPARISON).iterdir())
    state = digest([_VIEW, digest_of_files(files), sorted(ids.values()), list(notes)])
    with FileLock(study.folder / ".publish.lock", timeout=_LOCK_S):
        run = client.get_run(study_run(store, settings))
        if run.data.tags.get(PUBLISHED) != state:
            run = _without_earlier(store, settings, run)
            run_id = run.info.run_id
            store.log_files(run_id, files)
            for key, value in provenance(study.usable.all).items():
                client.set_tag(run_id, key, value)
            _describe(store, run, study, ids, notes)
            client.set_tag(run_id, PUBLISHED, state)
        if run.info.status != Status.finished:
            client.set_terminated(run.info.run_id, str(Status.finished))


def _without_earlier(store: Store, settings: StudySettings, run: Run) -> Run:
    """The run of a study, or a new one where it has files and values of an earlier comparison.

    MLflow cannot take them out of a run, and of two values shows the larger.
    """
    client = store.client
    if PUBLISHED not in run.data.tags and not client.list_artifacts(run.info.run_id):
        return run
    with FileLock(store.lock, timeout=_LOCK_S):
        run_id = _new_run(store, settings)
        below = f"tags.`{PARENT}` = '{run.info.run_id}'"
        for child in client.search_runs([store.experiment_id], below, max_results=MOST_FOUND):
            client.set_tag(child.info.run_id, PARENT, run_id)
        store.discard(run)
    return client.get_run(run_id)


def _publish_times(store: Store, study: Study, ids: Mapping[str, str]) -> None:
    """The time of a frame with each network, which is measured when a study is compared."""
    for row in study.runs.to_dict("records"):
        run_id = ids.get(f"{row['variant']}/seed{row['seed']}")
        ms = row.get(FRAME_TIME)
        if run_id is None or ms is None or pd.isna(ms):
            continue
        run = store.client.get_run(run_id)
        if run.data.metrics.get(FRAME_TIME) != ms:
            store.client.log_metric(run_id, FRAME_TIME, float(ms))  # MLflow shows the newest


def _describe(store: Store, run: Run, study: Study, ids: Mapping[str, str], notes: Sequence[str]) -> None:
    """The description of a study's run: who is best, links, its table, what a reader must know; and the best scores."""
    first: dict[str, str] = {}
    for finished in sorted(study.usable.runs, key=lambda r: r.seed):
        first.setdefault(finished.label, ids[finished.name])
    table, client = study.table, store.client
    order = analysis.best_first(table)
    report = f"#/experiments/{store.experiment_id}/runs/{run.info.run_id}/artifacts/report.html"
    links = {
        "Leaderboard": share_leaderboard(store, study),
        "Side by side": share_charts(store, study, [first[name] for name in order if name in first]),
        "Report": report,
    }
    best = f"**Best**: {analysis.best_in_words(table, study.results.claims, study.reference)}."
    shown = table[table["metric"].isin(shown_in(Shown.headline))].sort_values(
        "variant", key=lambda names: names.map(order.index), kind="stable"
    )
    rows = analysis.to_markdown(shown).splitlines()  # MLflow's pages show no space between the columns of a table
    spaced = [row if set(row) <= set("|-: ") else row.replace(" |", "\u00a0\u00a0|") for row in rows]
    linked = " · ".join(f"[{name}]({link})" for name, link in links.items())
    client.set_tag(run.info.run_id, NOTE, "\n\n".join([best, linked, "\n".join(spaced), *notes]))
    client.set_tag(run.info.run_id, "best", order[0])
    scores = shown[(shown["variant"] == order[0]) & shown["mean"].notna()]
    logged = [
        Metric(f"test/{row['metric']}", float(row["mean"]), run.info.start_time, 0) for row in scores.to_dict("records")
    ]
    store.log_metrics(run.info.run_id, logged)
    about = f"[All studies]({share_studies(store)}), each with its best network. {ABOUT}"
    client.set_experiment_tag(store.experiment_id, NOTE, about)
