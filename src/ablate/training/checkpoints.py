"""`last.ckpt`: written whole or not at all, loaded without running code, resumed exactly."""

from pathlib import Path
from typing import Any

import torch
from lightning.pytorch import Callback, LightningModule, Trainer

from ablate.networks import Generator
from ablate.storage import remove_partial, written_whole
from ablate.training.interruption import Interruption
from ablate.training.losses import DivergenceError
from ablate.training.module import PairGAN
from ablate.training.settings import TRAINING_VERSION, Schedule, as_builtins

LAST = "last.ckpt"
# Settings that may differ between a run and its continuation: they say how long is trained, and where. Another device
# or number of threads adds numbers in another order, so weights differ by rounding.
_FREE = frozenset({"steps", "device", "threads", "checkpoint_every", "validate_every", "log_every"})


class LastCheckpoint(Callback):
    """Write `last.ckpt` every `every` steps, after the last one and when the process is asked to stop, and then stop.

    Weights that are not finite are never written: the last good checkpoint stays.
    """

    def __init__(self, folder: Path, every: int, interruption: Interruption) -> None:
        self.path, self.every, self.interruption = folder / LAST, every, interruption

    def on_train_batch_end(self, trainer: Trainer, module: LightningModule, *_: Any) -> None:
        """Write if it is time."""
        assert isinstance(module, PairGAN)
        step = module.steps_done
        is_due = self.every > 0 and step % self.every == 0
        trainer.should_stop = trainer.should_stop or self.interruption.is_asked_for
        if is_due or step == module.settings.steps or trainer.should_stop:
            if not module.is_finite():
                raise DivergenceError(f"step {step}: weights are not finite, {self.path} holds the last good ones")
            remove_partial(self.path)  # one process trains a run
            with written_whole(self.path) as partial:
                torch.save(module.checkpoint(), partial)


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint with `weights_only=True`.

    Raises
    ------
    ValueError
        Where the file is not a checkpoint of this project.
    """
    try:
        checkpoint = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise
    except Exception as error:
        raise ValueError(f"{path}: not a readable checkpoint, remove it to start again ({error})") from error
    if not isinstance(checkpoint, dict) or "steps_done" not in checkpoint:
        raise ValueError(f"{path}: not a checkpoint of this project (no steps_done)")
    return checkpoint


def resume(module: PairGAN, path: Path) -> None:
    """Continue from `path`; ValueError, which names what differs, if it holds another network or another training."""
    checkpoint = read_checkpoint(path)
    version = checkpoint.get("training_version", 1)  # not stored at first
    if version != TRAINING_VERSION:
        trained = f"trained by version {version} of the training, this program has version {TRAINING_VERSION}"
        raise ValueError(f"{path}: {trained}; remove it to start again")
    # A falling learning rate depends on the number of steps.
    free = _FREE if module.settings.schedule is Schedule.constant else _FREE - {"steps"}
    for part, wanted in (("spec", as_builtins(module.spec)), ("settings", as_builtins(module.settings))):
        found = checkpoint["hyper_parameters"][part]
        differing = [key for key in wanted if key not in free and found.get(key) != wanted[key]]
        if differing:
            changes = ", ".join(f"{key}={found.get(key)} there, {wanted[key]} asked for" for key in differing)
            raise ValueError(f"{path}: of another run ({changes})")
    module.restore(checkpoint)


def load_generator(path: Path) -> Generator:
    """Load the generator to evaluate (the running average, where one was kept) from a checkpoint, on the CPU.

    Raises
    ------
    ValueError
        Where the file is not a checkpoint of this project, or its weights are not those of the network it names.
    """
    checkpoint = read_checkpoint(path)
    try:
        module = PairGAN(**checkpoint["hyper_parameters"])
        module.load_state_dict(checkpoint["state_dict"])
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"{path}: its weights are not of the network that it names ({reason:.200})") from error
    return module.evaluated.eval()
