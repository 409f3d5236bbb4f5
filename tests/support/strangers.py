"""What a stranger could send: runs and generators whose files name code, and code that leaves a mark where it runs."""

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import torch

from ablate.anatomy import load_tissues
from ablate.command.compose import jobs_of
from ablate.dataset import label_values
from ablate.networks import Generator, GeneratorSpec
from ablate.pretrained import OUTSIDE, Renderer, save
from ablate.setting import plain
from ablate.study.job import Job
from ablate.study.training import Training
from ablate.training import TrainingSettings
from ablate.ultrasound import ConvexProbe, SimulatorSettings
from ablate.user_code import code_digest
from support.finished_runs import finish

_MODULE = "code_of_a_stranger"
_CODE = """
from pathlib import Path
from torch import nn

Path({mark!r}).touch()


class Network(nn.Sequential):
    def __init__(self, channels):
        super().__init__(nn.Conv2d(channels, 1, 3, padding=1), nn.Tanh())


def metric(pair):
    return 0.0
"""


@dataclass(frozen=True)
class Trap:
    """A module that can be imported, and the mark that it leaves when it is."""

    mark: Path
    network: str = f"{_MODULE}.Network"
    metric: str = f"{_MODULE}.metric"

    @property
    def has_sprung(self) -> bool:
        return self.mark.exists()

    def set_again(self) -> None:
        """Forget that the module was imported, as a new process has."""
        sys.modules.pop(_MODULE, None)
        self.mark.unlink(missing_ok=True)


class RunsCommand:
    """An object that makes the mark where it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.mark,)


def lay_trap(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Trap:
    """Put the module where Python finds it, as in the folder that somebody works in."""
    mark = folder / "it_ran"
    (folder / f"{_MODULE}.py").write_text(_CODE.format(mark=str(mark)))
    monkeypatch.syspath_prepend(folder)
    trap = Trap(mark)
    trap.set_again()
    return trap


def strangers_generator(path: Path, trap: Trap) -> None:
    """Write a file for `ablate.load` whose network is the class of the trap."""
    spec = GeneratorSpec(**CUSTOM, target=trap.network)
    simulator = SimulatorSettings(image_shape=(64, 88), scanlines=12, axial_samples=64)
    save(Renderer(Generator(spec).eval(), {OUTSIDE: (-1.0,), "bone": (1.0,)}, ConvexProbe(), simulator, {}), path)
    trap.set_again()


CUSTOM = {"family": "custom", "concat": "input", "upsampling": "transposed", "noise": "none", "depth": 1}


def strangers_run(runs: Path, trap: Trap, *words: str) -> Training:
    """Write a finished run of the class of the trap, as `task=study` leaves it, in a folder of runs.

    Its data set is not there. More `words` of its command line may be given.
    """
    named = ["variant=custom", f"model.target={trap.network}"]
    run = _finished(jobs_of(["preset=tiny", *named, f"runs_dir={runs}", *words])[0])
    trap.set_again()
    return run


def innocent_run(runs: Path, *words: str) -> Training:
    """Write a finished run of SA2H, whose files name no code."""
    return _finished(jobs_of(["preset=tiny", "variant=sa2h", f"runs_dir={runs}", *words])[0])


def change_checkpoint(run: Training, changes: Mapping[str, object]) -> None:
    """Write the checkpoint of a run with some of its parts changed."""
    checkpoint = torch.load(run.checkpoint, weights_only=True)
    torch.save(checkpoint | changes, run.checkpoint)


def hyper_parameters(spec: Mapping[str, object]) -> dict[str, object]:
    """What the checkpoint of a training without a running average says of its network."""
    return {"spec": dict(spec), "settings": plain(TrainingSettings(ema_decay=0.0))}


def _finished(job: Job) -> Training:
    run = finish(job).training
    channels = label_values([*load_tissues().values()], job.settings.encoding).shape[1]
    spec = job.settings.model
    weights = Generator(spec, channels).state_dict()
    content = {
        "steps_done": 1,
        "hyper_parameters": {**hyper_parameters(plain(spec)), "labels": channels},
        "state_dict": {f"generator.{name}": weight for name, weight in weights.items()},
        "target_source": None if spec.target is None else code_digest(spec.target),
    }
    torch.save(content, run.checkpoint)
    return run
