"""Jobs that have filled a data set together each draw its picture."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from skimage.io import imread

from ablate.dataset import Pairs, fill_pairs, write_contact_sheet


@pytest.fixture
def filled(blank: Callable[..., Pairs], tmp_path: Path) -> Pairs:
    pairs = blank(tmp_path / "set", 8, 4)

    def grey(frames: np.ndarray, maps: frozenset[str]) -> dict[str, np.ndarray]:
        return {name: np.full((len(frames), *pairs.shape), 100) for name in maps}

    list(fill_pairs(pairs, frozenset({"segmentation", "target"}), grey))
    return pairs


def test_two_jobs_draw_it_at_the_same_moment(filled: Pairs, monkeypatch: pytest.MonkeyPatch) -> None:
    picture, save = filled.folder / "contact_sheet.png", Image.Image.save

    def while_the_other_does_too(image: Image.Image, path: Path) -> None:
        save(image, path)
        monkeypatch.setattr(Image.Image, "save", save)
        write_contact_sheet(filled, picture)

    monkeypatch.setattr(Image.Image, "save", while_the_other_does_too)
    write_contact_sheet(filled, picture)
    assert imread(picture).std() > 0
    assert list(filled.folder.glob("*.png")) == [picture]
