"""Jobs on SLURM, with stand-ins for its commands: what is asked for, what is waited for, who simulates."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from hydra.utils import instantiate

from ablate.command.compose import composed, jobs_of
from ablate.command.launch import Launch
from ablate.command.slurm import queued, wait_for
from ablate.settings.study import ConfigurationError
from ablate.study.job import Job
from ablate.tasks import entry as program
from ablate.tasks import study as tasks
from ablate.tasks.entry import execute
from hydra_plugins.ablate_plugins import QueueLauncher
from support.studies import here

TINY = [
    "preset=tiny",
    "simulator.rays=1",
    "simulator.image_shape=[64,89]",
    "dataset.frames=6",
    "dataset.grid=[2,3,1,1]",
    "dataset.shard=2",
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


@pytest.fixture(autouse=True)
def only_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sweep starts its jobs and does nothing else."""

    def start(jobs: list[Job], launch: Launch) -> int:
        assert launch.elsewhere
        launch.start(jobs, print)
        return 0

    monkeypatch.setattr(program, "_do", start)


def launcher(tmp_path: Path, *overrides: str) -> QueueLauncher:
    """What conf/ has of the launcher, ready to submit."""
    choice = ["hydra/launcher=slurm", f"runs_dir={tmp_path / 'runs'}", "hydra.job.num=0", "hydra.job.id=0"]
    config = composed([*choice, *overrides])
    made = instantiate(config.hydra.launcher)
    assert type(made).__name__ == "QueueLauncher"  # Hydra loads the file of a plugin anew
    made.setup(hydra_context=None, task_function=None, config=config)
    return made


def test_the_keys_of_the_launcher_reach_sbatch(tmp_path: Path, command: Command) -> None:
    command("srun", "exit 1")
    command("sbatch", f'cp "$1" {tmp_path / "script"}; echo kept >&2; exit 1')
    with pytest.raises(BaseException, match="kept"):
        launcher(tmp_path, "hydra.launcher.partition=gpu", "hydra.launcher.gres=gpu:a100:1").launch([["seed=0"]], 0)
    lines = (tmp_path / "script").read_text().splitlines()
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


def test_a_launcher_without_a_sweep_or_a_cluster_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigurationError, match=r"hydra/launcher=slurm.* add -m"):
        execute(["hydra/launcher=slurm"])
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(ConfigurationError, match=r"hydra/launcher=slurm.*srun"):
        execute(["-m", "hydra/launcher=slurm", "variant=sa2h,nsa2h"])


def test_a_job_that_the_queue_does_not_list_has_ended(command: Command, tmp_path: Path) -> None:
    command("squeue", r"printf '7_1\n8\n70_0\n'")
    assert queued(["7_0", "7_1", "8"]) == ["7_1", "8"]
    command("squeue", "exit 1")  # the controller does not answer
    assert queued(["7_1", "8"]) == ["7_1", "8"]
    asked = tmp_path / "asked"
    command("squeue", f"[ -e {asked} ] || echo 8; touch {asked}")
    wait_for(["7_1", "8"], every_s=0.01)
    assert queued(["7_1", "8"]) == []


def test_a_killed_job_is_waited_for_and_is_no_error(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ablate.command.slurm.time.sleep", lambda _: None)
    asked = tmp_path / "asked"
    command("srun", "exit 1")
    command("sbatch", "echo Submitted batch job 7")
    command("squeue", f"[ -e {asked} ] || echo 7_0; touch {asked}")
    (returned,) = launcher(tmp_path).launch([["seed=0"]], 0)
    assert asked.exists()
    assert returned.return_value is None


def filling(*more: str) -> list[Job]:
    return jobs_of(["-m", "task=simulate", *TINY, *more])


def test_jobs_that_read_the_same_pairs_all_fill_them(tmp_path: Path) -> None:
    jobs = filling("seed=range(4)", f"runs_dir={tmp_path}")
    assert len(jobs) == 4
    assert len({job.data.folder for job in jobs}) == 1
    patients = filling("scene.anatomy_seed=0,1", f"runs_dir={tmp_path}")
    assert len({job.data.folder for job in patients}) == 2


def test_pairs_made_elsewhere_are_reported_and_what_is_missing_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    jobs = filling("seed=0,1", f"runs_dir={tmp_path}")

    assert tasks.simulate(jobs, Launch(lambda *_: None, elsewhere=True)) == 1  # all were killed
    assert "not finished" in capsys.readouterr().err
    assert tasks.simulate(jobs, Launch(here, elsewhere=True)) == 0
    assert capsys.readouterr().out.count("6 frames in") == 1


def test_a_study_elsewhere_leaves_the_simulating_to_its_jobs(tmp_path: Path) -> None:
    jobs = jobs_of(["-m", "variant=sa2h,nsa2h", *TINY, f"runs_dir={tmp_path}"])

    def launch(*_: object) -> None:
        assert not (tmp_path / "data").exists()

    assert tasks.study(jobs, Launch(launch, elsewhere=True)) == 1
