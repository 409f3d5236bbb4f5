"""The same training as anybody would write it first: two Adams, and numbers read after every step.

`tests/training/test_plain_training.py` shows that it gives the losses and the weights of `ablate.training`.
"""

import torch
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits as cross_entropy

from ablate.networks import Family, GeneratorSpec, conditions, discriminator_channels
from support.plain_gan import PlainDiscriminator, PlainLocal, PlainUNet


class PlainGAN:
    """Both networks, two Adams, and a step of each; the error is L1, or with two draws the CRPS."""

    def __init__(self, spec: GeneratorSpec, device: torch.device, two_draws: bool = False) -> None:
        self.spec = spec
        self.device = device
        self.two_draws = two_draws
        network = PlainUNet if spec.family is Family.unet else PlainLocal
        self.generator = network(spec).to(device)
        self.discriminator = PlainDiscriminator(discriminator_channels(spec), spec.width).to(device)
        for module in (*self.generator.modules(), *self.discriminator.modules()):
            if isinstance(module, nn.Conv2d | nn.ConvTranspose2d):
                nn.init.normal_(module.weight, 0.0, 0.02)
                nn.init.zeros_(module.bias)
        self.adam_g = torch.optim.Adam(self.generator.parameters(), 2e-4, (0.5, 0.999))
        self.adam_d = torch.optim.Adam(self.discriminator.parameters(), 2e-4, (0.5, 0.999))

    def step(self, batch: dict[str, Tensor], forwards: int = 1) -> dict[str, float]:
        """Train both networks on a batch; the generator renders it once or, once for each of them, twice."""
        batch = {name: value.to(self.device) for name, value in batch.items()}
        maps = torch.cat([batch[name] for name in conditions(self.spec)], 1)
        image, mask = batch["target"], batch["mask"]

        # The discriminator learns to tell the image from a fake of the same maps.
        fake = mask * (self.generator(maps) + 1) - 1  # black, which is -1, outside the fan
        real_logits = self.discriminator(maps, image)
        fake_logits = self.discriminator(maps, fake.detach())
        loss_real = cross_entropy(real_logits, torch.ones_like(real_logits))
        loss_fake = cross_entropy(fake_logits, torch.zeros_like(fake_logits))
        self.adam_d.zero_grad()
        (loss_real + loss_fake).backward()
        self.adam_d.step()
        if forwards == 2:
            fake = mask * (self.generator(maps) + 1) - 1

        # The generator learns to be taken for the image, and to be like it.
        logits = self.discriminator(maps, fake)
        loss_g = cross_entropy(logits, torch.ones_like(logits))
        error = (fake - image).abs().mean()
        l1 = error.item()
        if self.two_draws:
            second = mask * (self.generator(maps) + 1) - 1
            error = (error + (second - image).abs().mean() - (fake - second).abs().mean()) / 2
        self.adam_g.zero_grad()
        (loss_g + 100 * error).backward()
        self.adam_g.step()
        return {
            "loss_d": (loss_real + loss_fake).item(),
            "loss_g": loss_g.item(),
            "l1": l1,
            "logit_real": real_logits.mean().item(),
            "logit_fake": fake_logits.mean().item(),
        }
