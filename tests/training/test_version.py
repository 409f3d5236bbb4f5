"""A few steps of training give the numbers that they gave before; where they do not, runs are of another version."""

from dataclasses import replace

import pytest
import torch

from ablate.training import TRAINING_VERSION, PairGAN
from support.tiny_training import SETTINGS, SPEC, batch
from support.variants import BEAM, UNET

# In float64 all processors agree to about 1e-7: without vector instructions, with AVX2 and AVX-512, with and without
# oneDNN. In float32, rounding grows from step to step, and the bound would have to hide small changes.
RELATIVE, ABSOLUTE = 2e-6, 1e-6
CASES: dict[str, tuple[dict[str, object], dict[str, object]]] = {
    "of the paper": ({}, {}),
    "two draws": ({}, {"reconstruction": "crps", "ema_decay": 0.0}),
    "without a discriminator": ({"attenuation": "none"}, {"loss": "none", "schedule": "linear"}),
    "minimax": ({"attenuation": "compensated", "noise": "input", "noise_start": 0.0}, {"loss": "minimax"}),
    "transposed": ({"upsampling": "transposed", "concat": "input"}, {}),
    "in beam space": (BEAM, {"reconstruction": "crps"}),
    "U-Net": ({**UNET, "depth": 5, "noise_start": 0.0, "extra_input": "noise"}, {}),
}
ADAM = {"lr": 2e-4, "betas": (0.5, 0.999), "eps": 1e-8, "weight_decay": 0, "amsgrad": False}
#: Mean losses and logits, and the sums of the sizes of the weights; None where a case has none.
NAMES = ("loss_d", "logit_real", "logit_fake", "loss_g", "l1", "crps", "generator", "average")
PINNED: dict[str, tuple[float | None, ...]] = {
    "of the paper": (1.34894454, 0.128511325, 0.0247982442, 0.706687212, 0.272734653, None, 68.0931672, 68.0867029),
    "two draws": (1.34814298, 0.128184319, 0.0232211202, 0.70708698, 0.272638128, 0.266890617, 68.1271034, None),
    "without a discriminator": (None, None, None, None, 0.329945607, None, 60.2594872, 60.2557392),
    "minimax": (1.36748981, -0.0649067238, -0.11420393, -0.617313027, 0.413090851, None, 66.647827, 66.643791),
    "transposed": (1.38623476, 0.0581897311, 0.0370989144, 0.699575961, 0.29700616, None, 59.8350614, 59.822552),
    "in beam space": (
        1.39165437,
        -0.00920275226,
        -0.0143437413,
        0.718187094,
        0.33030033,
        0.328097074,
        107.26988,
        107.250494,
    ),
    "U-Net": (1.38713849, 0.00013750419, -0.0216638763, 0.725332022, 0.339702077, None, 683.300796, 683.269237),
}


@pytest.mark.parametrize("case", CASES)
def test_training_is_of_this_version(case: str) -> None:
    of_spec, of_settings = CASES[case]
    module = PairGAN(replace(SPEC, **of_spec), replace(SETTINGS, steps=6, **of_settings)).double()
    optimizers = module.configure_optimizers()
    module.optimizers = lambda: optimizers if len(optimizers) > 1 else optimizers[0]  # type: ignore[method-assign]
    module.manual_backward = lambda loss: loss.backward()  # type: ignore[method-assign]
    for step in range(module.settings.steps):
        module.training_step({k: v.double() if v.is_floating_point() else v for k, v in batch(step).items()}, step)
    measured = {name.removeprefix("train/"): value for name, value in module.drain().items()}
    for name, network in (("generator", module.generator), ("average", module.average)):
        if network is not None:
            measured[name] = float(torch.cat([p.detach().flatten() for p in network.parameters()]).abs().sum())
    of_adam = {k: v for k, v in optimizers[0].defaults.items() if k in ADAM}
    assert of_adam == ADAM, "raise TRAINING_VERSION; six steps do not show this"
    pinned = {name: value for name, value in zip(NAMES, PINNED[case], strict=True) if value is not None}
    assert measured == pytest.approx(pinned, rel=RELATIVE, abs=ABSOLUTE), (
        f"the same settings and crops now train another network: raise TRAINING_VERSION (now {TRAINING_VERSION}) in "
        "ablate/training/settings.py, so that no stored run goes on with this code, and pin these numbers"
    )
