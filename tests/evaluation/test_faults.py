"""Nothing is silently wrong where scores are made, and where they are read back."""

from collections.abc import Mapping
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


def notes_of(images_of: ImageSource, missing: Mapping[Part, dict[str, str]] | None = None) -> tuple[str, ...]:
    """The notes of a run whose scores themselves are left out; frames 0 to 3 validate and 4 to 7 test."""
    of_part = {Part.validation: np.arange(4), Part.test: np.arange(4, 8)}

    def score(part: Part, images_of: ImageSource, _draws_noise: bool, **_: object) -> Scores:
        images_of(of_part[part], 0)
        no_rows = pd.DataFrame(columns=["frame", "site", "metric", "value"])
        return Scores(no_rows, {}, (missing or {}).get(part, {}))

    pairs = SimpleNamespace(maps=frozenset(), frames=of_part.__getitem__)
    return score_run(SimpleNamespace(score=score, pairs=pairs), images_of, False).notes


def test_what_one_part_alone_lacks_is_noted_and_what_both_lack_once() -> None:
    missing = {
        Part.validation: {"fid": "no weights", "kid": "no weights", "fd_speckle": "too few patches"},
        Part.test: {"fid": "no weights", "kid": "no weights", "thin_contrast": "no bone"},
    }
    assert notes_of(lambda frames, _: np.zeros((len(frames), 10, 100), np.uint8), missing) == (
        "fid and kid: not computed, no weights.",
        "thin_contrast: not computed, no bone.",
        "fd_speckle: not computed, too few patches (of the validation frames alone).",
    )


def test_a_test_frame_alone_is_rendered_before_all_and_after_them() -> None:
    rendered: list[int] = []

    def images_of(frames: np.ndarray, _draw: int) -> np.ndarray:
        rendered.extend(frames.tolist())
        return np.zeros((len(frames), 10, 100), np.uint8)

    assert notes_of(images_of) == ()
    assert rendered == [4, *range(8), 4]


def test_a_generator_that_keeps_what_it_has_rendered_is_noted() -> None:
    """It darkens from frame to frame, by less than the rounding of a GPU between one frame and the next."""
    seen = np.zeros(1)

    def images_of(frames: np.ndarray, _draw: int) -> np.ndarray:
        seen[0] += len(frames)
        return np.full((len(frames), 10, 100), 200 - seen[0] // 3, np.uint8)

    (note,) = notes_of(images_of)
    assert "frame 4 differently" in note
    assert "what it keeps of other frames" in note


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
    assert note.startswith("The generator renders frame 4 differently each time with the same noise, by up to 5")
    rounded = iter(range(100))
    assert notes_of(lambda frames, _: np.full((len(frames), 10, 100), 7 + next(rounded) % 2, np.uint8)) == ()
