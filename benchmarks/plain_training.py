"""The same training as anybody would write it first: two Adams, a number read after every step."""

import torch
from torch import Tensor, nn

from ablate.networks import Family, GeneratorSpec, conditions, discriminator_channels
from support.plain_gan import PlainDiscriminator, PlainLocal, PlainUNet


class PlainGAN:
    """Both networks, two Adams, and a step of each; the loss is L1, or with two draws the CRPS."""

    def __init__(self, spec: GeneratorSpec, device: torch.device, two_draws: bool = False) -> None:
        self.spec, self.device, self.two_draws = spec, device, two_draws
        network = PlainUNet if spec.family is Family.unet else PlainLocal
        self.generator = network(spec).to(device)
        self.discriminator = PlainDiscriminator(discriminator_channels(spec), spec.width).to(device)
        for module in (*self.generator.modules(), *self.discriminator.modules()):
            if isinstance(module, nn.Conv2d | nn.ConvTranspose2d):
                nn.init.normal_(module.weight, 0.0, 0.02)
        self.adam_g, self.adam_d = (
            torch.optim.Adam(network.parameters(), 2e-4, (0.5, 0.999))
            for network in (self.generator, self.discriminator)
        )
        self.criterion = nn.BCEWithLogitsLoss()

    def step(self, batch: dict[str, Tensor], forwards: int) -> dict[str, float]:
        """Train both networks on a batch; the generator renders it once or, once for each of them, twice."""
        batch = {name: value.to(self.device) for name, value in batch.items()}
        maps = torch.cat([batch[name] for name in conditions(self.spec)], 1)
        mask, image = batch["mask"], batch["target"]
        fake = mask * (self.generator(maps) + 1) - 1
        self.adam_d.zero_grad()
        real_logits, fake_logits = self.discriminator(maps, image), self.discriminator(maps, fake.detach())
        loss_real = self.criterion(real_logits, torch.ones_like(real_logits))
        loss_fake = self.criterion(fake_logits, torch.zeros_like(fake_logits))
        (loss_real + loss_fake).backward()
        self.adam_d.step()
        if forwards == 2:
            fake = mask * (self.generator(maps) + 1) - 1
        self.adam_g.zero_grad()
        logits = self.discriminator(maps, fake)
        loss_g = self.criterion(logits, torch.ones_like(logits))
        l1 = error = (mask * (fake - image).abs()).sum() / mask.sum()
        if self.two_draws:
            second = mask * (self.generator(maps) + 1) - 1
            of_second = (mask * (second - image).abs()).sum() / mask.sum()
            error = (l1 + of_second - (mask * (fake - second).abs()).sum() / mask.sum()) / 2
        (loss_g + 100 * error).backward()
        self.adam_g.step()
        return {
            "loss_d": (loss_real + loss_fake).item(),
            "loss_g": loss_g.item(),
            "l1": l1.item(),
            "logit_real": real_logits.mean().item(),
            "logit_fake": fake_logits.mean().item(),
        }
