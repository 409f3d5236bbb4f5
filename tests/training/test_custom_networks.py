"""A network of the user's in a training: a checkpoint that does not give it back is refused before it is written."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from ablate.networks import Generator, GeneratorSpec
from ablate.training import LAST, TrainedGenerator, TrainingPrecision, generate, load_generator, train
from support.tiny_training import SETTINGS, batch, loader

SPEC = GeneratorSpec(
    family="custom", target="trained_here.Net", concat="input", upsampling="transposed", noise="none", depth=2
)
START = """
import numpy as np
import torch
from torch import nn

class Net(nn.Module):
    def __init__(self, channels):
        super().__init__()
        self.base = nn.Conv2d(channels, 1, 3, padding=1)
"""
FADES_IN_LATE = """
        self.seen = 0
    def forward(self, maps):
        self.seen += self.training
        return self.base(maps) + (self.seen > 4)
"""
GROWS_LATE = """
        self.seen, self.more = 0, nn.Identity()
    def forward(self, maps):
        self.seen += self.training
        if self.training and self.seen == 5:
            self.more = nn.Conv2d(1, 1, 1)
        return self.more(self.base(maps))
"""
NUMPY_LATE = """
        self.seen = 0
    def get_extra_state(self):
        return {"seen": self.seen}
    def set_extra_state(self, state):
        self.seen = state["seen"]
    def forward(self, maps):
        self.seen += self.training
        if self.seen > 4:
            self.seen = np.int64(self.seen)
        return self.base(maps)
"""
STATE_THAT_IS_SAVED = """
        self.seen = 0
        self.base = torch.nn.utils.weight_norm(self.base)
    def get_extra_state(self):
        return {"seen": self.seen}
    def set_extra_state(self, state):
        self.seen = state["seen"]
    def forward(self, maps):
        self.seen += self.training
        self.skip = self.base(maps)
        return self.skip + self.seen / 100
"""
KEEPS_ITS_SKIP = """
        self.deep = nn.Sequential(*[nn.Conv2d(8, 8, 5, padding=2) for _ in range(6)])
        self.first, self.last = nn.Conv2d(channels, 8, 1), nn.Conv2d(8, 1, 1)
    def encoded(self, maps):
        self.skip = self.first(maps)
        return self.skip
    def forward(self, maps):
        deep = self.deep(self.encoded(maps))
        return self.last(deep + self.skip)
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "trained_here", raising=False)
    return tmp_path


def trained(folder: Path, body: str, ema_decay: float = 0.9, steps: int = 8) -> TrainedGenerator:
    (folder / "trained_here.py").write_text(START + body)
    settings = replace(SETTINGS, ema_decay=ema_decay, steps=steps, loss="none")
    return train(SPEC, settings, loader, folder / "run")


@pytest.mark.parametrize("ema_decay", [0.0, 0.9])
@pytest.mark.parametrize(
    ("body", "message"),
    [
        (FADES_IN_LATE, r"another process that loads its checkpoint renders .* not saved \(seen\)"),
        (GROWS_LATE, "what is saved of it cannot be loaded|Tensor lists must have the same number"),
        (NUMPY_LATE, "_extra_state cannot be read from a checkpoint"),
    ],
)
def test_a_checkpoint_that_does_not_give_the_network_back_is_not_written(
    folder: Path, body: str, message: str, ema_decay: float
) -> None:
    """Checkpoints are due at steps 3, 6 and 8, and the network changes at the fifth."""
    with pytest.raises((ValueError, RuntimeError), match=message):
        trained(folder, body, ema_decay)
    assert torch.load(folder / "run" / LAST)["steps_done"] == 3, "the last good one stays"


@pytest.mark.filterwarnings("ignore:.*weight_norm.* is deprecated")
@pytest.mark.parametrize("ema_decay", [0.0, 0.9])
def test_what_is_scored_is_what_another_process_loads(folder: Path, ema_decay: float) -> None:
    """Its state follows the training in the running average too, and checks change nothing of a training."""
    whole = trained(folder, STATE_THAT_IS_SAVED, ema_decay)
    inner = whole.generator.network.inner
    assert inner.seen == 8
    weights = load_generator(whole.checkpoint, custom=SPEC.target).state_dict()
    assert all(
        torch.equal(value, weights[name]) for name, value in whole.generator.state_dict().items() if "extra" not in name
    )
    (folder / "at_once").mkdir()
    settings = replace(SETTINGS, ema_decay=ema_decay, loss="none", checkpoint_every=0)
    at_once = train(SPEC, settings, loader, folder / "at_once").generator.state_dict()
    assert all(torch.equal(value, weights[name]) for name, value in at_once.items() if "extra" not in name)


@pytest.mark.filterwarnings("ignore:.*weight_norm.* is deprecated")
def test_weights_that_are_kept_before_the_end_are_read_of_a_class_that_cannot_be_copied(folder: Path) -> None:
    (folder / "trained_here.py").write_text(START + STATE_THAT_IS_SAVED)
    settings = replace(SETTINGS, ema_decay=0.0, loss="none", snapshots=3)
    whole = train(SPEC, settings, loader, folder / "run")
    (kept,) = whole.snapshots
    assert (kept.network.inner.seen, whole.generator.network.inner.seen) == (settings.snapshot_steps[0], 8)
    stored = torch.load(folder / "run" / f"step-{settings.snapshot_steps[0]}.pt")
    assert all(torch.equal(value, stored[name]) for name, value in kept.state_dict().items() if "extra" not in name)


def test_a_network_that_keeps_its_skip_on_itself_renders_no_frame_of_another(folder: Path) -> None:
    (folder / "trained_here.py").write_text(START + KEEPS_ITS_SKIP)
    generator = Generator(SPEC).eval()
    given = batch(0, size=64)
    maps = {name: torch.cat([value * k for k in (0.2, 1.0, -0.5)]) for name, value in given.items() if value.ndim == 4}
    mask = torch.ones(64, 64, dtype=torch.bool)
    alone = [
        generate(generator, {name: value[k : k + 1] for name, value in maps.items()}, mask, None) for k in range(6)
    ]
    torch.set_num_threads(3)
    try:
        for _ in range(4):
            frames = generate(generator, maps, mask, None, TrainingPrecision.fp32)
            assert np.abs(frames.astype(int) - np.concatenate(alone)).max() <= 1
    finally:
        torch.set_num_threads(1)
