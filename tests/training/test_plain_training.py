"""The training that docs/networks.md begins with, against the one that is run: the same losses and the same weights."""

import re
from dataclasses import replace
from typing import Any

import pytest
import torch

from ablate.networks import GeneratorSpec
from ablate.training import PairGAN
from support.scripts import ROOT, script
from support.tiny_training import SETTINGS, batch
from support.variants import UNET

VARIANTS: dict[str, dict[str, Any]] = {
    "sa2h": {"noise": "none"},
    "every map": {
        "noise": "none",
        "attenuation": "illumination",
        "interfaces": "echo",
        "position": "beam",
        "grain": "refine",
    },
    "concat and conv": {"noise": "none", "concat": "input", "upsampling": "transposed"},
    "lsa2h": {**UNET, "depth": 5, "extra_input": "low"},
}
STEPS = 8
# The losses of the training are in float32. Adam divides gradients by their size, and so makes the rounding of small
# ones large; this is a hundredth of how far it may move a weight.
ROUNDING = 0.01 * STEPS * SETTINGS.learning_rate


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("forwards", [1, 2])
def test_losses_and_weights_are_equal_to_rounding(variant: str, forwards: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without noise, which the plain networks draw from torch's generator."""
    spec = GeneratorSpec(**{"depth": 2, "width": 0.05, **VARIANTS[variant]})
    module = PairGAN(spec, replace(SETTINGS, ema_decay=0.0)).double()
    optimizers = module.configure_optimizers()
    monkeypatch.setattr(module, "optimizers", lambda: optimizers)
    monkeypatch.setattr(module, "manual_backward", lambda loss: loss.backward())
    plain = script("benchmarks/plain_training.py").PlainGAN(spec, torch.device("cpu"))
    assert module.discriminator is not None
    initial = {name.removeprefix("network."): value for name, value in module.generator.state_dict().items()}
    plain.generator.double().load_state_dict(initial)
    plain.discriminator.double().load_state_dict(module.discriminator.state_dict())

    for step in range(STEPS):
        given = {name: v.double() if v.is_floating_point() else v for name, v in batch(step).items()}
        module.training_step(given, step)
        losses = {name.removeprefix("train/"): value for name, value in module.drain().items()}
        assert losses == pytest.approx(plain.step(given, forwards), rel=1e-5, abs=1e-6)
    trained = {name.removeprefix("network."): value for name, value in module.generator.state_dict().items()}
    for name, weight in plain.generator.state_dict().items():
        torch.testing.assert_close(trained[name], weight, rtol=0, atol=ROUNDING)
        assert name.endswith("bias") or not torch.equal(initial[name], weight)
    for name, weight in plain.discriminator.state_dict().items():
        torch.testing.assert_close(module.discriminator.state_dict()[name], weight, rtol=0, atol=ROUNDING)


def test_the_page_begins_with_lines_of_the_training_in_their_order() -> None:
    page = (ROOT / "docs" / "networks.md").read_text()
    shown = re.search("```python\n(.*?)```", page, re.DOTALL)
    assert shown is not None
    lines = [line.strip() for line in shown[1].splitlines() if line.strip() and "def step" not in line]
    source = (ROOT / "benchmarks" / "plain_training.py").read_text()
    rest = iter([line.strip() for line in source.splitlines()])
    assert len(lines) >= 20
    assert [line for line in lines if line not in rest] == []
    assert len(page[: shown.end()].splitlines()) <= 40, "the first screen"
