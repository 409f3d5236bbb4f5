"""A whole study at a tiny size: simulated, trained, compared, tracked; killed, continued, repeated."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import pandas as pd
import pytest
from ablate.jobs.compose import jobs_of
from ablate.jobs.launch import Launch
from ablate.runs.job import Job
from ablate.runs.run import Run, State
from ablate.runs.train import run_job
from ablate.tracking import default_uri
from mlflow import MlflowClient

from ablate.settings.study import ConfigurationError, StudySettings
from ablate.tasks import run_task as tasks
from support.studies import SWEEP, TINY, TinyStudy, Unrendered, run


def sweep(runs: Path, *more: str) -> list[Job]:
    return jobs_of([*SWEEP, f"runs_dir={runs}", *more])


def state(runs: Path) -> dict[str, float]:
    """Modification times of everything that counts as made."""
    kinds = {".json", ".ckpt", ".parquet", ".npz", ".csv", ".html"}
    made = {str(p): p.stat().st_mtime for p in runs.rglob("*") if p.is_file() and p.suffix in kinds}
    return made | {str(p): p.stat().st_mtime for p in runs.glob("data/*/pairs.zarr/*/c/*/0/0")}


def command(runs: Path, *more: str) -> list[str]:
    return [sys.executable, "-m", "ablate", *SWEEP, f"runs_dir={runs}", *more]


@pytest.fixture
def finished(tiny_study: TinyStudy) -> Path:
    return tiny_study.runs


def test_the_comparison_is_printed(tiny_study: TinyStudy) -> None:
    for words in ("re-simulation", "sa2h-att", "report.html", "mlflow ui"):
        assert words in tiny_study.printed


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
    figures = {f"{name}.png" for name in ("boxplot_psnr", "pchi2_maps_0", "qualitative_0", "error_vs_runtime")}
    assert artifacts >= {"table.csv", "table.tex", "claims.csv", "paired.csv", "report.html"} | figures
    times = pd.read_csv(finished / "tiny-fetal" / "comparison" / "runs.csv").set_index("variant")
    for child in children:
        metrics, tags = child.data.metrics, child.data.tags
        for name in ("psnr", "mae", "pchi2", "psnr_fan", "mae_smooth", "nyquist_excess", "fd_speckle", "noise_sd"):
            assert f"test/{name}" in metrics
            assert f"test/floor_{name}" in metrics
        assert {"ms_per_frame", "train/l1", "val/psnr"} <= metrics.keys()
        assert metrics["ms_per_frame"] == times.loc[child.data.tags["variant"], "ms_per_frame"]
        assert {"variant", "seed", "study", "config_hash", "data_hash"} <= tags.keys()
        kept = {a.path for a in client.list_artifacts(child.info.run_id, "provenance")}
        assert kept >= {"provenance/config.json", "provenance/environment.txt"}


def test_simulate_makes_again_what_is_damaged_and_only_that(finished: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (damaged, *_), before = sorted(finished.glob("data/*/pairs.zarr/target/c/*/0/0")), state(finished)
    whole = damaged.read_bytes()
    damaged.write_bytes(whole[:100] + bytes([whole[100] ^ 1]) + whole[101:])
    kept = damaged.parents[5] / "pixels.json"
    of_frames = {path: path.read_text() for path in (kept, *kept.parent.glob("resimulation/*.json"))}
    assert len(of_frames) == 3
    assert run(*SWEEP, f"runs_dir={finished}", "task=simulate") == 0
    assert not any(path.exists() for path in of_frames), "a digest and scores of frames that were made again"
    for path, content in of_frames.items():
        path.write_text(content)
    told = capsys.readouterr().err
    assert f"{damaged}, 'target' of frames 0 to 2, is damaged" in told
    assert damaged.read_bytes() == whole
    after = state(finished)
    assert {path for path in before if after[path] != before[path]} == {str(damaged), *map(str, of_frames)}


def test_paired_differences_are_those_of_the_per_image_values(finished: Path) -> None:
    folder = next(finished.glob("tiny-fetal"))
    paired = pd.read_csv(folder / "comparison" / "paired.csv")
    named = ["variant", "reference", "metric", "shift", "lower", "upper", "p_holm", "effect", "n"]
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
    assert tasks.study(sweep(finished), Launch(lambda *_: pytest.fail("nothing is left to launch"))) == 0
    assert state(finished) == before


@pytest.mark.slow
def test_a_killed_scoring_loses_no_result(finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A finished run is scored again; the process ends in the middle of a file."""
    job, before = sweep(finished)[0], state(finished)
    result, per_image = job.folder / "result.json", job.folder / "per_image.parquet"
    whole = json.loads(result.read_text())
    result.write_text(json.dumps(whole | {"metrics_version": 1}))

    def killed(_: pd.DataFrame, path: Path) -> None:
        path.write_bytes(b"PAR1 and no more")
        raise SystemExit

    with monkeypatch.context() as patch:
        patch.setattr(pd.DataFrame, "to_parquet", killed)
        with pytest.raises(SystemExit):
            run_job(job)
    assert before[str(per_image)] == per_image.stat().st_mtime
    assert run(*SWEEP, f"runs_dir={finished}") == 0
    assert json.loads(result.read_text())["scalars"].keys() == whole["scalars"].keys()

    lacking = {name: value for name, value in whole["scalars"].items() if name != "parameters_generator"}
    result.write_text(json.dumps(whole | {"scalars": lacking}))
    assert "parameters_generator in result.json: start it again" in Run(job.folder).why
    assert run(*SWEEP, f"runs_dir={finished}") == 0
    assert Run(job.folder).state is State.finished


