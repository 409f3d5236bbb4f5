"""What a study leaves in MLflow: one run a job however often it is stopped, what it shows, and the study's own page."""

import re
import shutil
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from ablate.comparison.compare import compare_study
from ablate.jobs.compose import jobs_of
from ablate.runs import train as run_module
from ablate.runs.job import Job
from ablate.runs.store_copy import log_samples
from ablate.runs.train import run_job
from ablate.tracking import default_uri
from mlflow import MlflowClient
from mlflow.entities import Run

TINY = ["preset=tiny", "simulator.image_shape=[96,134]", "dataset.frames=10"]
TINY += ["training.steps=4", "training.validate_every=1"]


@pytest.fixture(scope="module")
def stopped_once(tmp_path_factory: pytest.TempPathFactory, empty_database: Path) -> Job:
    """A job that was stopped at step 3 of 4, one after its checkpoint, and then finished; and its comparison."""
    runs = tmp_path_factory.mktemp("runs")
    shutil.copy(empty_database, runs)
    (job,) = jobs_of(["variant=sa2h", f"runs_dir={runs}", *TINY])

    def power_cut(*arguments: Any) -> None:
        log_samples(*arguments)
        if arguments[-1] == 3:
            raise RuntimeError("power cut")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_module, "log_samples", power_cut)
        with pytest.raises(RuntimeError, match="power cut"):
            run_job(job)
    run_job(job)
    compare_study(job.settings)
    return job


def runs_of(job: Job) -> tuple[MlflowClient, Run, Run]:
    """The client, the study's run and its only child."""
    client = MlflowClient(default_uri(job.settings.results))
    kinds = {run.data.tags["kind"]: run for run in client.search_runs(["1"])}
    assert sorted(kinds) == ["job", "study"]
    return client, kinds["study"], kinds["job"]


def test_frames_and_curves_go_on_where_a_job_was_stopped(stopped_once: Job) -> None:
    client, _, child = runs_of(stopped_once)
    names = [Path(a.path).name for a in client.list_artifacts(child.info.run_id, "images")]
    found = [re.match(r"frames~\d+\+step\+(\d+)\+.*\.png", name) for name in names]
    steps = Counter(match[1] for match in found if match)
    assert steps == dict.fromkeys(("0", "1", "2", "3", "4"), 2)  # two frames, each step once
    curve = client.get_metric_history(child.info.run_id, "val/psnr_fan_curve")
    assert sorted({point.step for point in curve}) == [0, 1, 2, 3, 4]
    scored = client.get_metric_history(child.info.run_id, "test/psnr")
    assert [point.step for point in scored] == [0]
    assert child.data.metrics["test/psnr"] == scored[-1].value
    newest = [name for name in names if name.startswith("newest~") and name.endswith("png")]
    assert len(newest) == 2
    assert all("+step+4+" in name for name in newest)


def test_a_run_has_the_parameters_that_people_sort_by_and_the_study_only_its_scene(stopped_once: Job) -> None:
    """Settings of a study are those of its first command, and a later one may have others."""
    _, study, child = runs_of(stopped_once)
    components = {"family": "local", "att": "illumination", "concat": "yes", "conv": "yes", "noise": "inject"}
    sizes = {"preset": "tiny", "dataset.frames": "10", "training.steps": "4", "training.batch_size": "1"}
    others = {"variant": "sa2h", "seed": "0", "training.precision": "fp32", "scene.anatomy_seed": "0"}
    assert child.data.params.items() >= (components | sizes | others).items()
    assert child.data.params.items() >= {"simulator.rays": "2", "dataset.split": "site", "model.width": "0.05"}.items()
    assert [key for key in child.data.params if key.startswith("model.")] == ["model.width"]  # others: as task=describe
    assert study.data.params == {"scene": "fetal"}
    assert {study.info.status, child.info.status} == {"FINISHED"}


def test_the_studys_page_links_to_report_and_comparison(stopped_once: Job) -> None:
    _, study, child = runs_of(stopped_once)
    note = study.data.tags["mlflow.note.content"]
    assert f"(#/experiments/1/runs/{study.info.run_id}/artifacts/report.html)" in note
    assert f"(#/compare-runs?runs=%5B%22{child.info.run_id}%22%5D&experiments=%5B%221%22%5D)" in note
    assert re.search(r"\| sa2h\s+\| 1\s+\| ", note)
    assert re.search(r"\n\| --- \| ---: \|", note)
    assert "nothing is compared" in note
    assert study.data.metrics.keys() >= {f"test/psnr/{name}" for name in ("sa2h", "re-simulation")}
    report = (stopped_once.settings.study_dir / "comparison" / "report.html").read_text("utf-8")
    assert study.data.tags.get("git_commit", "") in report  # there is none outside a checkout
    assert study.data.tags["hardware"] in report


def test_what_the_store_keeps_of_an_earlier_training_or_comparison_is_said(stopped_once: Job, tmp_path: Path) -> None:
    """MLflow forgets neither curves nor files."""
    client, study, _ = runs_of(stopped_once)
    (tmp_path / "boxplots.png").write_bytes(b"of two variants, one of which is gone")
    client.log_artifact(study.info.run_id, str(tmp_path / "boxplots.png"))
    shutil.rmtree(stopped_once.folder)
    (job,) = jobs_of(["variant=sa2h", f"runs_dir={stopped_once.settings.results}", *TINY])
    run_job(job)
    compare_study(job.settings)
    _, study, child = runs_of(job)
    said = study.data.tags["mlflow.note.content"]
    assert "Files of earlier comparisons, which are not made any more: boxplots.png." in said
    assert "**Trained again**" in child.data.tags["mlflow.note.content"]
