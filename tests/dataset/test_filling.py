"""Filling a data set: nothing is made twice, nothing half-made counts, and only what is damaged is made again."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from filelock import FileLock

from ablate.dataset import Pairs, Part, create_pairs, fill_pairs, open_pairs, remove_damaged

SHAPE = (24, 40)
SPLIT = np.array([Part.train] * 11 + [Part.validation] * 3 + [Part.test] * 4, np.uint8)
WANTED = frozenset({"segmentation", "attenuation", "target", "resimulation"})


@pytest.fixture
def pairs(tmp_path: Path) -> Pairs:
    n = len(SPLIT)
    poses = np.tile(np.eye(4), (n, 1, 1))
    return create_pairs(tmp_path / "set", poses, np.arange(n), SPLIT, np.ones(SHAPE, bool), 4, ["gel"], {"a": 1})


class Recorder:
    """A renderer of noise that depends on frame and map alone, and that remembers what it was asked for."""

    def __init__(self) -> None:
        self.rendered: list[tuple[int, str]] = []

    def __call__(self, frames: np.ndarray, maps: frozenset[str]) -> Mapping[str, np.ndarray]:
        self.rendered += [(int(f), m) for f in frames for m in maps]
        return {m: np.stack([self.image(int(f), m) for f in frames]) for m in maps}

    def image(self, frame: int, name: str) -> np.ndarray:
        rng = np.random.default_rng([frame, len(name)])
        return rng.random(SHAPE) if name == "attenuation" else rng.integers(0, 256, SHAPE)


def state(pairs: Pairs) -> dict[str, tuple[bytes, int]]:
    """Content and modification time of every file but the locks."""
    found = [p for p in pairs.folder.rglob("*") if p.is_file() and p.suffix != ".lock"]
    return {str(p): (p.read_bytes(), p.stat().st_mtime_ns) for p in found}


def flip(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[len(content) // 3] ^= 0x10
    file.write_bytes(content)


def test_a_set_that_is_full_is_left_alone(pairs: Pairs) -> None:
    list(fill_pairs(pairs, WANTED, Recorder()))
    before, again = state(pairs), Recorder()
    assert list(fill_pairs(open_pairs(pairs.folder), WANTED, again)) == []
    assert again.rendered == []
    assert state(pairs) == before


def test_a_new_map_is_added_without_touching_the_others(pairs: Pairs) -> None:
    list(fill_pairs(pairs, WANTED, Recorder()))
    before, again = state(pairs), Recorder()
    list(fill_pairs(pairs, WANTED | {"low"}, again))
    after = state(pairs)
    assert {name for _, name in again.rendered} == {"low"}
    assert {path: after[path] for path in before} == before
    assert all("/low/" in path for path in after.keys() - before.keys())
    assert not pairs.missing(WANTED | {"low"})


def test_resimulation_is_for_unseen_frames_only(pairs: Pairs) -> None:
    recorder = Recorder()
    list(fill_pairs(pairs, WANTED, recorder))
    again = {frame for frame, name in recorder.rendered if name == "resimulation"}
    assert again >= set(np.flatnonzero(SPLIT != Part.train))
    assert 0 not in again


def test_a_shard_in_other_hands_is_skipped_and_made_later(pairs: Pairs) -> None:
    with FileLock(pairs.folder / ".shard1.lock"):
        list(fill_pairs(pairs, WANTED, Recorder()))
    assert pairs.missing(WANTED) == (1,)
    list(fill_pairs(pairs, WANTED, Recorder()))
    assert pairs.missing(WANTED) == ()


def test_images_that_are_black_are_made_once(pairs: Pairs) -> None:
    def black(frames: np.ndarray, maps: frozenset[str]) -> Mapping[str, np.ndarray]:
        return {m: np.zeros((len(frames), *SHAPE)) for m in maps}

    list(fill_pairs(pairs, WANTED, black))
    assert not pairs.missing(WANTED)
    assert (pairs.read("target", range(len(pairs))) == 0).all()


def test_a_renderer_that_dies_leaves_the_shards_before_it(pairs: Pairs) -> None:
    class Dies(Recorder):
        def __call__(self, frames: np.ndarray, maps: frozenset[str]) -> Mapping[str, np.ndarray]:
            if frames[0] >= 8:
                raise MemoryError
            return super().__call__(frames, maps)

    with pytest.raises(MemoryError):
        list(fill_pairs(pairs, WANTED, Dies()))
    assert pairs.missing(WANTED) == (2, 3, 4)


def truncate(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:-9])


@pytest.mark.parametrize("damage", [flip, truncate])
def test_only_what_is_damaged_is_made_again(pairs: Pairs, damage: Callable[[Path], None]) -> None:
    list(fill_pairs(pairs, WANTED, Recorder()))
    assert remove_damaged(pairs, WANTED) == ()
    before = state(pairs)
    damaged = pairs.shard_file("attenuation", 4)  # the last, which is not full
    damage(damaged)
    (why,) = remove_damaged(pairs, WANTED)
    assert f"{damaged}, 'attenuation' of frames 16 to 17, is damaged" in why
    recorder = Recorder()
    list(fill_pairs(pairs, WANTED, recorder))
    assert recorder.rendered == [(16, "attenuation"), (17, "attenuation")]
    after = state(pairs)
    assert {path: content for path, (content, _) in after.items()} == {p: c for p, (c, _) in before.items()}
    assert {path for path in before if after[path] != before[path]} == {str(damaged)}


def test_a_damaged_shard_that_another_process_mends_is_left_to_it(pairs: Pairs) -> None:
    list(fill_pairs(pairs, WANTED, Recorder()))
    flip(pairs.shard_file("target", 0))
    with FileLock(pairs.folder / ".shard0.lock"):
        assert remove_damaged(pairs, WANTED) == ()
    assert len(remove_damaged(pairs, WANTED)) == 1
