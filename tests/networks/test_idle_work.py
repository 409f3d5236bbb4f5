"""A generator does no work that its variant does not use: counted among torch's operations as they run."""

from typing import Any

import pytest
import torch

from ablate.networks import Generator, GeneratorSpec, conditions
from ablate.networks.layers import convolutions
from support.torch_operations import Operations
from support.variants import BEAM, BEAM_LABELS, UNET, random_maps

DEPTH = 3
SIZE = (16, 24)

# Operations by what they are for: area means of maps, noise fields drawn (one cosine each), noise injected
# (into features and into those of the skip connection).
OPERATIONS = {"resized": "avg_pool2d", "drawn": "cos", "injected": "addcmul", "padded": "constant_pad_nd"}
#: Variant, and how often each of these runs.
VARIANTS: dict[str, tuple[dict[str, Any], dict[str, int]]] = {
    "sa2h": ({}, {"resized": DEPTH, "drawn": DEPTH, "injected": 2 * DEPTH}),
    "sa2h-att": ({"attenuation": "none"}, {"drawn": DEPTH, "injected": 2 * DEPTH}),
    "sa2h-concat": ({"concat": "input"}, {"drawn": DEPTH, "injected": 2 * DEPTH}),
    "sa2h-noise": ({"noise": "input"}, {"resized": DEPTH, "drawn": 1}),
    "nothing": ({"attenuation": "none", "concat": "input", "upsampling": "transposed", "noise": "none"}, {}),
    "lsa2h": ({**UNET, "extra_input": "low"}, {}),
    "nsa2h": ({**UNET, "extra_input": "noise"}, {"drawn": 1}),
    "beam": (BEAM, {"resized": DEPTH, "drawn": DEPTH, "injected": 2 * DEPTH}),
}


def traced(name: str, size: tuple[int, int] = SIZE, seed: int | None = 1) -> tuple[Generator, Operations]:
    changes, _ = VARIANTS[name]
    labels = BEAM_LABELS if name == "beam" else 1
    generator = Generator(GeneratorSpec(**{"depth": DEPTH, "width": 0.1, **changes}), labels)
    maps = random_maps(labels, 1, *size)
    with torch.no_grad(), Operations() as operations:
        generator(**maps, noise_seed=None if seed is None else torch.tensor([seed]))
    return generator, operations


@pytest.mark.parametrize("name", VARIANTS)
def test_each_operation_runs_as_often_as_its_component_needs_and_on_as_many_channels(name: str) -> None:
    _, expected = VARIANTS[name]
    generator, operations = traced(name)
    counted = {what: operations.counts[operation] for what, operation in OPERATIONS.items()}
    assert counted == {what: expected.get(what, 0) for what in OPERATIONS}
    assert operations.channels == sum(layer.in_channels for layer in convolutions(generator))


@pytest.mark.parametrize("name", VARIANTS)
def test_no_field_is_drawn_without_a_seed_and_nothing_padded_that_fits(name: str) -> None:
    _, operations = traced(name, seed=None)
    assert not operations.counts["cos"] + operations.counts["addcmul"] + operations.counts["constant_pad_nd"]
    _, odd = traced(name, size=(15, 23), seed=None)
    assert odd.counts["constant_pad_nd"] == len(conditions(GeneratorSpec(**VARIANTS[name][0])))
