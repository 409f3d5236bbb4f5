"""Train one network to its last step, from the start or from its last checkpoint."""

import logging
import signal
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import torch
from lightning.pytorch import Callback, Trainer
from lightning.pytorch.callbacks import LambdaCallback
from lightning.pytorch.plugins.environments import LightningEnvironment
from torch import Tensor

from ablate.dataset.processes import Interruption
from ablate.networks import Generator, GeneratorSpec, check_saved, read_back
from ablate.networks.custom import CustomNetwork
from ablate.setting import identity
from ablate.storage import remove_partial
from ablate.threads import torch_threads
from ablate.training.checkpoint import load_generator, load_snapshot, read_checkpoint, write_snapshot, write_weights
from ablate.training.inference import chosen_device, chosen_precision
from ablate.training.module import PairGAN
from ablate.training.reporting import DivergenceError, MetricSink, Report, Validation
from ablate.training.settings import LAST, SMALLEST_CROP, TRAINING_VERSION, TrainingPrecision, TrainingSettings

# Called with the first step and the one after the last; gives one batch a step, a function of the step alone.
Loader = Callable[[int, int], Iterable[dict[str, Tensor]]]
_TRAINER_PRECISION = {TrainingPrecision.fp32: "32-true", TrainingPrecision.bf16: "bf16-mixed"}


@dataclass(frozen=True)
class TrainedGenerator:
    """The generator to evaluate, on the device it was trained on, its checkpoint, and the steps done before.

    `snapshots` are the generators of `settings.snapshot_steps`, which are scored with it.
    """

    generator: Generator
    checkpoint: Path
    resumed_at: int
    snapshots: tuple[Generator, ...] = ()


def train(
    spec: GeneratorSpec,
    settings: TrainingSettings,
    loader: Loader,
    run_dir: Path,
    sink: MetricSink = lambda *_: None,
    validation: Validation | None = None,
    labels: int = 1,
    title: str = "",
) -> TrainedGenerator:
    """Train a generator, or finish its training; it is given in evaluation mode, on the device it was trained on.

    A run that was stopped at any step and is called again with the same arguments ends with the weights of a run
    that was not stopped: to the bit on the same CPU with the same number of threads, and as far as the convolutions of
    cuDNN repeat themselves on a GPU. Only incidental settings, such as the device, may differ. A run keeps the
    precision that `auto` stood for when it began. After SIGTERM, SIGHUP, SIGUSR2 or Ctrl-C the current step is
    finished, a checkpoint is written, and the signal is raised again.

    Parameters
    ----------
    spec : GeneratorSpec
        Components of the generator.
    settings : TrainingSettings
        How it is trained.
    loader : callable
        `loader(start, stop)` iterates over the batches of these steps; see `PairGAN.training_step` for a batch.
    run_dir : Path
        `last.ckpt` is written there, and continued from if it exists; and the weights of `settings.snapshot_steps`.
    sink : callable, optional
        `sink(metrics, images_seen)`; the `log_metrics` of a Lightning logger fits.
    validation : callable, optional
        Called with the generator to evaluate and the number of images it has seen, before the first step and every
        `settings.validate_every` steps; returns metrics.
    labels : int
        Channels of the segmentation in a batch.
    title : str
        What the line of progress begins with.

    Raises
    ------
    ValueError
        Where the crop is smaller than 2^depth, `last.ckpt` is of another run, a snapshot cannot be read, or a
        checkpoint does not give a network of the user's back.
    InterruptedError
        Where a signal stopped training and the handler of that signal returned.
    DivergenceError
        Where training has failed; the last good checkpoint stays.
    RuntimeError
        Where the loader ends too early, or there is no GPU and one is asked for.
    """
    if 0 < settings.crop < 2**spec.depth:
        raise ValueError(f"crop={settings.crop}: allowed are 2^depth = {2**spec.depth} and more")
    device = chosen_device(settings.device)
    settings = replace(settings, precision=chosen_precision(settings.precision, device))
    module = PairGAN(spec, settings, labels)
    run_dir.mkdir(parents=True, exist_ok=True)
    checkpoint = run_dir / LAST
    if checkpoint.exists():
        resume(module, checkpoint)
    start = module.steps_done
    if start < settings.steps:
        _finish(module, loader, Report(sink, validation, title), device, run_dir)
    # What is scored of a network of the user's is what its checkpoint gives, in this process as in any other.
    trained = module.evaluated if spec.target is None else load_generator(checkpoint, spec.target)
    trained = trained.eval().to(device)
    kept = [load_snapshot(run_dir, step, trained) for step in settings.snapshot_steps]
    return TrainedGenerator(trained, checkpoint, start, tuple(kept))


