"""Jobs on SLURM, with stand-ins for its commands: what is asked for, what is waited for, who simulates."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from submitit.slurm.slurm import SlurmJob

from ablate.config import register
from ablate.studies import tasks
from ablate.studies.data import dataset_folder, maps_needed, prepare_data
from ablate.studies.slurm import QueueWatcher, ended_jobs
from ablate.studies.sweep import ConfigurationError, Job, cluster_folder, configuration_dir, jobs_of

TINY = [
    "scene.triangles=6000",
    "simulator.scanlines=24",
    "simulator.axial_samples=128",
    "simulator.rays=1",
    "simulator.layers=1",
    "simulator.image_shape=[64,89]",
    "dataset.frames=6",
    "dataset.grid=[2,3,1,1]",
    "dataset.validation=0.2",
    "dataset.test=0.3",
    "dataset.shard=2",
    "dataset.workers=1",
    "training.crop=64",
]

Command = Callable[[str, str], None]


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Command:
    """Puts a shell script of a name in front of everything on PATH."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", f"{folder}:{os.environ['PATH']}")

    def make(name: str, script: str) -> None:
        (folder / name).write_text(f"#!/bin/sh\n{script}\n")
        (folder / name).chmod(0o755)

    return make


def submission(tmp_path: Path, *overrides: str) -> list[str]:
    """The lines of the script that `sbatch` is given for a job."""
    register()
    with initialize_config_dir(str(configuration_dir()), version_base="1.3"):
        choice = ["hydra/launcher=slurm", f"runs_dir={tmp_path / 'runs'}", "hydra.job.num=0", "hydra.job.id=0"]
        config = compose("config", [*choice, *overrides], return_hydra_config=True)
    launcher = instantiate(config.hydra.launcher)
    launcher.setup(hydra_context=None, task_function=None, config=config)
    with pytest.raises(Exception, match="kept"):
        launcher.launch([["seed=0"]], 0)
    return (tmp_path / "script").read_text().splitlines()


def test_the_keys_of_the_launcher_reach_sbatch(tmp_path: Path, command: Command) -> None:
    command("srun", "exit 1")
    command("sbatch", f'cp "$1" {tmp_path / "script"}; echo kept >&2; exit 1')
    lines = submission(tmp_path, "hydra.launcher.partition=gpu", "hydra.launcher.gres=gpu:a100:1")
    assert {
        "#SBATCH --partition=gpu",
        "#SBATCH --gres=gpu:a100:1",
        "#SBATCH --cpus-per-task=2",
        "#SBATCH --mem=8GB",
        "#SBATCH --time=240",
        "#SBATCH --signal=USR2@120",
        "export SRUN_CPUS_PER_TASK=$SLURM_CPUS_PER_TASK",
    } <= set(lines)
    assert f"#SBATCH --output={tmp_path}/runs/slurm/%j/%j_0_log.out" in lines


def test_a_launcher_without_a_sweep_or_a_cluster_is_refused(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigurationError, match=r"hydra/launcher=slurm.* add -m"):
        jobs_of(["hydra/launcher=slurm"])
    line = ["-m", "hydra/launcher=slurm", "variant=sa2h,nsa2h"]
    command("srun", "exit 1")
    assert cluster_folder(line) == Path("runs/slurm")
    assert cluster_folder(["-m", "variant=sa2h,nsa2h"]) is None
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(ConfigurationError, match=r"hydra/launcher=slurm.*srun"):
        cluster_folder(line)


def test_a_job_that_the_queue_does_not_list_has_ended(command: Command, tmp_path: Path) -> None:
    watcher = QueueWatcher()
    for job in ("7_0", "7_1", "8"):
        watcher.register_job(job)
    command("squeue", r"printf '7_1\n8\n70_0\n'")
    assert [watcher.is_done(job, mode="force") for job in ("7_0", "7_1", "8")] == [True, False, False]
    command("squeue", "exit 1")  # the controller does not answer
    assert [watcher.is_done(job, mode="force") for job in ("7_0", "7_1", "8")] == [True, False, False]
    asked = tmp_path / "asked"
    command("squeue", f"[ -e {asked} ] || echo 8; touch {asked}")
    watcher.wait(every_s=0.01)
    assert watcher.is_done("8", mode="cache")


def test_a_killed_job_is_waited_for_and_is_no_error(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("watcher", "results"):
        monkeypatch.setattr(SlurmJob, name, getattr(SlurmJob, name))  # put back at the end
    asked = tmp_path / "asked"
    command("squeue", f"[ -e {asked} ] || echo 7_0; touch {asked}")
    with ended_jobs():
        job = SlurmJob(folder=tmp_path, job_id="7_0")
        (returned,) = job.results()
        assert asked.exists()
    assert returned.return_value is None


def filling(*more: str) -> list[Job]:
    return jobs_of(["-m", "task=simulate", *TINY, *more])


def test_jobs_that_read_the_same_pairs_all_fill_them(tmp_path: Path) -> None:
    jobs = filling("seed=range(4)", f"runs_dir={tmp_path}")
    assert len(jobs) == 4
    assert len({dataset_folder(job.settings) for job in jobs}) == 1
    patients = filling("scene.anatomy_seed=0,1", f"runs_dir={tmp_path}")
    assert len({dataset_folder(job.settings) for job in patients}) == 2


def test_pairs_made_elsewhere_are_reported_and_what_is_missing_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    jobs = filling("seed=0,1", f"runs_dir={tmp_path}")

    def killed() -> None:
        raise SystemExit(1)

    assert tasks.simulate(jobs, killed) == 1
    assert "not finished" in capsys.readouterr().err

    def launch() -> None:
        for job in jobs:
            prepare_data(job.settings, maps_needed([job.settings.model]))
        raise SystemExit(1)  # as Hydra does when it gave up a job that SLURM then queued again

    assert tasks.simulate(jobs, launch) == 0
    assert capsys.readouterr().out.count("6 frames in") == 1


def test_a_study_elsewhere_leaves_the_simulating_to_its_jobs(tmp_path: Path) -> None:
    jobs = jobs_of(["-m", "variant=sa2h,nsa2h", "training.crop=256", *TINY[:-1], f"runs_dir={tmp_path}"])

    def launch() -> None:
        assert (tmp_path / "mlflow.db").exists()
        assert not (tmp_path / "data").exists()
        raise SystemExit(1)

    assert tasks.study(jobs, launch, elsewhere=True) == 1
