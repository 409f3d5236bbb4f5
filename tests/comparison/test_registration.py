"""A registered generator renders what the study's own renderer does, bit for bit."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import mlflow
import numpy as np
import pytest
from mlflow.exceptions import MlflowException

from ablate.comparison.compare import compare_study
from ablate.comparison.parent_run import register_reference
from ablate.dataset import Part, label_values, noise_seeds
from ablate.jobs.compose import jobs_of
from ablate.networks import Space
from ablate.runs.job import Job
from ablate.runs.run import runs_of
from ablate.runs.store_copy import copy_study
from ablate.runs.train import generated_images, run_job
from ablate.tracking import default_uri
from ablate.training import load_generator

TINY = [
    "preset=tiny",
    "simulator.image_shape=[96,134]",
    "dataset.frames=10",
    "model.noise_start=0.3",
    "reference=sa2h.noise_start-0.3",
    "training.steps=1",
    "tracking.register=renderer of a fetus",
]
READ = ("segmentation", "illumination", "interfaces", "depth", "lateral")


@pytest.fixture(scope="module")
def registered(tmp_path_factory: pytest.TempPathFactory, empty_database: Path) -> tuple[Path, Job]:
    runs = tmp_path_factory.mktemp("runs")
    shutil.copy(empty_database, runs)
    (job,) = jobs_of(["variant=sa2h", f"runs_dir={runs}", *TINY])
    run_job(job)
    with mock.patch("ablate.comparison.compare.draw_figures", return_value=[]):
        assert "models:/renderer of a fetus/1 " in compare_study(job.settings)
    return runs, job


@pytest.fixture
def loaded(registered: tuple[Path, Job]) -> Any:
    mlflow.set_tracking_uri(default_uri(registered[0]))
    return mlflow.pyfunc.load_model("models:/renderer of a fetus/1")


def test_it_renders_what_the_study_renders(registered: tuple[Path, Job], loaded: Any) -> None:
    job = registered[1]
    finished = runs_of(job.settings.study_dir)
    data = finished[0].data_set
    values = label_values(data.tissues, job.settings.encoding, job.settings.label_seed)
    render = generated_images(load_generator(finished[0].checkpoint), data, values, job.settings.training.precision)
    frame = data.pairs.frames(Part.test)[:1]
    maps = {name: data.pairs.read(name, frame, Space.beam) for name in READ}
    image = loaded.predict(maps, params={"seed": int(noise_seeds(frame, 0)[0])})
    assert (image.dtype, image.shape) == (np.uint8, (1, 64, 32))
    np.testing.assert_array_equal(data.pairs.converter.to_image(image), render(frame, 0))
    assert (image != loaded.predict(maps, params={"seed": 5})).any()  # other noise, another image


def test_its_signature_says_what_it_takes_and_refuses_the_rest(loaded: Any) -> None:
    inputs = {i.name: i.type for i in loaded.metadata.signature.inputs}
    assert inputs == {name: np.dtype("uint8" if name == "segmentation" else "float32") for name in READ}
    assert loaded.metadata.signature.outputs.inputs[0].type == np.dtype("uint8")
    assert [p.name for p in loaded.metadata.signature.params] == ["seed"]
    example = loaded.input_example
    assert loaded.predict(example).shape == example["segmentation"].shape == (1, 64, 32)
    with pytest.raises(MlflowException, match="illumination"):
        loaded.predict({"segmentation": example["segmentation"]})
    with pytest.raises(ValueError, match="segmentation: label 200, allowed are 0 to "):
        loaded.predict({**example, "segmentation": np.full_like(example["segmentation"], 200)})


def test_it_is_registered_once_and_not_without_the_reference(registered: tuple[Path, Job]) -> None:
    runs, job = registered
    finished = runs_of(job.settings.study_dir)
    parent, ids = copy_study(job.settings)
    assert register_reference(job.settings, finished, parent.store, ids).startswith("models:/renderer of a fetus/1 ")
    (version,) = mlflow.MlflowClient(default_uri(runs)).search_model_versions("name = 'renderer of a fetus'")
    assert version.run_id == ids[finished[0].name]
    other = replace(job.settings, reference="nsa2h")
    assert (
        register_reference(other, finished, parent.store, ids) == "not registered: nsa2h has no finished run in MLflow"
    )
