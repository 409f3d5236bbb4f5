"""Which GPU each job of a sweep gets, where one machine has several."""

import os
from collections.abc import Iterable, Sequence

from omegaconf import DictConfig, OmegaConf

VISIBLE = "CUDA_VISIBLE_DEVICES"


def devices_to_share(config: DictConfig) -> tuple[str, ...]:
    """The GPUs that the jobs of a sweep are dealt to, as `CUDA_VISIBLE_DEVICES` names them.

    None where there are fewer than two, or where the jobs name their device: `training.device=cpu`, `=cuda:1`.
    """
    if OmegaConf.select(config, "training.device") not in ("auto", "cuda"):
        return ()
    import torch  # takes seconds, and a sweep on CPUs does without

    own = os.environ.get(VISIBLE)
    count = torch.cuda.device_count()
    named = [str(i) for i in range(count)] if own is None else [name.strip() for name in own.split(",")][:count]
    return tuple(named) if len(named) > 1 else ()


def least_busy(devices: Sequence[str], busy: Iterable[str | None]) -> str | None:
    """The device that fewest of the running jobs have, the first of several; None where there are no devices."""
    taken = list(busy)
    return min(devices, key=taken.count, default=None)
