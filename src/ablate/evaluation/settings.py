"""How a generator is evaluated, as values."""

from dataclasses import dataclass


@dataclass(frozen=True)
class EvaluationSettings:
    """What is computed on the test frames: `noise_draws` for `noise_sd`, `pictures` frames shown in figures.

    `inception` is the path of the network of FID, or `download`; without it there is no FID.
    """

    noise_draws: int = 8
    noise_frames: int = 10
    pictures: int = 4
    timed_frames: int = 20
    inception: str | None = None

    def __post_init__(self) -> None:
        for name, least in (("noise_draws", 2), ("noise_frames", 1), ("pictures", 1), ("timed_frames", 1)):
            if getattr(self, name) < least:
                raise ValueError(f"evaluation.{name}={getattr(self, name)}: allowed are {least} and more")
