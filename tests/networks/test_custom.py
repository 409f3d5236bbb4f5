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

class Seeds(Sum):
    def __init__(self, channels):
        torch.manual_seed(0)
        super().__init__(channels)

class SeedsAsItRenders(Sum):
    def forward(self, maps):
        torch.manual_seed(0)
        return super().forward(maps) + torch.randn_like(maps[:, :1])

class SetsTheType(Sum):
    def __init__(self, channels):
        torch.set_default_dtype(torch.float64)
        super().__init__(channels)

class SetsTheTypeAsItRenders(Sum):
    def forward(self, maps):
        torch.set_default_dtype(torch.float64)
        return super().forward(maps)

class OfOneSize(Sum):
    def __init__(self, channels):
        super().__init__(channels)
        self.place = nn.Parameter(torch.zeros(1, 32, 32))
    def forward(self, maps):
        return super().forward(maps) + self.place

class NoChannels(nn.Module):
    def __init__(self):
        super().__init__()

number = 3
"""

# Networks whose checkpoint is not all of them, by what a message names. `base` is a convolution of 3 x 3.
UNSAVED = {
    "FadesIn, with a step of its own": (
        "seen",
        """
        self.seen, self.late = 0, nn.Conv2d(channels, 1, 1)
    def forward(self, maps):
        self.seen += self.training
        return self.base(maps) + min(1, self.seen / 4) * self.late(maps)""",
    ),
    "ABufferThatIsNotPersistent": (
        "mean",
        """
        self.register_buffer("mean", torch.zeros(1), persistent=False)
    def forward(self, maps):
        if self.training:
            self.mean.lerp_(maps.detach().mean(), 0.1)
        return self.base(maps - self.mean)""",
    ),
    "ATensorOfItsOwn": (
        "basis",
        """
        self.basis = torch.randn(channels, 1, 1)
    def forward(self, maps):
        return self.base(maps * self.basis)""",
    ),
    "LayersInAList": (
        "layers",
        """
        self.layers = [nn.Conv2d(1, 1, 3, padding=1)]
    def forward(self, maps):
        return self.layers[0](self.base(maps))""",
    ),
    "StatisticsOfTheFirstImage": (
        "scale",
        """
        self.scale = None
    def forward(self, maps):
        if self.scale is None:
            self.scale = maps.detach().abs().mean()
        return self.base(maps / self.scale)""",
    ),
    "StatisticsOfTheFirstImageItRenders": (
        "differently each time|scale",
        """
        self.scale = None
    def forward(self, maps):
        if not self.training and self.scale is None:
            self.scale = maps.abs().mean()
        return self.base(maps / (1 if self.training else self.scale))""",
    ),
    "TheImageBefore": (
        "renders the same maps differently each time",
        """
        self.before = 0
    def forward(self, maps):
        image = self.base(maps)
        before, self.before = self.before, image.detach().mean()
        return image + before""",
    ),
    "KernelsOfTheFirstRendering": (
        "kept",
        """
        self.kept = None
    def forward(self, maps):
        if self.training:
            return self.base(maps)
        if self.kept is None:
            self.kept = 9 * self.base.weight.detach().clone()
        return nn.functional.conv2d(maps, self.kept, padding=1)""",
    ),
    "ACountOfTheClass": (
        "in its module or elsewhere",
        """
    calls = 0
    def forward(self, maps):
        Net.calls += self.training
        return self.base(maps) * (1 + Net.calls / 4)""",
    ),
    "ACountOfTheModule": (
        "in its module or elsewhere",
        """
    def forward(self, maps):
        calls.extend([1] * self.training)
        return self.base(maps) * min(2, 1 + len(calls) / 8)
