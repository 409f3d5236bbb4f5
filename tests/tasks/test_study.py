"""A whole study at a tiny size: simulated, trained, compared, tracked; killed, continued, repeated."""

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
from mlflow import MlflowClient

from ablate.command.compose import jobs_of
from ablate.command.launch import Launch
from ablate.publish import default_uri
from ablate.settings.study import ConfigurationError, StudySettings
from ablate.study.job import Job
from ablate.study.run import read_list
from ablate.study.training import Training
from ablate.tasks import study as tasks
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
    of_frames = {path: path.read_text() for path in (kept, *kept.parent.glob("baselines/*.json"))}
    assert len(of_frames) > 2
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
        (file,) = folder.glob(f"{variant}-seed0-*/scores/mae@*.parquet")
        table = pd.read_parquet(file)
        chosen = (table["split"] == "test") & (table["source"] == "model")
        values[variant] = table[chosen].set_index("frame")["value"]
    difference = (values["sa2h-att"] - values["sa2h"]).to_numpy()
    walsh = [(a + b) / 2 for i, a in enumerate(difference) for b in difference[i:]]
    assert row["shift"] == pytest.approx(pd.Series(walsh).median(), abs=1e-9)
    assert row["n"] == len(difference)


def test_the_same_command_again_repeats_nothing(finished: Path) -> None:
    before = state(finished)
    assert tasks.study(sweep(finished), Launch(lambda *_: pytest.fail("nothing is left to launch"))) == 0
    assert state(finished) == before


