"""Jobs that have filled a data set together each draw its picture."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from skimage.io import imread, imsave

from ablate.dataset import Pairs, fill_pairs, write_contact_sheet


@pytest.fixture
def filled(blank: Callable[..., Pairs], tmp_path: Path) -> Pairs:
    pairs = blank(tmp_path / "set", 8, 4)

    def grey(frames: np.ndarray, maps: frozenset[str]) -> dict[str, np.ndarray]:
        return {name: np.full((len(frames), *pairs.shape), 100) for name in maps}

    list(fill_pairs(pairs, frozenset({"segmentation", "target"}), grey))
    return pairs


def test_two_jobs_draw_it_at_the_same_moment(filled: Pairs, monkeypatch: pytest.MonkeyPatch) -> None:
    picture = filled.folder / "contact_sheet.png"

    def while_the_other_does_too(path: Path, image: np.ndarray, **options: object) -> None:
        imsave(path, image, **options)
        monkeypatch.setattr("ablate.dataset.contact_sheet.imsave", imsave)
        write_contact_sheet(filled, picture)

    monkeypatch.setattr("ablate.dataset.contact_sheet.imsave", while_the_other_does_too)
    write_contact_sheet(filled, picture)
    assert imread(picture).std() > 0
    assert list(filled.folder.glob("*.png")) == [picture]
