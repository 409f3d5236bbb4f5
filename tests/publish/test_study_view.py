"""A study has one run in MLflow: its comparison, above the runs of its trainings, all of it made again from disk."""

import base64
import json
import re
import shutil
import sqlite3
import time
import zlib
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

import pytest
from mlflow.entities import Run

from ablate.publish import default_uri, mark_study, publish_study, study_view
from ablate.study.compare import Compared, compare_study
from ablate.study.job import Job
from ablate.study.log import Status
from ablate.study.run import listed_runs
from support.published import active_runs, another_process, client_of, content_of, files_of, finish, job_in, written

VARIANTS = ("sa2h", "sa2h-att")


def compared(jobs: Sequence[Job], rebuild: bool = False) -> Compared:
    return compare_study(listed_runs(jobs), "study", rebuild, time_here=False)


def publish(jobs: Sequence[Job], rebuild: bool = False) -> str:
    """Compare jobs and publish that; returns what the terminal says of it."""
    another_process()
    of_jobs = compared(jobs, rebuild)
    link = of_jobs.study.folder / "comparison" / "linked.csv"
    with suppress(FileExistsError):
        link.symlink_to(jobs[0].folder / "training.json")  # of a stranger: it is not followed
    return publish_study(jobs[0].settings, of_jobs.study, of_jobs.notes)


def finished(runs: Path, variants: Sequence[str] = VARIANTS) -> list[Job]:
    """Finished jobs of some variants, each with scores of its own."""
    jobs = [job_in(runs, variant) for variant in variants]
    for level, job in enumerate(jobs, start=20):
        finish(job, float(level))
    return jobs


def study_in(runs: Path) -> Run:
    return active_runs(runs)["study"]


def shared_view(runs: Path, link: str) -> dict[str, Any]:
    """What MLflow's pages read of the experiment when a link is opened."""
    key = parse_qs(link.partition("?")[2])["viewStateShareKey"][0]
    content = client_of(runs).get_experiment("1").tags[f"mlflow.sharedViewState.{key}"]
    state: dict[str, Any] = json.loads(zlib.decompress(base64.b64decode(content.removeprefix("deflate;"))))
    return state


def test_the_page_of_a_study_says_who_is_best_and_links_to_what_shows_it(stopped_once: Job) -> None:
    runs = stopped_once.settings.results
    shown = active_runs(runs)
    study, child = shown["study"], shown["sa2h/seed0"]
    note = study.data.tags["mlflow.note.content"]
    assert note.startswith("**Best**: sa2h by ")
    assert study.data.tags["mlflow.source.name"] == "python -m ablate task=compare study_name=study"
    links = dict(re.findall(r"\[([^]]+)\]\((#/experiments/1/runs[^)]+)\)", note))
    assert links["Report"] == f"#/experiments/1/runs/{study.info.run_id}/artifacts/report.html"
    charts, table = (shared_view(runs, links[name]) for name in ("Side by side", "Leaderboard"))
    by_name = {run.info.run_id: run for run in shown.values()}
    for view, names in ((charts, {"sa2h/seed0"}), (table, {"sa2h/seed0"})):
        found = client_of(runs).search_runs(["1"], view["searchFilter"])
        assert {by_name[run.info.run_id].info.run_name for run in found} == names
    sections = {section["uuid"] for section in charts["compareRunSections"]}
    assert {card["metricSectionId"] for card in charts["compareRunCharts"]} <= sections
    bars = [card["metricKey"] for card in charts["compareRunCharts"] if card["type"] == "BAR"]
    assert set(bars) <= child.data.metrics.keys()
    assert {column.split("`")[1] for column in table["selectedColumns"]} <= child.data.metrics.keys() | {"ms_per_frame"}
    assert re.search(r"\| sa2h\s+\| 1", note)
    assert re.search(r"\n\| --- \| ---: \|", note)
    assert "nothing is compared" in note
    assert study.data.tags["best"] == "sa2h"
    assert child.data.metrics["ms_per_frame"] > 0
    assert (study.info.status, child.data.tags["mlflow.parentRunId"]) == ("FINISHED", study.info.run_id)


