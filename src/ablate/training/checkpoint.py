"""Write and read weights. Not the code that trains: looking at a run does not load Lightning."""

from io import BytesIO
from pathlib import Path
from typing import Any

import torch

from ablate.networks import Generator, GeneratorSpec, copied, read_stored, stored_generator
from ablate.storage import remove_partial, written_whole
from ablate.training.settings import TrainingSettings
from ablate.user_code import check_named, code_digest


def write_weights(path: Path, content: object) -> None:
    """Write what torch can save, whole."""
    in_memory = BytesIO()
    torch.save(content, in_memory)  # to a path, a full disk is a RuntimeError
    with written_whole(path) as partial:
        partial.write_bytes(in_memory.getbuffer())


def write_snapshot(folder: Path, step: int, generator: Generator) -> None:
    """Keep the weights of a generator after so many steps; only one process at a time may."""
    path = _snapshot(folder, step)
    remove_partial(path)
    write_weights(path, generator.state_dict())


def load_snapshot(folder: Path, step: int, like: Generator) -> Generator:
    """Load what `write_snapshot` has kept into a copy of a generator; a ValueError where it cannot be read."""
    path = _snapshot(folder, step)
    generator = copied(like).requires_grad_(False).to(next(like.parameters()).device)
    try:
        generator.load_state_dict(read_stored(path))
    except Exception as error:  # torch raises many kinds
        reason = " ".join(str(error).split())
        raise ValueError(f"{path}: not the weights of this network ({reason:.200}); remove {folder}") from error
    return generator


def _snapshot(folder: Path, step: int) -> Path:
    return folder / f"step-{step}.pt"


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint with `weights_only=True`; a ValueError where the file is not one of this project."""
    try:
        checkpoint = read_stored(path)
    except FileNotFoundError:
        raise
    except Exception as error:
        raise ValueError(f"{path}: not a readable checkpoint, remove it to start again ({error})") from error
    if not isinstance(checkpoint, dict) or "steps_done" not in checkpoint:
        raise ValueError(f"{path}: not a checkpoint of this project (no steps_done)")
    return checkpoint


def load_generator(path: Path, custom: str | None = None) -> Generator:
    """Load the generator to evaluate (the running average, where one was kept) from a checkpoint, on the CPU.

    Nothing is imported that only the file names: `custom` is the dotted path of the user's class that may be, the
    `model.target` of the training. A checkpoint of another class is a ValueError, as are a file without a checkpoint of
    this project, one with weights of another network than it names, and one of a class whose code has changed since.
    """
    checkpoint = read_checkpoint(path)
    stored = checkpoint.get("hyper_parameters", {})
    target = stored.get("spec", {}).get("target")
    check_named(path, target, custom, "custom")
    if target is not None and code_digest(target) != checkpoint.get("target_source"):
        raise ValueError(f"{path}: the code of {target} is not that of the training: restore it, or train again")
    try:
        prefix = "average." if TrainingSettings(**stored["settings"]).ema_decay > 0 else "generator."
        weights = checkpoint["state_dict"].items()
        averaged = {key.removeprefix(prefix): value for key, value in weights if key.startswith(prefix)}
        generator = stored_generator(GeneratorSpec(**stored["spec"]), stored["labels"], averaged)
    except (KeyError, TypeError, ValueError, RuntimeError, OverflowError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"{path}: its weights are not of the network that it names ({reason:.200})") from error
    return generator.requires_grad_(False).eval()
