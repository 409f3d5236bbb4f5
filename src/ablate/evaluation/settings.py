"""How a generator is evaluated, as values."""

from dataclasses import dataclass


@dataclass(frozen=True)
class EvaluationSettings:
    """How often each frame is rendered with other noise, for `crps` and `noise_sd`; frames shown in figures and timed.

    `inception` is the path of the network of FID, or `download`; without it there is no FID.
    """

    noise_draws: int = 3
    pictures: int = 4
    timed_frames: int = 20
    inception: str | None = None

    def __post_init__(self) -> None:
        for name, least in (("noise_draws", 2), ("pictures", 1), ("timed_frames", 1)):
            if getattr(self, name) < least:
                raise ValueError(f"evaluation.{name}={getattr(self, name)}: allowed are {least} and more")