def test_make_is_named_where_the_makefile_is_that_of_the_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another project has a Makefile, too, and a folder of runs."""
    checkout = Path(__file__).parents[2]
    (tmp_path / "Makefile").touch()
    for folder in (tmp_path, checkout):
        monkeypatch.chdir(folder)
        with_make = study_view._how_to_look(default_uri(folder / "runs")) == "make ui"
        assert with_make is (folder == checkout)


def test_studies_are_in_one_table_with_the_best_network_of_each(stopped_once: Job) -> None:
    runs = stopped_once.settings.results
    (link,) = re.findall(
        r"\[All studies\]\((#[^)]+)\)", client_of(runs).get_experiment("1").tags["mlflow.note.content"]
    )
    view = shared_view(runs, link)
    (study,) = client_of(runs).search_runs(["1"], view["searchFilter"])
    kinds = {column.split(".")[0] for column in view["selectedColumns"]}
    assert kinds == {"tags", "metrics"}
    assert {"best", "test/psnr"} <= {column.split("`")[1] for column in view["selectedColumns"]}
    assert "test/psnr" in study.data.metrics


def test_the_run_of_a_study_has_the_files_of_its_comparison_and_how_it_was_made(runs: Path) -> None:
    jobs = finished(runs)
    assert "Note" not in publish(jobs)
    run = study_in(runs)
    on_disk = {path.name for path in (runs / "study" / "comparison").iterdir()} - {"linked.csv"}
    assert {"report.html", "table.csv", "table.tex", "verdicts.csv", "paired.csv"} < on_disk
    assert files_of(runs, run).keys() == on_disk
    assert run.data.metrics == {"test/psnr": 22.0, "test/mae": 22.0}, "of the network with the best PSNR"
    assert run.data.tags["best"] == "sa2h-att"
    assert run.data.tags.items() >= {"git_commit": "abc", "hardware": "a laptop"}.items()
    assert run.data.params == {"scene": "fetal"}
    parents = {name: content["parent"] for name, content in content_of(runs).items()}
    assert parents == {"study": "none", "sa2h/seed0": "study", "sa2h-att/seed0": "study"}


def test_publishing_again_writes_nothing(runs: Path) -> None:
    jobs = finished(runs)
    publish(jobs)
    before = written(runs)
    publish(jobs)
    compare_study(listed_runs(jobs), "study", rebuild=True, time_here=False)  # the same files once more
    publish(jobs)
    assert written(runs) == before


def test_nothing_of_an_earlier_comparison_stays(runs: Path) -> None:
    jobs = finished(runs)
    (compared(jobs).study.folder / "comparison" / "boxplots.png").write_bytes(b"of two variants")
    publish(jobs)
    first = study_in(runs)
    assert "boxplots.png" in files_of(runs, first)
    publish(jobs[:1], rebuild=True)  # otherwise the job would keep the comparison that it is in
    run = study_in(runs)
    assert "boxplots.png" not in files_of(runs, run)
    assert run.data.metrics["test/psnr"] == 21.0, "sa2h-att was better"
    children = {name: content["parent"] for name, content in content_of(runs).items() if name != "study"}
    assert children == {"sa2h/seed0": "study", "sa2h-att/seed0": "study"}, "it is a training of the study all the same"


def test_a_comparison_that_was_published_in_part_is_whole_in_the_end(
    runs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    jobs = finished(runs)
    with monkeypatch.context() as patch:
        patch.setattr(study_view, "_describe", lambda *_: 1 / 0)
        assert "not all is in MLflow yet (ZeroDivisionError: division by zero)" in publish(jobs)
    assert study_in(runs).info.status == "RUNNING"
    assert "Note" not in publish(jobs)
    assert study_in(runs).info.status == "FINISHED"
    assert "mlflow.note.content" in study_in(runs).data.tags


def deleted(runs: Path, name: str) -> None:
    client_of(runs).delete_run(active_runs(runs)[name].info.run_id)


def deleted_experiment(runs: Path) -> None:
    client_of(runs).delete_experiment("1")


def removed_files(runs: Path) -> None:
    (runs / "mlflow.db").unlink()
    shutil.rmtree(runs / "artifacts")


LOST = [partial(deleted, name="study"), partial(deleted, name="sa2h/seed0"), deleted_experiment, removed_files]


@pytest.mark.parametrize("lost", LOST, ids=["study", "training", "experiment", "files"])
def test_what_is_lost_in_mlflow_is_made_again_from_disk(runs: Path, lost: Callable[[Path], None]) -> None:
    jobs = finished(runs)
    publish(jobs[:1])
    publish(jobs)  # in place of the first, which must not come back
    before = content_of(runs)
    lost(runs)
    assert "Note" not in publish(jobs)
    assert content_of(runs) == before


def test_a_copy_of_a_folder_of_runs_is_published_there_and_leaves_the_original_alone(
    runs: Path, tmp_path: Path
) -> None:
    publish(finished(runs))
    shown, before = content_of(runs), written(runs)
    copy = tmp_path / "copy"
    shutil.copytree(runs, copy, symlinks=True)
    assert "Note" not in publish([job_in(copy, variant) for variant in VARIANTS])
    assert content_of(copy) == shown
    assert written(runs) == before


@pytest.mark.parametrize("place", ["elsewhere", "runs/artifacts-2/{id}/artifacts", "runs/artifacts/../../elsewhere"])
def test_artifacts_of_a_run_that_lie_elsewhere_are_not_written_to(runs: Path, place: str) -> None:
    """As in a folder of runs from a stranger, who knows where this one lies."""
    jobs = finished(runs, VARIANTS[:1])
    publish(jobs)
    with closing(sqlite3.connect(runs / "mlflow.db")) as connection, connection:
        connection.execute("DELETE FROM tags WHERE key = 'mlflow.ablate.published'")
        connection.execute("UPDATE runs SET status = 'RUNNING'")  # so that they are gone on with
        for (run_id,) in connection.execute("SELECT run_uuid FROM runs").fetchall():
            uri = f"{runs.parent.as_uri()}/{place.format(id=run_id)}"
            connection.execute("UPDATE runs SET artifact_uri = ? WHERE run_uuid = ?", (uri, run_id))
    assert "Note" not in publish(jobs)
    assert "Note" not in publish(jobs)
    assert len(list(runs.rglob("artifacts/*/artifacts/report.html"))) == 2, "the strange one's and another one"
    assert not [path for name in ("elsewhere", "runs/artifacts-2") for path in runs.parent.glob(name)]


def test_a_store_that_is_gone_or_slow_is_named_and_not_waited_for_and_has_all_later(
    runs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    jobs = finished(runs)
    where = publish([job_in(runs, variant, uri="http://127.0.0.1:9") for variant in VARIANTS])
    assert where.startswith("http://127.0.0.1:9, and open study\nNote: not all is in MLflow yet (")
    with monkeypatch.context() as patch:
        patch.setattr(study_view, "_WAIT_S", 0.2)
        patch.setattr(study_view, "_MARK_S", 0.2)
        patch.setattr(study_view, "open_store", lambda _: time.sleep(60))
        started = time.monotonic()
        mark_study(jobs[0].settings, Status.running)
        assert "Note: not all is in MLflow yet (TimeoutError: no end after 0.2 s)" in publish(jobs)
        assert time.monotonic() - started < 50
    assert not active_runs(runs)
    for status in (Status.running, Status.failed):
        mark_study(jobs[0].settings, status)
        assert study_in(runs).info.status == status
    assert "Note" not in publish(jobs)
    assert active_runs(runs).keys() == {"study", "sa2h/seed0", "sa2h-att/seed0"}
