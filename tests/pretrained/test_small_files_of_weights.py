"""A specification of a few bytes can name a network of terabytes: sizes are compared before anything is allocated."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

import ablate
from ablate.networks import Generator, GeneratorSpec, count_discriminator, count_generator, receptive_field
from ablate.training import load_generator
from support.memory import taking_at_most
from support.strangers import innocent_run

MB = 2**20
SHIPPED = Path(ablate.__file__).parent / "pretrained" / "sa2h.pt"
Weights = Mapping[str, Tensor]


class OfASize:
    """Unpickled, it is so many bytes, of which the file has none."""

    def __init__(self, kind: Callable[[int], Any]) -> None:
        self.kind = kind

    def __reduce__(self) -> tuple[Any, ...]:
        return self.kind, (200 * MB,)


def spread(content: dict[str, Any], width: float) -> Weights:
    """Weights of the shapes of a wide network, of which the file holds one number."""
    with torch.device("meta"):
        wide = Generator(GeneratorSpec(**content["spec"] | {"width": width}), content["labels"])
    return {name: torch.zeros(1).expand(weight.shape) for name, weight in wide.state_dict().items()}


_UNET = {"family": "unet", "concat": "input", "upsampling": "transposed", "noise": "none", "depth": 8, "width": 2.0}
CONTENTS: dict[str, tuple[Callable[[dict[str, Any]], dict[str, Any]], str]] = {
    "width": (lambda c: {"spec": c["spec"] | {"width": 8.0}}, r"stem\.weight: \(16, .* is stored, allowed is \(512, "),
    "far wider": (lambda c: {"spec": c["spec"] | {"width": 1e6}}, r"stem\.weight: \(16, .* is stored"),
    "beyond all": (lambda c: {"spec": c["spec"] | {"width": 1e300}}, ""),
    "depth": (lambda c: {"spec": c["spec"] | {"depth": 8, "width": 4.0}}, r"stem\.weight: \(16, .* is stored"),
    "family": (lambda _: {"spec": _UNET}, r"network\.down\.0\.weight: is no tensor"),
    "labels": (lambda _: {"labels": 10**5}, "labels=100000: allowed are 1 to 256"),
    "labels of no number": (lambda _: {"labels": "9" * 10**6}, "labels='999.*: allowed are 1 to 256"),
    "weights that share a number": (
        lambda c: {"spec": c["spec"] | {"width": 6.0}, "weights": spread(c, 6.0)},
        r"stem\.weight: the file holds fewer numbers than its shape, \(384, ",
    ),
    "weights that are not there": (
        lambda c: {"weights": {name: weight.to("meta") for name, weight in c["weights"].items()}},
        r"stem\.weight: is no tensor",
    ),
    "bytes of a size": (lambda _: {"made": OfASize(bytearray)}, "calls __builtin__ bytearray; allowed are tensors"),
    "a tensor of a size": (lambda _: {"made": OfASize(torch.FloatTensor)}, "calls torch FloatTensor; allowed are"),
}


@pytest.mark.parametrize("kind", CONTENTS)
def test_a_generator_of_a_few_bytes_takes_few(tmp_path: Path, kind: str) -> None:
    change, message = CONTENTS[kind]
    path = tmp_path / "small.pt"
    content = torch.load(SHIPPED, weights_only=True)
    torch.save(content | change(content), path)
    assert path.stat().st_size < 2 * MB
    del content
    with taking_at_most(60), pytest.raises(ValueError, match=rf"small\.pt: .*{message}") as raised:
        ablate.load(path)
    assert len(str(raised.value)) < 400
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(("name", "value"), [("width", 8.0), ("width", 1e300), ("depth", 8)])
def test_the_checkpoint_of_a_training_is_bounded_as_well(tmp_path: Path, name: str, value: float) -> None:
    run = innocent_run(tmp_path)
    content = torch.load(run.checkpoint, weights_only=True)
    content["hyper_parameters"]["spec"][name] = value
    torch.save(content, run.checkpoint)
    with taking_at_most(60), pytest.raises(ValueError, match=r"last\.ckpt: its weights are not of the network"):
        load_generator(run.checkpoint)


def test_the_sizes_of_a_network_take_no_memory() -> None:
    spec = GeneratorSpec(width=500.0, depth=8)
    with taking_at_most(100):
        assert count_generator(spec) > 1e12
        assert count_discriminator(spec) > 1e11
        assert receptive_field(spec) == receptive_field(replace(spec, width=1.0))
