"""Train one network to its last step, from the start or from its last checkpoint."""

import logging
import signal
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from lightning.pytorch import Callback, Trainer
from lightning.pytorch.callbacks import LambdaCallback
from lightning.pytorch.plugins.environments import LightningEnvironment
from torch import Tensor

from ablate.networks import Generator, GeneratorSpec
from ablate.training.checkpoints import LAST, LastCheckpoint, resume
from ablate.training.hardware import chosen_device, chosen_precision, keep_freed_memory
from ablate.training.interruption import Interruption
from ablate.training.losses import DivergenceGuard
from ablate.training.module import PairGAN
from ablate.training.reporting import MetricSink, Report, Validate, Validation
from ablate.training.settings import TrainingPrecision, TrainingSettings

# Called with the first step and the one after the last; gives one batch a step, a function of the step alone.
Loader = Callable[[int, int], Iterable[dict[str, Tensor]]]
_TRAINER_PRECISION = {TrainingPrecision.fp32: "32-true", TrainingPrecision.bf16: "bf16-mixed"}


@dataclass(frozen=True)
class TrainedGenerator:
    """The generator to evaluate, on the device it was trained on, its checkpoint, and the steps done before."""

    generator: Generator
    checkpoint: Path
    resumed_at: int


def train(
    spec: GeneratorSpec,
    settings: TrainingSettings,
    loader: Loader,
    run_dir: Path,
    sink: MetricSink | None = None,
    validation: Validation | None = None,
    epoch: int | None = None,
) -> TrainedGenerator:
    """Train a generator, or finish its training.

    A run that was stopped at any step and is called again with the same arguments ends with the weights of a run
    that was not stopped: to the bit on the same CPU with the same number of threads, and as far as the convolutions of
    cuDNN repeat themselves on a GPU. A run keeps the precision that `auto` stood for when it began. After SIGTERM,
    SIGHUP, SIGUSR2 or Ctrl-C the current step is finished, a checkpoint is written, and the signal is raised again.

    Parameters
    ----------
    loader : callable
        `loader(start, stop)` iterates over the batches of these steps; see `PairGAN.training_step` for a batch.
    run_dir : Path
        `last.ckpt` is written there, and continued from if it exists.
    sink : callable, optional
        `sink(metrics, images_seen)`; the `log_metrics` of a Lightning logger fits.
    validation : callable, optional
        Called with the generator to evaluate and the number of images it has seen, before the first step and every
        `settings.validate_every` steps; returns metrics.

    Raises
    ------
    ValueError
        Where the crop is smaller than 2^depth, or `last.ckpt` is of another run.
    InterruptedError
        Where a signal stopped training and the handler of that signal returned.
    DivergenceError
        Where training has failed; the last good checkpoint stays.
    RuntimeError
        Where the loader ends too early, or there is no GPU and one is asked for.
    """
    if settings.crop < 2**spec.depth:
        raise ValueError(f"crop={settings.crop}: allowed are 2^depth = {2**spec.depth} and more")
    if settings.threads:
        torch.set_num_threads(settings.threads)
    device = chosen_device(settings.device)
    settings = replace(settings, precision=chosen_precision(settings.precision, device))
    keep_freed_memory()
    module = PairGAN(spec, settings)
    run_dir.mkdir(parents=True, exist_ok=True)
    checkpoint = run_dir / LAST
    if checkpoint.exists():
        resume(module, checkpoint)
    start = module.steps_done
    if start < settings.steps:
        interruption = Interruption()
        # The order matters: signals are taken over before the first validation, losses are checked before weights are
        # written.
        callbacks: list[Callback] = [
            LambdaCallback(on_train_start=lambda *_: interruption.take_over()),
            Report(sink, DivergenceGuard(settings.log_every, epoch)),
        ]
        if validation is not None and settings.validate_every:
            callbacks.append(Validate(validation, settings.validate_every, sink))
        callbacks.append(LastCheckpoint(run_dir, settings.checkpoint_every, interruption))
        try:
            _fit(module, loader(start, settings.steps), callbacks, device, run_dir)
        finally:
            interruption.restore()
        if interruption.signal is not None:
            signal.raise_signal(interruption.signal)
        if module.steps_done < settings.steps:
            if interruption.signal is not None:  # the handler found before returned, as submitit's does for SIGTERM
                name = signal.Signals(interruption.signal).name
                raise InterruptedError(f"stopped by {name} after step {module.steps_done} of {settings.steps}")
            raise RuntimeError(f"loader: ended after step {module.steps_done}, needed are {settings.steps}")
    return TrainedGenerator(module.evaluated.eval().to(device), checkpoint, start)


def _fit(
    module: PairGAN, batches: Iterable[Any], callbacks: list[Callback], device: torch.device, folder: Path
) -> None:
    with _quiet_lightning():
        trainer = Trainer(
            accelerator="gpu" if device.type == "cuda" else "cpu",
            devices=1,
            # A SLURM allocation does not matter here: there is one process with one device.
            plugins=LightningEnvironment(),
            precision=_TRAINER_PRECISION[module.settings.precision],  # type: ignore[arg-type]
            max_epochs=1,
            callbacks=callbacks,
            benchmark=device.type == "cuda",
            default_root_dir=folder,
            logger=False,
            enable_checkpointing=False,
            enable_progress_bar=False,
            enable_model_summary=False,
        )
        trainer.fit(module, batches)


@contextmanager
def _quiet_lightning() -> Iterator[None]:
    """Silence Lightning's notes on hardware, loaders, SLURM (the caller's matters) and on itself."""
    log = logging.getLogger("lightning.pytorch")
    level = log.level
    log.setLevel(logging.WARNING)
    try:
        with warnings.catch_warnings():
            # LeafSpec: Lightning itself calls a name that torch has deprecated.
            for message in ("does not have many workers", "`srun` command is available", "LeafSpec"):
                warnings.filterwarnings("ignore", message=f".*{message}")
            yield
    finally:
        log.setLevel(level)