def test_one_word_scores_a_finished_run_again_and_trains_none(finished: Path) -> None:
    jobs = sweep(finished, "evaluation.again=true")[:1]
    folder = jobs[0].folder
    again = Launch(lambda waiting, work: [work(job) for job in waiting] and None, compares=False)
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    whole = json.loads((folder / "result.json").read_text())
    wrong = {**whole["scalars"], "test/mae": 0.0}
    (folder / "result.json").write_text(json.dumps(whole | {"scalars": wrong}))
    floors = {path: path.read_text() for path in (jobs[0].data.folder / "resimulation").glob("test-*.json")}
    for path, content in floors.items():
        path.write_text(content.replace('"mae"', '"psnr"'))
    assert tasks.study(jobs, again) == 0
    assert [path.read_text() for path in floors if path.exists()] == [text for p, text in floors.items() if p.exists()]
    assert any(path.exists() for path in floors), "re-simulation is scored again, too"
    scored = json.loads((folder / "result.json").read_text())["scalars"]
    assert scored["test/mae"] == pytest.approx(whole["scalars"]["test/mae"])
    checkpoint = jobs[0].run.checkpoint
    assert checkpoint.read_bytes() == before[checkpoint]
    checkpoint.write_bytes(before[checkpoint][:100])
    with pytest.raises(ConfigurationError, match=r"evaluation\.again=true: .*last\.ckpt: not a readable checkpoint"):
        tasks.study(jobs, again)
    assert jobs[0].run.state is State.finished, "its scores are still good"
    checkpoint.unlink()
    with pytest.raises(ConfigurationError, match=r"evaluation\.again=true: .*last\.ckpt"):
        tasks.study(jobs, again)
    for path, content in before.items():
        path.write_bytes(content)
    assert run(*SWEEP, f"runs_dir={finished}") == 0, "and the store has its copy of it again"


def test_the_studys_run_is_closed_where_the_comparison_is_kept(finished: Path) -> None:
    """Another command has finished the last job meanwhile, and compared."""
    result = sweep(finished)[0].folder / "result.json"
    before = result.rename(result.with_suffix(".away"))
    assert tasks.study(sweep(finished), Launch(lambda *_: before.rename(result) and None)) == 0
    client = MlflowClient(default_uri(finished))
    assert {run.info.status for run in client.search_runs(["1"])} == {"FINISHED"}


def test_another_configuration_in_the_study_is_refused_and_nothing_is_lost(finished: Path) -> None:
    before = state(finished)
    with pytest.raises(ValueError, match=r"holds another configuration.*training\.steps: 6 there, 9 here"):
        run(*SWEEP, f"runs_dir={finished}", "training.steps=9")
    assert state(finished) == before


