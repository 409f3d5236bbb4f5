"""A whole study at a tiny size: simulated, trained, compared, tracked; killed, continued, repeated."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest
from mlflow import MlflowClient

from ablate.studies import tasks
from ablate.studies.run import run_job
from ablate.studies.sweep import Job, jobs_of
from ablate.tracking import default_uri

TINY = [
    "scene.triangles=6000",
    "simulator.scanlines=24",
    "simulator.axial_samples=128",
    "simulator.rays=2",
    "simulator.layers=1",
    "simulator.image_shape=[128,178]",
    "dataset.frames=12",
    "dataset.grid=[3,4,1,1]",
    "dataset.validation=0.2",
    "dataset.test=0.3",
    "dataset.shard=3",
    "dataset.workers=1",
    "model.width=0.05",
    "training.steps=6",
    "training.crop=64",
    "training.checkpoint_every=2",
    "training.validate_every=3",
    "evaluation.timed_frames=2",
    "evaluation.pictures=2",
]


def sweep(runs: Path, *more: str) -> list[Job]:
    return jobs_of(["-m", "variant=sa2h,sa2h-att", f"runs_dir={runs}", *TINY, *more])


def study(jobs: list[Job]) -> int:
    return tasks.study(jobs, lambda: [run_job(job) for job in jobs] and None)


def state(runs: Path) -> dict[str, float]:
    """Modification times of everything that counts as made."""
    kinds = {".json", ".ckpt", ".parquet", ".npz", ".csv", ".html"}
    made = {str(p): p.stat().st_mtime for p in runs.rglob("*") if p.is_file() and p.suffix in kinds}
    return made | {str(p): p.stat().st_mtime for p in runs.glob("data/*/pairs.zarr/*/c/*/0/0")}


def command(runs: Path, *more: str) -> list[str]:
    sweep_of_two = ["-m", "variant=sa2h,sa2h-att", "hydra/launcher=joblib", f"runs_dir={runs}"]
    return [sys.executable, "-m", "ablate", *sweep_of_two, *TINY, *more]


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study made by the command that README names, two jobs at a time."""
    runs = tmp_path_factory.mktemp("runs")
    done = subprocess.run(command(runs), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for said in ("re-simulation", "sa2h-att", "report.html", "mlflow ui"):
        assert said in done.stdout
    return runs


def test_the_parent_run_carries_the_comparison(finished: Path) -> None:
    client = MlflowClient(default_uri(finished))
    experiment = client.get_experiment_by_name("ablate")
    assert experiment is not None
    runs = client.search_runs([experiment.experiment_id])
    (parent,) = [r for r in runs if r.data.tags.get("kind") == "study"]
    children = [r for r in runs if r.data.tags.get("mlflow.parentRunId") == parent.info.run_id]
    assert sorted(r.info.run_name for r in children) == ["sa2h-att/seed0", "sa2h/seed0"]
    assert {r.info.status for r in runs} == {"FINISHED"}
    artifacts = {a.path for a in client.list_artifacts(parent.info.run_id)}
    assert artifacts >= {
        "table.csv",
        "table.tex",
        "table.md",
        "claims.csv",
        "paired.csv",
        "report.html",
        "boxplot_psnr.png",
        "pchi2_maps_0.png",
        "qualitative_0.png",
        "error_vs_runtime.png",
    }
    for child in children:
        metrics, tags = child.data.metrics, child.data.tags
        for name in ("psnr", "mae", "pchi2", "psnr_fan", "mae_smooth", "nyquist_excess", "fd_speckle", "noise_sd"):
            assert f"test/{name}" in metrics
            assert f"test/floor_{name}" in metrics
        assert {"ms_per_frame", "train/l1", "val/psnr"} <= metrics.keys()
        assert {"variant", "seed", "study", "config_hash", "data_hash"} <= tags.keys()
        assert {a.path for a in client.list_artifacts(child.info.run_id, "provenance")} >= {
            "provenance/config.json",
            "provenance/environment.txt",
        }


def test_simulate_makes_again_what_is_damaged_and_only_that(finished: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (damaged, *_), before = sorted(finished.glob("data/*/pairs.zarr/high/c/*/0/0")), state(finished)
    whole = damaged.read_bytes()
    damaged.write_bytes(whole[:100] + bytes([whole[100] ^ 1]) + whole[101:])
    assert tasks.simulate(sweep(finished, "task=simulate")) == 0
    told = capsys.readouterr().err
    assert f"{damaged}, 'high' of frames 0 to 2, is damaged" in told
    assert damaged.read_bytes() == whole
    after = state(finished)
    assert {path for path in before if after[path] != before[path]} == {str(damaged)}


def test_paired_differences_are_those_of_the_per_image_values(finished: Path) -> None:
    folder = next(finished.glob("quick-fetal"))
    paired = pd.read_csv(folder / "comparison" / "paired.csv")
    named = ["variant", "reference", "metric", "shift", "low", "high", "p_holm", "effect", "n"]
    assert list(paired.columns) == [*named, "p_sites_holm", "sites", "dropped"]
    row = paired[(paired["variant"] == "sa2h-att") & (paired["metric"] == "mae")].iloc[0]
    values = {}
    for variant in ("sa2h", "sa2h-att"):
        table = pd.read_parquet(folder / variant / "seed0" / "per_image.parquet")
        chosen = (table["split"] == "test") & (table["source"] == "model") & (table["metric"] == "mae")
        values[variant] = table[chosen].set_index("frame")["value"]
    difference = (values["sa2h-att"] - values["sa2h"]).to_numpy()
    walsh = [(a + b) / 2 for i, a in enumerate(difference) for b in difference[i:]]
    assert row["shift"] == pytest.approx(pd.Series(walsh).median(), abs=1e-9)
    assert row["n"] == len(difference)


def test_the_same_command_again_repeats_nothing(finished: Path) -> None:
    before = state(finished)
    assert tasks.study(sweep(finished), lambda: pytest.fail("nothing is left to launch")) == 0
    assert state(finished) == before


def test_another_configuration_in_the_study_is_refused_and_nothing_is_lost(finished: Path) -> None:
    before = state(finished)
    with pytest.raises(ValueError, match=r"holds another configuration.*training\.steps: 6 there, 9 here"):
        study(sweep(finished, "training.steps=9"))
    assert state(finished) == before


def test_compare_rebuilds_from_disk_and_plan_tells_what_is_there(
    finished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = next(finished.glob("*/comparison/report.html"))
    report.unlink()
    assert tasks.TASKS[jobs_of(["task=compare"])[0].settings.task](sweep(finished)[:1]) == 0
    assert report.exists()
    capsys.readouterr()
    tasks.plan([*sweep(finished), *sweep(finished, "seed=1")])
    printed = capsys.readouterr().out
    assert printed.count(" finished ") == 2
    assert printed.count(" missing ") == 2
    assert "2 of 4 jobs are left: about" in printed


def test_a_job_that_fails_is_said_and_the_others_are_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    jobs = sweep(tmp_path, "training.steps=2")

    def broken(*_: object, **__: object) -> None:
        raise FloatingPointError("the loss is not finite")

    def launch() -> None:
        run_job(jobs[0])
        monkeypatch.setattr("ablate.studies.run.train", broken)
        with pytest.raises(FloatingPointError):
            run_job(jobs[1])

    assert tasks.study(jobs, launch) == 1
    printed = capsys.readouterr()
    assert "There is one variant" in printed.out
    assert "not finished: sa2h-att/seed0" in printed.err
    client = MlflowClient(default_uri(tmp_path))
    (experiment,) = [e for e in client.search_experiments() if e.name == "ablate"]
    states = {r.info.run_name: r.info.status for r in client.search_runs([experiment.experiment_id])}
    assert states == {"quick-fetal": "FAILED", "sa2h/seed0": "FINISHED", "sa2h-att/seed0": "FAILED"}


def test_the_notebook_reads_the_study(finished: Path) -> None:
    notebook = Path(__file__).parents[2] / "notebooks" / "table2.py"
    environment = {**os.environ, "ABLATE_STUDY": str(finished / "quick-fetal")}
    done = subprocess.run([sys.executable, notebook], env=environment, capture_output=True, text=True, check=True)
    assert "re-simulation" in done.stdout
    assert r"\toprule" in done.stdout
    nowhere = {**os.environ, "ABLATE_STUDY": str(finished / "nowhere")}
    missing = subprocess.run([sys.executable, notebook], env=nowhere, capture_output=True, text=True, check=False)
    assert missing.returncode != 0
    assert "make sweep" in missing.stderr


def wait_for(condition: Callable[[], object], process: subprocess.Popen[bytes]) -> None:
    deadline = time.monotonic() + 180
    while not condition() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)


def start(*arguments: str) -> subprocess.Popen[bytes]:
    quiet = subprocess.DEVNULL
    return subprocess.Popen(arguments, start_new_session=True, stderr=quiet, stdout=quiet)


@pytest.mark.slow
def test_a_killed_sweep_is_finished_by_the_same_command(tmp_path: Path) -> None:
    """Killed while simulating, with all its processes; then while training, the parent alone."""
    again = command(tmp_path, "training.steps=80", "dataset.frames=12")

    def shards() -> dict[Path, float]:
        return {p: p.stat().st_mtime for p in tmp_path.glob("data/*/pairs.zarr/high/c/*/0/0")}

    first = start(*again)
    wait_for(lambda: shards(), first)
    os.killpg(first.pid, signal.SIGKILL)
    first.wait()
    simulated = shards()
    assert 0 < len(simulated) < 4

    place = tmp_path / "quick-fetal" / "sa2h" / "seed0"
    second = start(*again)
    wait_for(lambda: (place / "last.ckpt").exists(), second)
    os.kill(second.pid, signal.SIGKILL)
    second.wait()
    assert not (place / "result.json").exists()

    done = subprocess.run(again, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert {p: m for p, m in shards().items() if p in simulated} == simulated
    results = [json.loads(p.read_text()) for p in tmp_path.glob("quick-fetal/*/seed0/result.json")]
    assert len(results) == 2
    client = MlflowClient(default_uri(tmp_path))
    (experiment,) = [e for e in client.search_experiments() if e.name == "ablate"]
    runs = client.search_runs([experiment.experiment_id])
    assert sorted(r.info.run_name or "" for r in runs) == ["quick-fetal", "sa2h-att/seed0", "sa2h/seed0"]
    assert {r.info.status for r in runs} == {"FINISHED"}


@pytest.mark.slow
def test_a_run_killed_in_training_is_resumed(tmp_path: Path) -> None:
    alone = [sys.executable, "-m", "ablate", f"runs_dir={tmp_path}", *TINY, "training.steps=80"]
    place = tmp_path / "quick-fetal" / "sa2h" / "seed0"
    first = start(*alone)
    wait_for(lambda: (place / "last.ckpt").exists(), first)
    os.killpg(first.pid, signal.SIGKILL)
    first.wait()
    done = subprocess.run(alone, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads((place / "result.json").read_text())["scalars"]["train/resumed_at"] >= 2
