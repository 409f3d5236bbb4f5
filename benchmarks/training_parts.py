"""What makes a training step fast, each part switched off or, of what was tried and left, on: `--parts` of
`training.py` runs a training in a process that has called one of these.
"""

import os
from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor
from torch.nn import functional as F

from ablate.networks import families, layers
from ablate.training import loop


def _norm_by_torch(features: Tensor) -> Tensor:
    single = features.shape[-1] * features.shape[-2] == 1
    return features if single else F.group_norm(features, features.shape[1])


def without_own_norm() -> None:
    """Instance norm is torch's group norm."""
    families.instance_norm = _norm_by_torch


def without_channels_last() -> None:
    """Maps are laid out channel by channel, and instance norm is what is fastest there."""
    torch.channels_last = torch.contiguous_format
    without_own_norm()


def without_sums() -> None:
    """Features, those of the skip connection and maps are appended to one another."""
    joint, transposed = layers.JointConvolution.forward, layers.JointTransposedConvolution.forward

    def joined(parts: tuple[Tensor | None, ...]) -> Tensor:
        return torch.cat([part for part in parts if part is not None], dim=1)

    layers.JointConvolution.forward = lambda self, *parts: joint(self, joined(parts))
    layers.JointTransposedConvolution.forward = lambda self, *parts: transposed(self, joined(parts))


def with_noise_as_product() -> None:
    """Injected noise is added by a matrix product of one column."""

    def addcmul(features: Tensor, noise: Tensor, weight: Tensor) -> Tensor:
        batch, channels, height, width = features.shape
        rows = features.permute(0, 2, 3, 1).reshape(-1, channels)
        rows = torch.addmm(rows, noise.reshape(-1, 1), weight.reshape(1, -1))
        return rows.view(batch, height, width, channels).permute(0, 3, 1, 2)

    class Torch:
        def __getattr__(self, name: str) -> object:
            return addcmul if name == "addcmul" else getattr(torch, name)

    families.torch = Torch()


def with_activations_in_place() -> None:
    """Activations overwrite what they are computed from."""

    class Functional:
        def __getattr__(self, name: str) -> object:
            return partial(getattr(F, name), inplace=True) if name in ("relu", "leaky_relu") else getattr(F, name)

    families.F = Functional()


def with_flushed_denormals() -> None:
    """Numbers under 1e-38 are zero."""
    torch.set_flush_denormal(True)


def with_huge_pages() -> None:
    """Large blocks lie on pages of 2 MiB."""
    os.environ["THP_MEM_ALLOC_ENABLE"] = "1"  # read by torch at its first large block


def with_compilation() -> None:
    """Both networks are compiled; the warm-up holds the compilation."""
    made = loop.PairGAN.__init__

    def compiled(self: loop.PairGAN, *arguments: object) -> None:
        made(self, *arguments)
        self.generator.compile()
        self.discriminator.compile()

    loop.PairGAN.__init__ = compiled


PARTS: dict[str, Callable[[], None]] = {
    "channels-last maps": without_channels_last,
    "own instance norm": without_own_norm,
    "sums of convolutions": without_sums,
}
TRIED: dict[str, Callable[[], None]] = {
    "noise as a matrix product": with_noise_as_product,
    "activations in place": with_activations_in_place,
    "denormals flushed": with_flushed_denormals,
    "pages of 2 MiB": with_huge_pages,
}
COMPILED: dict[str, Callable[[], None]] = {"torch.compile": with_compilation}
