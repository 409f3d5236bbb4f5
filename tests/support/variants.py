"""Generators that tests go through, as the settings in which each differs from the paper's full model SA2H."""

from typing import Any

import torch
from torch import Tensor

from ablate.networks import map_channels

UNET = {"family": "unet", "concat": "input", "upsampling": "transposed", "noise": "none"}
#: The representation of the presets: four more maps, and a convolution after the finest noise.
BEAM = {
    "space": "beam",
    "attenuation": "illumination",
    "interfaces": "echo",
    "position": "beam",
    "grain": "refine",
    "noise_start": 0.5,
}
VARIANTS: dict[str, dict[str, Any]] = {
    "sa2h": {},
    "att": {"attenuation": "none"},
    "compensated": {"attenuation": "compensated"},
    "compensated-unet": {**UNET, "attenuation": "compensated", "extra_input": "low"},
    "concat": {"concat": "input"},
    "conv": {"upsampling": "transposed"},
    "noise-input": {"noise": "input"},
    "noise-none": {"noise": "none"},
    "low": {"extra_input": "low"},
    "lsa2h": {**UNET, "extra_input": "low"},
    "nsa2h": {**UNET, "extra_input": "noise"},
    "beam": BEAM,
    "beam-body": {**BEAM, "noise": "body", "noise_start": 0.0},
    "beam-body-concat": {**BEAM, "noise": "body", "noise_start": 0.0, "concat": "input"},
    "beam-unet-body": {**UNET, "space": "beam", "noise": "body"},
    "beam-folded": {**BEAM, "fold": "rows"},
    "beam-unet-folded": {**UNET, "space": "beam", "fold": "rows", "noise": "body"},
    "beam-unet": {**UNET, "attenuation": "illumination", "position": "beam"},
}
#: Channels of the segmentation in the representation of the presets; one in all others.
BEAM_LABELS = 3
LABELS = {name: BEAM_LABELS if name.startswith("beam") else 1 for name in VARIANTS}
#: Every map that some generator reads, and what it is outside the fan.
OUTSIDE = {"segmentation": -1.0, "low": -1.0, "depth": 0.0, "lateral": 0.0, "interfaces": 0.0, "grain": 0.0}
OUTSIDE |= dict.fromkeys(("attenuation", "compensated", "illumination", "compound"), 0.0)


def random_maps(labels: int, batch: int, height: int, width: int, seed: int = 0) -> dict[str, Tensor]:
    """Random maps in their ranges, (batch, channels, height, width), whether the generator reads them or not."""
    random = torch.Generator().manual_seed(seed)
    shapes = {name: (batch, map_channels(name, labels), height, width) for name in OUTSIDE}
    return {name: torch.rand(shapes[name], generator=random) * (1 - low) + low for name, low in OUTSIDE.items()}
