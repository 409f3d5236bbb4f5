"""What each task needs: simulation runs without the trainer and its tracking, training without the simulator."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from skimage.io import imsave

TRAINING, SIMULATOR = ("lightning", "mlflow"), ("numba", "embreex")
# Also what Windows lacks.
WITHOUT = """
import os, signal, sys
for name in ("SIGHUP", "SIGQUIT", "SIGUSR2", "SIGALRM", "pthread_sigmask", "sigwait"):
    delattr(signal, name)
for name in ("sched_getaffinity", "geteuid", "fork"):
    delattr(os, name)
os.process_cpu_count = os.cpu_count  # that of Linux calls sched_getaffinity, from Python 3.13 on
absent, sys.argv[1:] = sys.argv[1].split(","), sys.argv[2:]
sys.modules.update(dict.fromkeys(absent))  # importing one of them raises
from ablate.__main__ import main
main()
"""


def ablate(absent: tuple[str, ...], *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", WITHOUT, ",".join(absent), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_simulation_needs_neither_lightning_nor_mlflow_nor_what_windows_lacks(tmp_path: Path, workers: int) -> None:
    size = ("preset=tiny", "simulator.image_shape=[96,134]", "dataset.frames=6", f"dataset.workers={workers}")
    done = ablate(TRAINING, "task=simulate", *size, f"runs_dir={tmp_path}")
    assert done.returncode == 0, done.stderr
    assert "6 frames in" in done.stdout


@pytest.mark.slow
def test_a_study_on_pairs_made_elsewhere_needs_neither_numba_nor_embree_nor_what_windows_lacks(tmp_path: Path) -> None:
    folder, random = tmp_path / "mine", np.random.default_rng(0)
    fan = np.hypot(*(np.mgrid[:96, :120] - np.array([0, 60]).reshape(2, 1, 1))) < 90
    for name in ("segmentation", "image", "attenuation"):
        (folder / name).mkdir(parents=True)
        for k in range(6):
            values = random.integers(1, 4 if name == "segmentation" else 256, fan.shape)
            imsave(folder / name / f"site{k}_0.png", (values * fan).astype(np.uint8), check_contrast=False)
    where = ("scene=pairs", f"scene.folder={folder}", f"runs_dir={tmp_path / 'runs'}")
    done = ablate(SIMULATOR, "preset=tiny", *where, "training.steps=2", "training.validate_every=0", "metrics=psnr")
    assert done.returncode == 0, done.stderr
    study = tmp_path / "runs" / "tiny-mine"
    assert len(list(study.glob("sa2h-seed0-*/scores/psnr@*.parquet"))) == 1
    assert (study / "comparison" / "report.html").exists()


def test_no_signal_is_named_that_windows_lacks() -> None:
    """Lightning asks for SIGKILL wherever it is not on Windows, so the studies above cannot go without."""
    source = Path(__file__).resolve().parents[1] / "src"
    named = {name for path in source.rglob("*.py") for name in re.findall(r"signal\.(SIG\w+)", path.read_text("utf-8"))}
    assert "SIGTERM" in named
    assert named <= {"SIGTERM", "SIGINT", "SIG_IGN", "SIG_DFL", "SIG_BLOCK", "SIG_SETMASK"}


def loaded_with(*modules: str) -> set[str]:
    """What Python has loaded after importing some modules, and nothing else."""
    code = f"import sys, {', '.join(modules)}; print(*sys.modules)"
    return set(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split())


def test_the_settings_of_a_run_load_no_numerical_library() -> None:
    settings = (
        "ablate.dataset.split",
        "ablate.dataset.encoding",
        "ablate.training.settings",
        "ablate.evaluation.settings",
    )
    assert {"torch", "lightning", "mlflow", "numba", "embreex", "zarr", "trimesh"}.isdisjoint(loaded_with(*settings))


def test_who_looks_at_trained_runs_does_not_wait_for_the_trainer() -> None:
    loaded = loaded_with("ablate.tasks.plan", "ablate.viewer.task", "ablate.training.checkpoint")
    assert "torch" in loaded
    assert {"lightning", "mlflow"}.isdisjoint(loaded)
