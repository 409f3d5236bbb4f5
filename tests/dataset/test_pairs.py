"""Pairs on disk: what is written is read back, nothing is made twice, nothing half-made counts."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from filelock import FileLock

from ablate.dataset import Pairs, Part, create_pairs, fill_pairs, open_pairs

SHAPE = (24, 40)
SPLIT = np.array([Part.train] * 11 + [Part.validation] * 3 + [Part.test] * 4, np.uint8)
WANTED = frozenset({"segmentation", "attenuation", "high", "high_again"})


@pytest.fixture
def pairs(tmp_path: Path) -> Pairs:
    n = len(SPLIT)
    poses = np.tile(np.eye(4), (n, 1, 1))
    return create_pairs(tmp_path / "set", poses, np.arange(n), SPLIT, np.ones(SHAPE, bool), 4, ["gel"], {"a": 1})


class Recorder:
    """A renderer whose images tell which frame they are."""

    def __init__(self) -> None:
        self.rendered: list[tuple[int, str]] = []

    def __call__(self, frames: np.ndarray, maps: frozenset[str]) -> Mapping[str, np.ndarray]:
        self.rendered += [(int(f), m) for f in frames for m in maps]
        return {
            m: np.stack([np.full(SHAPE, f / 20 if m == "attenuation" else f * 10 + len(m)) for f in frames])
            for m in maps
        }


def test_what_is_written_is_read_back(pairs: Pairs) -> None:
    made = list(fill_pairs(pairs, WANTED, Recorder()))
    assert sum(made) == len(SPLIT)
    assert not pairs.missing(WANTED)
    frames = [0, 5, 17]
    high = pairs.read("high", frames)
    assert high.dtype == np.uint8
    assert (high == np.array([4, 54, 174])[:, None, None]).all()
    np.testing.assert_allclose(pairs.read("attenuation", frames)[:, 0, 0], [0, 0.25, 0.85], atol=1 / 65535)


def test_filling_again_makes_nothing_and_a_new_map_only_itself(pairs: Pairs) -> None:
    list(fill_pairs(pairs, WANTED, Recorder()))
    again = Recorder()
    assert list(fill_pairs(open_pairs(pairs.folder), WANTED, again)) == []
    assert again.rendered == []
    list(fill_pairs(pairs, WANTED | {"low"}, again))
    assert {name for _, name in again.rendered} == {"low"}


def test_resimulation_is_for_unseen_frames_only(pairs: Pairs) -> None:
    recorder = Recorder()
    list(fill_pairs(pairs, WANTED, recorder))
    again = {frame for frame, name in recorder.rendered if name == "high_again"}
    assert again >= set(np.flatnonzero(SPLIT != Part.train))
    assert 0 not in again


def test_a_shard_in_other_hands_is_skipped_and_made_later(pairs: Pairs) -> None:
    with FileLock(pairs.folder / ".shard1.lock"):
        list(fill_pairs(pairs, WANTED, Recorder()))
    assert pairs.missing(WANTED) == (1,)
    list(fill_pairs(pairs, WANTED, Recorder()))
    assert pairs.missing(WANTED) == ()


def test_a_renderer_that_dies_leaves_the_shards_before_it(pairs: Pairs) -> None:
    class Dies(Recorder):
        def __call__(self, frames: np.ndarray, maps: frozenset[str]) -> Mapping[str, np.ndarray]:
            if frames[0] >= 8:
                raise MemoryError
            return super().__call__(frames, maps)

    with pytest.raises(MemoryError):
        list(fill_pairs(pairs, WANTED, Dies()))
    assert pairs.missing(WANTED) == (2, 3, 4)


def test_a_flipped_bit_is_noticed_on_reading(pairs: Pairs) -> None:
    list(fill_pairs(pairs, WANTED, Recorder()))
    file = pairs._shard_file("high", 0)
    content = bytearray(file.read_bytes())
    content[5] ^= 0x10
    file.write_bytes(bytes(content))
    with pytest.raises(Exception, match=r"(?i)checksum|crc"):
        pairs.read("high", [0])


def test_a_missing_set_says_how_to_make_it(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="task=simulate"):
        open_pairs(tmp_path)


def test_unknown_maps_are_named(pairs: Pairs) -> None:
    with pytest.raises(ValueError, match=r"doppler.*allowed: segmentation"):
        list(fill_pairs(pairs, frozenset({"doppler"}), Recorder()))