def test_a_killed_scoring_loses_no_score_and_is_done_by_the_same_command(
    finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The process ends in the middle of a file."""
    job, before = sweep(finished)[0], state(finished)
    lost = [job.training.scores / key.file_name for key in job.wanted if key.metric in ("crps", "mae")]
    contents = [pd.read_parquet(path) for path in lost]
    for path in lost:
        path.unlink()

    def killed(path: Path, *_: object, **__: object) -> None:
        path.write_bytes(b"PAR1 and no more")
        raise SystemExit

    with monkeypatch.context() as patch:
        patch.setattr("ablate.study.scores.pq.ParquetWriter", killed)
        with pytest.raises(SystemExit):
            tasks.run_job(job)
    assert run(*SWEEP, f"runs_dir={finished}") == 0
    for path, content in zip(lost, contents, strict=True):
        pd.testing.assert_frame_equal(pd.read_parquet(path), content)
    kept = {path for path in before if "/scores/" in path} - {str(path) for path in lost}
    after = state(finished)
    assert all(after[path] == before[path] for path in kept)
    checkpoint = str(job.training.checkpoint)
    assert after[checkpoint] == before[checkpoint], "nothing is trained for a score"


def test_a_training_whose_checkpoint_is_gone_is_never_trained_over_its_scores(finished: Path, tmp_path: Path) -> None:
    runs = shutil.copytree(finished, tmp_path / "runs")
    job = sweep(runs)[0]
    job.training.checkpoint.unlink()
    assert job.finished, "nothing is missing that was asked for"
    (job.training.scores / job.wanted[0].file_name).unlink()
    before = state(job.folder)
    message = rf"last\.ckpt is missing, and sa2h/seed0 has no score of {job.wanted[0].metric}"
    with pytest.raises(ConfigurationError, match=message):
        run(*SWEEP, f"runs_dir={runs}")
    with pytest.raises(ConfigurationError, match=message):
        tasks.run_job(job)
    assert state(job.folder) == before


def test_a_score_that_is_added_later_leaves_what_the_training_was_made_with(finished: Path, tmp_path: Path) -> None:
    runs = shutil.copytree(finished, tmp_path / "runs")
    job = sweep(runs)[0]
    job.training.pictures_file.unlink()
    (job.training.scores / job.wanted[0].file_name).unlink()
    made = {path: path.read_bytes() for path in (job.folder / "provenance").iterdir()}
    tasks.run_job(job)
    assert job.finished
    assert made == {path: path.read_bytes() for path in (job.folder / "provenance").iterdir()}
    assert job.training.pictures, "pictures that were missing are rendered"


def test_the_studys_run_is_closed_where_the_comparison_is_kept(finished: Path) -> None:
    """Another command has finished the last job meanwhile, and compared."""
    score = next(sweep(finished)[0].training.scores.glob("mae@*"))
    away = score.rename(score.with_suffix(".away"))
    assert tasks.study(sweep(finished), Launch(lambda *_: away.rename(score) and None)) == 0
    client = MlflowClient(default_uri(finished))
    assert {run.info.status for run in client.search_runs(["1"])} == {"FINISHED"}


def test_another_configuration_of_the_same_names_is_another_training_and_nothing_is_lost(
    tiny_study: TinyStudy, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    finished = shutil.copytree(tiny_study.runs, tmp_path / "runs")
    before = state(finished)
    assert run("variant=sa2h", *TINY, f"runs_dir={finished}", "training.steps=2") == 0
    printed = capsys.readouterr().out
    assert "not in this comparison, as one command compares what it names: sa2h-att-seed0-" in printed
    assert [r.training.seed for r in read_list(finished / "tiny-fetal").runs] == [0], "two steps are compared alone"
    kept = {path: time for path, time in before.items() if "/tiny-fetal/sa2h" in path or "/data/" in path}
    assert state(finished).items() >= kept.items()
    assert len(list(finished.glob("tiny-fetal/sa2h-seed0-*"))) == 2
    assert run(*SWEEP, f"runs_dir={finished}") == 0, "and the first two are compared again"
    assert [r.name for r in read_list(finished / "tiny-fetal").runs] == ["sa2h/seed0", "sa2h-att/seed0"]


def test_repeating_one_job_of_a_sweep_keeps_its_comparison(finished: Path) -> None:
    before = state(finished)
    assert run("variant=sa2h", *TINY, f"runs_dir={finished}") == 0
    assert state(finished) == before


def test_compare_rebuilds_from_disk_and_plan_tells_what_is_there(
    finished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = next(finished.glob("*/comparison/report.html"))
    report.unlink()
    assert run("task=compare", *TINY, f"runs_dir={finished}") == 0
    assert report.exists()
    assert "sa2h-att" in capsys.readouterr().out, "the comparison that the study has"
    with pytest.raises(
        ConfigurationError, match=r"no finished run of this command \(nsa2h/seed3, lsa2h/seed3\)\. It holds .*sa2h/"
    ):
        run("task=compare", "-m", "variant=nsa2h,lsa2h", "seed=3", *TINY, f"runs_dir={finished}")
    assert run("task=plan", *SWEEP, "seed=0,1", f"runs_dir={finished}") == 0
    printed = capsys.readouterr().out
    assert printed.count(" finished ") == 2
    assert printed.count(" missing ") == 2
    assert "2 of 4 jobs are left: about" in printed


def test_compare_takes_all_that_is_trained_where_there_is_no_comparison(finished: Path, tmp_path: Path) -> None:
    runs = shutil.copytree(finished, tmp_path / "runs")
    shutil.rmtree(runs / "tiny-fetal" / "comparison")
    assert run("task=compare", *TINY, f"runs_dir={runs}") == 0
    assert {one.label for one in read_list(runs / "tiny-fetal").runs} == {"sa2h", "sa2h-att"}


def test_compare_takes_the_reference_that_its_command_names(finished: Path, tmp_path: Path) -> None:
    runs = shutil.copytree(finished, tmp_path / "runs")
    assert run("task=compare", "reference=sa2h-att", *TINY, f"runs_dir={runs}") == 0
    assert read_list(runs / "tiny-fetal").reference == "sa2h-att"
    compared = set(pd.read_csv(runs / "tiny-fetal" / "comparison" / "paired.csv")["variant"])
    assert "sa2h" in compared
    assert "sa2h-att" not in compared
    assert run("task=compare", *TINY, f"runs_dir={runs}") == 0
    assert read_list(runs / "tiny-fetal").reference == "sa2h-att", "the one that it has"


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
        monkeypatch.setattr("ablate.study.work.train", broken)
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

    second = start(*again)
    wait_for(lambda: list(tmp_path.glob("tiny-fetal/sa2h-seed0-*/last.ckpt")), second)
    os.kill(second.pid, signal.SIGKILL)
    second.wait()
    (place,) = tmp_path.glob("tiny-fetal/sa2h-seed0-*")
    assert not Training(place).is_trained

    done = subprocess.run(again, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert {p: m for p, m in shards().items() if p in simulated} == simulated
    assert len(list(tmp_path.glob("tiny-fetal/*/trained.json"))) == 2
    assert Training(place).result["scalars"]["train/resumed_at"] >= 2
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


@pytest.mark.parametrize("name", ["..", "comparison/.."])
def test_a_comparison_replaces_nothing_outside_its_study(finished: Path, tmp_path: Path, name: str) -> None:
    thesis = tmp_path / "comparison" / "thesis.txt"
    thesis.parent.mkdir()
    thesis.write_text("the only copy")
    shutil.copytree(finished / "tiny-fetal", tmp_path, dirs_exist_ok=True)
    thesis.write_text("the only copy")
    shutil.copytree(finished / "tiny-fetal", tmp_path / "runs" / "comparison")
    with pytest.raises(ValueError, match=r"^study_name="):
        run("task=compare", *TINY, f"runs_dir={tmp_path / 'runs'}", f"study_name={name}")
    assert thesis.read_text() == "the only copy"