calls = []""",
    ),
    "ALayerOfTheFirstImage": (
        "makes more.weight, more.bias as it renders",
        """
        self.more = None
    def forward(self, maps):
        if self.more is None:
            self.more = nn.Conv2d(1, 1, 3, padding=1)
        return self.more(self.base(maps))""",
    ),
    "ANumberOfNumPyInItsState": (
        "its inner._extra_state cannot be read from a checkpoint",
        """
        self.gain = np.float64(0.5)
    def get_extra_state(self):
        return {"gain": self.gain}
    def set_extra_state(self, state):
        self.gain = state["gain"]
    def forward(self, maps):
        return float(self.gain) * self.base(maps)""",
    ),
    "AStateThatCannotBePickled": (
        "its inner._extra_state cannot be read from a checkpoint",
        """
    def get_extra_state(self):
        return lambda: 0
    def set_extra_state(self, state):
        pass
    def forward(self, maps):
        return self.base(maps)""",
    ),
    "SavesHalf": (
        "what is saved of it cannot be loaded",
        """
    def state_dict(self, *args, **kwargs):
        whole = super().state_dict(*args, **kwargs)
        whole.popitem()
        return whole
    def forward(self, maps):
        return self.base(maps)""",
    ),
}

# Networks that keep something, and render what they have learnt.
SAVED = {
    "ASkipOnItself": """
    def forward(self, maps):
        self.skip = self.base(maps)
        return self.skip * 2""",
    "WeightNorm": """
        self.base = torch.nn.utils.weight_norm(self.base)
    def forward(self, maps):
        return self.base(maps)""",
    "SpectralNorm": """
        self.base = torch.nn.utils.parametrizations.spectral_norm(self.base)
    def forward(self, maps):
        return self.base(maps)""",
    "BatchNorm": """
        self.norm = nn.BatchNorm2d(1)
    def forward(self, maps):
        return self.norm(self.base(maps))""",
    "AGridThatIsNotPersistent": """
        self.register_buffer("grid", torch.linspace(-1, 1, 8).expand(4, 8), persistent=False)
    def forward(self, maps):
        return self.base(maps) + self.grid.mean()""",
    "ABasisOfItsOwnSeed": """
        self.basis = torch.randn(channels, 1, 1, generator=torch.Generator().manual_seed(3))
    def forward(self, maps):
        return self.base(maps * self.basis)""",
    "ACountThatDecidesNothing": """
        self.calls, self.seen = 0, []
    def forward(self, maps):
        self.calls += 1
        self.seen.append(maps.shape)
        return self.base(maps)""",
    "AStateOfPython": """
        self.seen = 0
    def get_extra_state(self):
        return {"seen": self.seen}
    def set_extra_state(self, state):
        self.seen = state["seen"]
    def forward(self, maps):
        self.seen += self.training
        return self.base(maps) * (1 + self.seen)""",
}


def networks_with(body: str) -> str:
    """A module with a class `Net` that has this body after its first layer."""
    start = "class Net(nn.Module):\n    def __init__(self, channels):\n        super().__init__()\n"
    first = "        self.base = nn.Conv2d(channels, 1, 3, padding=1, bias=False)\n"
    return f"import numpy as np\nimport torch\nfrom torch import nn\n{start}{first}{body.lstrip(chr(10))}\n"


@pytest.fixture(autouse=True)
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "networks_of_a_user.py"
    path.write_text(NETWORKS)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, path.stem, raising=False)


def spec(name: str, module: str = "networks_of_a_user", **changes: object) -> GeneratorSpec:
    plain = {"concat": "input", "upsampling": "transposed", "noise": "none"}
    return GeneratorSpec(family="custom", target=f"{module}.{name}", **{**plain, **changes})


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
        ("Seeds", "seeds torch .*so that training.seed decides nothing"),
        ("SeedsAsItRenders", "seeds torch .*so that training.seed decides nothing"),
        ("SetsTheType", r".* fails: ValueError: sets torch's default dtype, also of other networks"),
        ("SetsTheTypeAsItRenders", r".* fail: ValueError: sets torch's default dtype"),
        ("OfOneSize", "an image of 64 x 32 px fails, as frames are larger than crops: RuntimeError"),
        ("number", "is no class of torch.nn.Module"),
        ("Missing", "AttributeError.*allowed is the path of a class"),
    ],
)
def test_what_is_wrong_with_a_class_is_named(name: str, message: str) -> None:
    with pytest.raises(ValueError, match=f"^target=networks_of_a_user.{name}: {message}"):
        check_custom(spec(name), 32)
    check_custom(spec("Sum"), 32)
    assert torch.get_default_dtype() is torch.float32


@pytest.mark.parametrize("name", UNSAVED)
def test_a_network_that_a_checkpoint_does_not_hold_is_refused(name: str, tmp_path: Path) -> None:
    named, body = UNSAVED[name]
    (tmp_path / "unsaved.py").write_text(networks_with(body))
    sys.modules.pop("unsaved", None)
    with pytest.raises(ValueError, match=f"^target=unsaved.Net: .*(?:{named})"):
        check_custom(spec("Net", "unsaved"), 32)


@pytest.mark.parametrize("name", SAVED)
@pytest.mark.filterwarnings("ignore:.*weight_norm.* is deprecated")
def test_a_network_that_keeps_what_decides_nothing_or_is_saved_is_accepted(name: str, tmp_path: Path) -> None:
    (tmp_path / "saved.py").write_text(networks_with(SAVED[name]))
    sys.modules.pop("saved", None)
    check_custom(spec("Net", "saved"), 32)
