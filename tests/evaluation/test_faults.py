"""Nothing is silently wrong where scores are made, and where they are read back."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import torch

from ablate.dataset import Part, counted_clipping, decode_grey_levels
from ablate.evaluation import ImageSource, Scores, score_run

FAN = torch.ones(10, 100, dtype=torch.bool)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_no_grey_level(value: float) -> None:
    image = torch.zeros(10, 100)
    image[3, 4] = value
    with pytest.raises(ValueError, match="the generator's output holds NaN or infinite values"):
        decode_grey_levels(image, FAN)
    with pytest.raises(ValueError, match="NaN or infinite"):
        decode_grey_levels(image.bfloat16(), FAN)


def notes_of(images_of: ImageSource) -> tuple[str, ...]:
    """The notes of a run whose scores themselves are left out."""

    def score(_part: Part, images_of: ImageSource, _draws_noise: bool) -> Scores:
        images_of(np.arange(4), 0)
        return Scores(pd.DataFrame(columns=["frame", "site", "metric", "value"]), {}, ("fid: not computed.",))

    pairs = SimpleNamespace(maps=frozenset(), frames=lambda _part: np.arange(4))
    notes = score_run(SimpleNamespace(score=score, pairs=pairs), images_of, False).notes
    assert notes[0] == "fid: not computed."
    return notes[1:]


@pytest.mark.parametrize(
    ("beyond", "share"),
    [(0, ""), (1, ""), (20, "in 2 % of the pixels"), (1000, "in 1e+02 % of the pixels")],
    ids=["none", "too few", "some", "all"],
)
def test_clipped_values_are_counted_once_a_run(beyond: int, share: str) -> None:
    image = torch.zeros(1000)
    image[:beyond] = 100.0

    def images_of(frames: np.ndarray, _draw: int) -> np.ndarray:
        return np.stack([decode_grey_levels(image.reshape(10, 100), FAN).numpy() for _ in frames])

    notes = notes_of(images_of)
    assert len(notes) == bool(share)
    assert share in " ".join(notes)


def test_rounding_and_what_lies_outside_the_fan_is_not_clipped() -> None:
    with counted_clipping() as counts:
        decode_grey_levels(torch.full((10, 100), 1.003), FAN)
        decode_grey_levels(torch.full((10, 100), -7.0), FAN & (torch.arange(100) < 0))
        decode_grey_levels(torch.full((10, 100), -1.01), FAN)
    decode_grey_levels(torch.full((10, 100), -1.01), FAN)
    assert counts == [(0, 1000), (0, 0), (1000, 1000)]


def test_a_generator_that_renders_the_same_differently_is_noted() -> None:
    rng = np.random.default_rng(0)

    def images_of(frames: np.ndarray, _draw: int) -> np.ndarray:
        return rng.integers(0, 60, (len(frames), 10, 100)).astype(np.uint8)

    (note,) = notes_of(images_of)
    assert note.startswith("The generator renders frame 0 differently each time with the same noise, by up to 5")
    rounded = iter(range(100))
    assert notes_of(lambda frames, _: np.full((len(frames), 10, 100), 7 + next(rounded) % 2, np.uint8)) == ()
