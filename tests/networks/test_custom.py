"""A user's network in place of the generator: it renders what its class renders, and what is wrong is named."""

import sys
from pathlib import Path

import pytest
import torch

from ablate.networks import Generator, GeneratorSpec, check_custom, count_generator, receptive_field

NETWORKS = """
import torch
from torch import nn

class Sum(nn.Module):
    def __init__(self, channels):
        super().__init__()
        self.weights = nn.Parameter(torch.arange(1.0, channels + 1)[:, None, None])
    def forward(self, maps):
        return (self.weights * maps).sum(1, keepdim=True)

class Fails(Sum):
    def forward(self, maps):
        raise RuntimeError("no such thing")

class BlackOnceTrained(Sum):
    def forward(self, maps):
        return super().forward(maps) * (1.0 if self.training else torch.nan)

class Fixed(nn.Module):
    def __init__(self, channels):
        super().__init__()
    def forward(self, maps):
        return maps[:, :1]

class ReadsNumbers(Sum):
    def __init__(self, channels):
        super().__init__(channels)
        self.rates = [rate.item() for rate in torch.linspace(0, 0.1, 4)]

class DrawsForItself(Sum):
    def forward(self, maps):
        return super().forward(maps + torch.randn_like(maps))

class NoChannels(nn.Module):
    def __init__(self):
        super().__init__()

number = 3
"""


@pytest.fixture(autouse=True)
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "networks_of_a_user.py"
    path.write_text(NETWORKS)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, path.stem, raising=False)


def spec(name: str, **changes: object) -> GeneratorSpec:
    plain = {"concat": "input", "upsampling": "transposed", "noise": "none"}
    return GeneratorSpec(family="custom", target=f"networks_of_a_user.{name}", **{**plain, **changes})


def test_it_reads_the_conditions_in_order_and_is_cropped_to_the_frame() -> None:
    """`Sum` weighs its channels by 1, 2, 3: the image can be computed without it."""
    maps = {name: torch.rand(2, 1, 30, 21) for name in ("segmentation", "attenuation")}
    image = Generator(spec("Sum", depth=3))(**maps)
    torch.testing.assert_close(image, maps["segmentation"] + 2 * maps["attenuation"])
    without = Generator(spec("Sum", depth=3, attenuation="none"))(maps["segmentation"])
    torch.testing.assert_close(without, maps["segmentation"])


def test_a_channel_of_noise_is_its_last_input() -> None:
    maps = {name: torch.zeros(1, 1, 16, 16) for name in ("segmentation", "attenuation")}
    generator = Generator(spec("Sum", depth=3, noise="input"))
    first, second = (generator(**maps, noise_seed=torch.tensor([seed])) for seed in (0, 1))
    assert first.std() > 1  # three times standard normal noise
    assert not torch.equal(first, second)


def test_its_sizes() -> None:
    for name in ("Sum", "ReadsNumbers"):  # as networks with stochastic depth do
        check_custom(spec(name), 32)
        assert count_generator(spec(name)) == 2
        assert receptive_field(spec(name)) is None


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("BlackOnceTrained", "returns numbers that are not finite"),
        ("DrawsForItself", r"renders the same maps differently each time.*allowed is noise that it reads"),
        ("Fails", "two images of 32 x 32 px fail: RuntimeError: no such thing"),
        ("Fixed", "has no parameter to train"),
        ("NoChannels", r"networks_of_a_user.NoChannels\(2\) fails: TypeError"),
        ("number", "is no class of torch.nn.Module"),
        ("Missing", "AttributeError.*allowed is the path of a class"),
    ],
)
def test_what_is_wrong_with_a_class_is_named(name: str, message: str) -> None:
    with pytest.raises(ValueError, match=f"^target=networks_of_a_user.{name}: {message}"):
        check_custom(spec(name), 32)
    check_custom(spec("Sum"), 32)
