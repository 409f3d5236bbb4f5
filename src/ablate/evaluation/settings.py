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
        for name, least, most in (("noise_draws", 2, 1000), ("pictures", 1, 1000), ("timed_frames", 1, 100_000)):
            if not least <= getattr(self, name) <= most:
                raise ValueError(f"evaluation.{name}={getattr(self, name)}: allowed are {least} to {most}")