def _finish(module: PairGAN, loader: Loader, report: Report, device: torch.device, run_dir: Path) -> None:
    """Take the steps that are left."""
    settings = module.settings
    start = module.steps_done
    interruption = Interruption()
    # In this order signals are taken over before the first validation, and losses are checked before a checkpoint.
    callbacks = [
        LambdaCallback(on_train_start=lambda *_: interruption.take_over()),
        report,
        LastCheckpoint(run_dir, interruption),
    ]
    try:
        with torch_threads(settings.threads):
            batches = islice(loader(start, settings.steps), settings.steps - start)  # a loader may go on
            _fit(module, batches, callbacks, device, run_dir)
    finally:
        interruption.restore()
    if interruption.signal is not None:
        signal.raise_signal(interruption.signal)
    if module.steps_done == settings.steps:
        return
    if interruption.signal is not None:  # the handler found before returned, as submitit's does for SIGTERM
        name = signal.Signals(interruption.signal).name
        raise InterruptedError(f"stopped by {name} after step {module.steps_done} of {settings.steps}")
    raise RuntimeError(f"loader: ended after step {module.steps_done}, needed are {settings.steps}")


def _fit(
    module: PairGAN, batches: Iterable[Any], callbacks: list[Callback], device: torch.device, folder: Path
) -> None:
    """Run Lightning's trainer over the batches, in silence."""
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)  # it tells of hardware, and of itself
    with warnings.catch_warnings():
        # SLURM matters to the caller; LeafSpec is a name that torch has deprecated and Lightning itself calls.
        for message in ("does not have many workers", "`srun` command is available", "LeafSpec"):
            warnings.filterwarnings("ignore", message=f".*{message}")
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


class LastCheckpoint(Callback):
    """Write `last.ckpt` every so many steps, after the last one and when the process is asked to stop, and then stop.

    Weights that are not finite are never written: the last good checkpoint stays. Nor is what does not give a network
    of the user's back.
    """

    def __init__(self, folder: Path, interruption: Interruption) -> None:
        self.path = folder / LAST
        self.interruption = interruption

    def on_train_batch_end(self, trainer: Trainer, module: PairGAN, *_: Any) -> None:  # type: ignore[override]
        """Write if it is time."""
        step = module.steps_done
        every = module.settings.checkpoint_every
        trainer.should_stop = trainer.should_stop or self.interruption.signal is not None
        is_due = every > 0 and step % every == 0
        if step in module.settings.snapshot_steps:  # before the checkpoint, from which it would not be made again
            write_snapshot(self.path.parent, step, module.evaluated)
        if trainer.should_stop or is_due or step == module.settings.steps:
            self._write(module)

    def _write(self, module: PairGAN) -> None:
        norms = torch._foreach_norm([parameter.detach() for parameter in module.parameters()])
        if not torch.stack([norm.float() for norm in norms]).isfinite().all():
            kept = f", {self.path} holds the last good ones" if self.path.exists() else ""
            raise DivergenceError(f"step {module.steps_done}: weights are not finite{kept}")
        checkpoint = module.checkpoint()
        if isinstance(module.generator.network, CustomNetwork):
            _check_read(module, module.generator.network, checkpoint)
        remove_partial(self.path)
        write_weights(self.path, checkpoint)


def _check_read(module: PairGAN, network: CustomNetwork, checkpoint: Mapping[str, Any]) -> None:
    """Check that another process can read a checkpoint of a network of the user's, and renders as this one with it."""
    state = read_back(checkpoint["state_dict"], f"target={module.spec.target}")
    prefix = f"{'generator' if module.average is None else 'average'}.network."
    weights = {key.removeprefix(prefix): value for key, value in state.items() if key.startswith(prefix)}
    average = None if module.average is None else list(module.average.parameters())
    side = module.settings.crop or SMALLEST_CROP
    check_saved(network, module.spec, module.labels, side, weights, average)


def resume(module: PairGAN, path: Path) -> None:
    """Continue from `path`; ValueError, which names what differs, if it holds another network or another training."""
    checkpoint = read_checkpoint(path)
    version = checkpoint.get("training_version")
    if version != TRAINING_VERSION:
        trained = f"trained by version {version} of the training, this program has version {TRAINING_VERSION}"
        raise ValueError(f"{path}: {trained}; remove it to start again")
    stored = checkpoint["hyper_parameters"]
    began_with = {"settings": {}} | stored["spec"] | stored["settings"] | {"labels": stored.get("labels")}
    asked_for = {"settings": {}} | identity(module.spec) | identity(module.settings) | {"labels": module.labels}
    changes = [
        f"{key}={began_with.get(key)} there, {value} asked for"
        for key, value in asked_for.items()
        if began_with.get(key) != value
    ]
    if changes:
        raise ValueError(f"{path}: of another run ({', '.join(changes)})")
    module.restore(checkpoint)
