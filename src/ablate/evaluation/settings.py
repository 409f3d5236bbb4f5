"""How a generator is evaluated, as values."""

from dataclasses import dataclass

from ablate.setting import Checked, setting

#: In the folder of a data set: scores that need no network.
BASELINES_FOLDER = "baselines"


@dataclass(frozen=True)
class EvaluationSettings(Checked):
    """How each frame is rendered and scored; a value that is not allowed is a ValueError that names it."""

    noise_draws: int = setting(3, "Renderings of a frame with other noise, for `crps`, `noise_sd`.", least=2, most=1000)
    pictures: int = setting(4, "Frames that are kept for figures.", least=1, most=1000, incidental=True)
    timed_frames: int = setting(
        20, "Rounds in which a comparison times a frame; it makes at least 8.", least=1, most=100_000, incidental=True
    )
    inception: str | None = setting(
        None, "Path of the network of FID, or `download`; null: no FID.", incidental=True, is_path=True
    )
