"""A training as small as it gets: a generator with every component, and batches that depend on the step alone."""

from collections.abc import Iterator

import torch
from torch import Tensor

from ablate.networks import GeneratorSpec
from ablate.training import TrainingPrecision, TrainingSettings

SPEC = GeneratorSpec(depth=2, width=0.05, noise_start=0.1)
SETTINGS = TrainingSettings(
    steps=8,
    batch_size=2,
    crop=32,
    ema_decay=0.9,
    precision=TrainingPrecision.fp32,
    device="cpu",
    threads=1,
    checkpoint_every=3,
    log_every=2,
)


def batch(step: int, size: int = 32) -> dict[str, Tensor]:
    """Blocks of labels whose grey level follows the label and the attenuation, in a fan of half the crop."""
    random = torch.Generator().manual_seed(step)
    labels = torch.randint(0, 4, (2, 1, 4, 4), generator=random).repeat_interleave(size // 4, -1)
    segmentation = labels.repeat_interleave(size // 4, -2) / 2.0 - 1
    attenuation = torch.linspace(1, 0, size)[:, None].expand(2, 1, size, size).clone()
    mask = torch.zeros(2, 1, size, size)
    mask[..., size // 4 : 3 * size // 4] = 1
    speckle = 0.2 * torch.rand(mask.shape, generator=random)
    image = mask * (0.5 * (segmentation + 1) * attenuation + speckle) - 1
    return {
        "segmentation": segmentation * mask + mask - 1,
        "attenuation": attenuation * mask,
        "compensated": (1 - attenuation / 2) * mask,
        "illumination": attenuation.square() * mask,
        "compound": attenuation.sqrt() * mask,
        "interfaces": (segmentation == 0) * mask,
        "depth": torch.linspace(-1, 1, size)[:, None].expand(2, 1, size, size),
        "lateral": torch.linspace(-1, 1, size).expand(2, 1, size, size),
        "low": image.roll(1, -1),
        "target": image,
        "mask": mask,
        "noise_seed": torch.randint(0, 2**62, (2,), generator=random),
    }


def loader(start: int, stop: int) -> Iterator[dict[str, Tensor]]:
    """Batches of the steps `start` to `stop` - 1."""
    return map(batch, range(start, stop))
