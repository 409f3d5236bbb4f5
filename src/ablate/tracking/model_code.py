"""What MLflow runs to load a registered generator: it keeps a copy of this file beside the weights."""

from mlflow.models import set_model

from ablate.tracking.registration import RegisteredGenerator

set_model(RegisteredGenerator())
