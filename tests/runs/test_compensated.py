"""A variant that reads the compensated attenuation: all the way from pairs that another variant made."""

import json
import shutil
from pathlib import Path

import mlflow
import numpy as np
import pytest

from ablate.dataset import Crops, Part, noise_seeds
from ablate.jobs.compose import jobs_of
from ablate.networks import GeneratorSpec
from ablate.runs.train import run_job
from ablate.settings.values import build
from ablate.tracking import default_uri
from ablate.ultrasound import compensated_attenuation
from support.studies import TINY, TinyStudy, run

NAME = "sa2h-compensated"
VARIANT = [*TINY, f"variant={NAME}", f"reference={NAME}"]


@pytest.fixture(scope="module")
def trained(tiny_study: TinyStudy, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs in which the variant was trained on the pairs of sa2h, in a study of its own, and registered."""
    runs = tmp_path_factory.mktemp("compensated") / "runs"
    shutil.copytree(tiny_study.runs, runs)
    before = {p: p.stat().st_mtime_ns for p in runs.glob("data/*/pairs.zarr/**/*")}
    assert run(*VARIANT, f"runs_dir={runs}", "study_name=whole", f"tracking.register={NAME}") == 0
    assert {p: p.stat().st_mtime_ns for p in runs.glob("data/*/pairs.zarr/**/*")} == before
    return runs


def test_frames_are_read_with_the_probe_and_the_time_gain_that_they_were_simulated_with(trained: Path) -> None:
    (job,) = jobs_of([*VARIANT, f"runs_dir={trained}"])
    pairs = job.data.pairs
    frames = pairs.frames(Part.test)
    expected = compensated_attenuation(
        pairs.read("attenuation", frames), job.settings.probe, job.settings.simulator.tgc_db_cm_mhz
    )
    np.testing.assert_allclose(pairs.read("compensated", frames), expected, atol=0.6 / 65535)


def test_it_is_scored_and_its_registered_generator_renders_the_same(trained: Path) -> None:
    place = trained / "whole" / NAME / "seed0"
    assert "test/shadow_contrast" in json.loads((place / "result.json").read_text())["scalars"]
    made = build(GeneratorSpec, json.loads((place / "spec.json").read_text())["settings"]["model"])
    assert made.attenuation == "compensated"
    (job,) = jobs_of([*VARIANT, f"runs_dir={trained}"])
    pairs = job.data.pairs
    pictures = np.load(place / "pictures.npz")
    frame = pictures["frames"][:1]
    maps = {name: pairs.read(name, frame) for name in ("segmentation", "compensated")}
    mlflow.set_tracking_uri(default_uri(trained))
    loaded = mlflow.pyfunc.load_model(f"models:/{NAME}/1")
    assert {i.name for i in loaded.metadata.signature.inputs} == set(maps)
    image = loaded.predict(maps, params={"seed": int(noise_seeds(frame, 0)[0])})
    np.testing.assert_array_equal(image, pictures["images"][:1])


def test_a_stopped_training_goes_on_as_if_it_had_not_been_stopped(
    trained: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (job,) = jobs_of([*VARIANT, f"runs_dir={trained}", "study_name=stopped"])
    cut = Crops.__getitem__

    def stop_at_step_4(crops: Crops, step: int) -> object:
        if step == 4:
            raise RuntimeError("stopped")
        return cut(crops, step)

    with monkeypatch.context() as patched:
        patched.setattr(Crops, "__getitem__", stop_at_step_4)
        with pytest.raises(RuntimeError, match="stopped"):
            run_job(job)
    run_job(job)
    assert json.loads((job.folder / "result.json").read_text())["scalars"]["train/resumed_at"] > 0
    here, there = (np.load(trained / study / NAME / "seed0" / "pictures.npz") for study in ("stopped", "whole"))
    np.testing.assert_array_equal(here["images"], there["images"])