def test_compare_rebuilds_from_disk_and_plan_tells_what_is_there(
    finished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = next(finished.glob("*/comparison/report.html"))
    report.unlink()
    assert run("task=compare", *TINY, f"runs_dir={finished}") == 0
    assert report.exists()
    assert "scores nothing" not in capsys.readouterr().out
    assert run("task=compare", *TINY, f"runs_dir={finished}", "evaluation.again=true") == 0
    assert "Note: evaluation.again: task=compare scores nothing" in capsys.readouterr().out
    assert run("task=plan", *SWEEP, "seed=0,1", f"runs_dir={finished}") == 0
    printed = capsys.readouterr().out
    assert printed.count(" finished ") == 2
    assert printed.count(" missing ") == 2
    assert "2 of 4 jobs are left: about" in printed


def test_a_job_that_fails_is_said_and_the_others_are_compared(
    runs: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("ablate.analysis.figures.style.Figure", Unrendered)
    jobs = sweep(runs, "training.steps=2")

    def broken(*_: object, **__: object) -> None:
        raise FloatingPointError("the loss is not finite")

    def launch(waiting: Sequence[Job], work: Callable[[Job], object]) -> None:
        assert list(waiting) == jobs
        work(jobs[0])
        monkeypatch.setattr("ablate.runs.train.train", broken)
        with pytest.raises(FloatingPointError):
            work(jobs[1])

    assert tasks.study(jobs, Launch(launch)) == 1
    printed = capsys.readouterr()
    assert "There is one variant" in printed.out
    assert "not finished: sa2h-att/seed0" in printed.err
    client = MlflowClient(default_uri(runs))
    (experiment,) = [e for e in client.search_experiments() if e.name == "ablate"]
    states = {r.info.run_name: r.info.status for r in client.search_runs([experiment.experiment_id])}
    assert states == {"tiny-fetal": "FAILED", "sa2h/seed0": "FINISHED", "sa2h-att/seed0": "FAILED"}


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
        return {p: p.stat().st_mtime for p in tmp_path.glob("data/*/pairs.zarr/target/c/*/0/0")}

    first = start(*again)
    wait_for(lambda: shards(), first)
    os.killpg(first.pid, signal.SIGKILL)
    first.wait()
    simulated = shards()
    assert 0 < len(simulated) < 4

    place = tmp_path / "tiny-fetal" / "sa2h" / "seed0"
    second = start(*again)
    wait_for(lambda: (place / "last.ckpt").exists(), second)
    os.kill(second.pid, signal.SIGKILL)
    second.wait()
    assert not (place / "result.json").exists()

    done = subprocess.run(again, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert {p: m for p, m in shards().items() if p in simulated} == simulated
    assert len(list(tmp_path.glob("tiny-fetal/*/seed0/result.json"))) == 2
    assert json.loads((place / "result.json").read_text())["scalars"]["train/resumed_at"] >= 2
    client = MlflowClient(default_uri(tmp_path))
    (experiment,) = [e for e in client.search_experiments() if e.name == "ablate"]
    runs = client.search_runs([experiment.experiment_id])
    assert sorted(r.info.run_name or "" for r in runs) == ["sa2h-att/seed0", "sa2h/seed0", "tiny-fetal"]
    assert {r.info.status for r in runs} == {"FINISHED"}


def test_whatever_lies_beside_a_study_can_give_none_its_name(finished: Path) -> None:
    beside = {path.name for path in finished.iterdir()} - {"tiny-fetal"}
    assert {"data", "artifacts", "mlflow.db"} <= beside
    for name in (*beside, "precision", "stability", "slurm", "mlflow.db-journal"):
        with pytest.raises(ValueError, match=r"^study_name="):
            StudySettings(study_name=name)
    for folder in {path.parent.parent.name for path in finished.glob("tiny-fetal/*/*")} - {"sa2h", "sa2h-att"}:
        if folder != "tiny-fetal":
            with pytest.raises(ValueError, match=r"^variant="):
                Job(StudySettings(), folder)


@pytest.mark.parametrize("name", ["..", "comparison/.."])
def test_a_comparison_replaces_nothing_outside_its_study(finished: Path, tmp_path: Path, name: str) -> None:
    thesis = tmp_path / "comparison" / "thesis.txt"
    thesis.parent.mkdir()
    thesis.write_text("the only copy")
    shutil.copytree(finished / "tiny-fetal" / "sa2h", tmp_path / "sa2h")
    shutil.copytree(finished / "tiny-fetal" / "sa2h", tmp_path / "runs" / "comparison" / "sa2h")
    with pytest.raises(ValueError, match=r"^study_name="):
        run("task=compare", *TINY, f"runs_dir={tmp_path / 'runs'}", f"study_name={name}")
    assert thesis.read_text() == "the only copy"
