"""Training of the networks with Lightning, exact resume, and rendering of full frames."""

from ablate.training.checkpoints import LAST, load_generator, read_checkpoint
from ablate.training.divergence import DivergenceError
from ablate.training.engines import Engine, missing_for, open_exported, renderer
from ablate.training.inference import generate, median_ms, median_ms_per_frame
from ablate.training.loop import Loader, TrainedGenerator, train
from ablate.training.module import PairGAN
from ablate.training.precision import chosen_device, chosen_precision
from ablate.training.reporting import MetricSink, Validation
from ablate.training.settings import AdversarialLoss, Precision, TrainingSettings

__all__ = [
    "LAST",
    "AdversarialLoss",
    "DivergenceError",
    "Engine",
    "Loader",
    "MetricSink",
    "PairGAN",
    "Precision",
    "TrainedGenerator",
    "TrainingSettings",
    "Validation",
    "chosen_device",
    "chosen_precision",
    "generate",
    "load_generator",
    "median_ms",
    "median_ms_per_frame",
    "missing_for",
    "open_exported",
    "read_checkpoint",
    "renderer",
    "train",
]
