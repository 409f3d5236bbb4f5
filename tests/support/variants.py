"""Generators that tests go through, as the settings in which each differs from the paper's full model SA2H."""

from typing import Any

UNET = {"family": "unet", "concat": "input", "upsampling": "transposed", "noise": "none"}
VARIANTS: dict[str, dict[str, Any]] = {
    "sa2h": {},
    "att": {"attenuation": "none"},
    "compensated": {"attenuation": "compensated"},
    "compensated-unet": {**UNET, "attenuation": "compensated", "extra_input": "low"},
    "concat": {"concat": "input"},
    "conv": {"upsampling": "transposed"},
    "resize": {"upsampling": "resize"},
    "noise-input": {"noise": "input"},
    "noise-none": {"noise": "none"},
    "low": {"extra_input": "low"},
    "lsa2h": {**UNET, "extra_input": "low"},
    "nsa2h": {**UNET, "extra_input": "noise"},
}
