"""A trained generator in MLflow's model registry; `mlflow.pyfunc.load_model` loads it to render frames."""

import tempfile
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from filelock import FileLock
from mlflow.exceptions import MlflowException
from mlflow.models import ModelSignature
from mlflow.types import ParamSchema, ParamSpec, Schema, TensorSpec

from ablate.dataset import network_inputs
from ablate.networks import Generator, GeneratorSpec, conditions
from ablate.setting import plain
from ablate.tracking.provenance import packages
from ablate.tracking.store import Store
from ablate.training import TrainingPrecision, chosen_device, generate

with warnings.catch_warnings():
    warnings.filterwarnings("ignore", message=".*Any type hint is inferred as AnyType")  # in MLflow's own classes
    import mlflow.pyfunc

_TYPES = {"segmentation": np.uint8, "low": np.uint8}  # and float32 of all others
_FRAMES = (-1, -1, -1)


class RegisteredGenerator:
    """Renders frames with what `register_generator` wrote; `mlflow.pyfunc.load_model` returns a wrapper of this."""

    def __init__(self, path: str) -> None:
        saved = torch.load(path, map_location="cpu", weights_only=True)
        self.values = saved["values"].numpy()
        self.precision = TrainingPrecision(saved["precision"])
        self.generator = Generator(GeneratorSpec(**saved["spec"]))
        self.generator.load_state_dict(saved["weights"])
        self.generator.eval().to(chosen_device("auto"))

    def predict(self, model_input: Mapping[str, np.ndarray], params: Mapping[str, Any] | None = None) -> np.ndarray:
        """Render (n, H, W) uint8; the noise of frame i has the seed `params["seed"]` + i.

        A label that was not among those trained with is a ValueError.
        """
        labels = model_input["segmentation"]
        if labels.max() >= len(self.values):
            raise ValueError(f"segmentation: label {labels.max()}, allowed are 0 to {len(self.values) - 1}")
        mask = labels > 0
        maps = network_inputs({name: model_input[name] for name in conditions(self.generator.spec)}, self.values, mask)
        seeds = torch.arange(len(labels)) + int((params or {}).get("seed", 0))
        return generate(self.generator, maps, torch.from_numpy(mask)[:, None], seeds, self.precision)


_load_pyfunc = RegisteredGenerator  # MLflow calls it by this name, because the model names this module as its loader


def register_generator(
    store: Store,
    name: str,
    run_id: str,
    generator: Generator,
    values: np.ndarray,
    precision: TrainingPrecision,
    example: Mapping[str, np.ndarray],
    description: str,
) -> int:
    """Make a version of the registered model `name` from the generator of a run, unless one exists; returns it.

    The model joins the artifacts of the run. Its file loads without running code. Its inputs are `segmentation`
    (n, H, W) uint8, 0 outside the fan, and the other maps that the generator reads: `low` uint8, others float32; a
    parameter is the integer `seed`; the output is (n, H, W) uint8. All are in the space that the generator works in.

    `values`, (labels, channels) float32 from `label_values`, tell how the labels of S are read. `example` holds the
    maps that the generator reads, (n, H, W) by name, small, because they are kept as text.
    """
    client = store.client
    with FileLock(store.lock):
        try:
            client.create_registered_model(name)
        except MlflowException as error:
            if error.error_code != "RESOURCE_ALREADY_EXISTS":
                raise
        if registered := client.search_model_versions(f"name = '{name}' and run_id = '{run_id}'"):
            return int(registered[0].version)
        with tempfile.TemporaryDirectory() as folder:
            weights, model = Path(folder, "generator.pt"), Path(folder, "model")
            kept = {"spec": plain(generator.spec), "values": torch.from_numpy(values), "precision": str(precision)}
            torch.save({**kept, "weights": generator.state_dict()}, weights)
            inputs = [
                TensorSpec(np.dtype(_TYPES.get(name, np.float32)), _FRAMES, name) for name in conditions(generator.spec)
            ]
            output, seed = TensorSpec(np.dtype(np.uint8), _FRAMES), ParamSpec("seed", "long", 0)
            versions = {k: v.partition("+")[0] for k, v in packages().items() if k != "python"}
            mlflow.pyfunc.save_model(
                str(model),
                loader_module=__name__,
                data_path=str(weights),
                signature=ModelSignature(Schema(inputs), Schema([output]), ParamSchema([seed])),
                input_example=(dict(example), {"seed": 0}),
                pip_requirements=[f"{k}=={v}" for k, v in versions.items()],
            )
            client.log_artifacts(run_id, str(model), "model")
        source = f"{client.get_run(run_id).info.artifact_uri}/model"
        return int(client.create_model_version(name, source, run_id, description=description).version)
