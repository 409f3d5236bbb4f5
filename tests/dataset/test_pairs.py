"""Pairs on disk: nothing is made twice, and what is damaged is named and made again."""

import threading
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
import zarr
from filelock import FileLock

from ablate.dataset import (
    DamagedShardError,
    Pairs,
    Part,
    PlacedFrames,
    StoredAs,
    create_pairs,
    fill_pairs,
    open_pairs,
    remove_damaged,
)
from ablate.dataset.pairs import PAIRS_VERSION

SHAPE = (24, 40)
SPLIT = np.array([Part.train] * 11 + [Part.validation] * 3 + [Part.test] * 4, np.uint8)
WANTED = frozenset({"segmentation", "attenuation", "target", "resimulation"})


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


@pytest.fixture
def empty(tmp_path: Path) -> Pairs:
    n = len(SPLIT)
    poses = np.tile(np.eye(4), (n, 1, 1))
    placed = PlacedFrames(poses, np.arange(n), SPLIT, np.ones(SHAPE, bool))
    return create_pairs(tmp_path / "set", placed, StoredAs(4, ["gel"]), {"a": 1})


@pytest.fixture
def pairs(empty: Pairs) -> Pairs:
    assert sum(fill_pairs(empty, WANTED, Recorder())) == len(SPLIT)
    assert not empty.missing(WANTED)
    return empty


def test_zarr_opens_the_set_without_this_package(pairs: Pairs) -> None:
    group = zarr.open_group(pairs.folder / "pairs.zarr", mode="r")
    assert group.metadata.zarr_format == 3
    assert set(group.array_keys()) == WANTED | {"pose", "site", "split", "mask"}
    for name in WANTED:
        assert group[name].shards == (4, *SHAPE)
        stored = np.stack([pairs.stored(name, i) for i in range(11, len(pairs))])
        np.testing.assert_array_equal(group[name][11:], stored)
    np.testing.assert_array_equal(group["split"][...], SPLIT)


def test_a_set_opened_again_is_the_same(pairs: Pairs) -> None:
    again = open_pairs(str(pairs.folder))
    assert (again.shape, again.shard, again.tissues, len(again)) == (SHAPE, 4, ("gel",), len(SPLIT))
    for ours, theirs in ((again.poses, pairs.poses), (again.sites, pairs.sites), (again.split, SPLIT)):
        np.testing.assert_array_equal(ours, theirs)
    assert again.mask().all()


def test_a_damaged_shard_is_named_on_reading_with_what_mends_it(pairs: Pairs) -> None:
    flip(pairs.shard_file("target", 2))
    message = r"target/c/2/0/0, 'target' of frames 8 to 11.*checksum; .*task=simulate"
    with pytest.raises(DamagedShardError, match=message):
        pairs.read("target", [8, 9, 10, 11])
    pairs.read("target", [7, 12])


def test_readers_side_by_side_share_the_thread_of_the_first_read(pairs: Pairs) -> None:
    """One that is started later may never come where there is no memory, and all readers then wait for it."""
    readers = [threading.Thread(target=pairs.stored, args=("target", range(11))) for _ in range(8)]
    for reader in readers:
        reader.start()
    for reader in readers:
        reader.join()
    decoding = [thread.name for thread in threading.enumerate() if thread.name.startswith(("zarr_pool", "asyncio"))]
    assert len(decoding) == 1


def test_a_frame_that_is_not_made_is_an_error_and_not_an_empty_image(pairs: Pairs) -> None:
    pairs.shard_file("target", 1).unlink()
    with pytest.raises(FileNotFoundError, match=r"target/c/1/0/0: not made yet.*task=simulate"):
        pairs.read("target", [4])


@pytest.mark.parametrize("name", ["pose", "site", "split", "mask"])
def test_a_damaged_list_of_frames_is_named(empty: Pairs, name: str) -> None:
    (file,) = (p for p in (empty.folder / "pairs.zarr" / name / "c").rglob("*") if p.is_file())
    whole = file.read_bytes()
    for damaged in (whole[:-1], bytes([whole[0] ^ 1]) + whole[1:], b""):
        file.write_bytes(damaged)
        with pytest.raises(ValueError, match=rf"pairs.zarr/{name} is damaged"):
            open_pairs(empty.folder)


def test_pairs_of_another_version_are_refused_in_words(empty: Pairs) -> None:
    zarr.open_group(empty.folder / "pairs.zarr", mode="a").attrs["version"] = PAIRS_VERSION + 1
    message = f"stored in version {PAIRS_VERSION + 1}, this program reads version {PAIRS_VERSION}; .*=simulate"
    with pytest.raises(ValueError, match=message):
        open_pairs(empty.folder)
    with pytest.raises(FileNotFoundError, match="task=simulate"):
        open_pairs(empty.folder / "nowhere")


def state(pairs: Pairs) -> dict[str, tuple[bytes, int]]:
    """Content and modification time of every file but the locks."""
    files = [p for p in pairs.folder.rglob("*") if p.is_file() and p.suffix != ".lock"]
    return {str(p): (p.read_bytes(), p.stat().st_mtime_ns) for p in files}


def flip(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[len(content) // 3] ^= 0x10
    file.write_bytes(content)


def test_a_set_that_is_full_is_left_alone(pairs: Pairs) -> None:
    before, again = state(pairs), Recorder()
    assert list(fill_pairs(open_pairs(pairs.folder), WANTED, again)) == []
    assert again.rendered == []
    assert state(pairs) == before


def test_a_new_map_is_added_without_touching_the_others(pairs: Pairs) -> None:
    before, again = state(pairs), Recorder()
    list(fill_pairs(pairs, WANTED | {"low"}, again))
    after = state(pairs)
    assert {name for _, name in again.rendered} == {"low"}
    assert {path: after[path] for path in before} == before
    assert all("/low/" in path for path in after.keys() - before.keys())
    assert not pairs.missing(WANTED | {"low"})


def test_resimulation_is_for_unseen_frames_only(empty: Pairs) -> None:
    recorder = Recorder()
    list(fill_pairs(empty, WANTED, recorder))
    again = {frame for frame, name in recorder.rendered if name == "resimulation"}
    assert again >= set(np.flatnonzero(SPLIT != Part.train))
    assert 0 not in again


def test_a_shard_in_other_hands_is_skipped_and_made_later(empty: Pairs) -> None:
    with FileLock(empty.folder / ".shard1.lock"):
        list(fill_pairs(empty, WANTED, Recorder()))
    assert empty.missing(WANTED) == (1,)
    list(fill_pairs(empty, WANTED, Recorder()))
    assert empty.missing(WANTED) == ()


def test_images_that_are_black_are_made_once(empty: Pairs) -> None:
    list(fill_pairs(empty, WANTED, lambda frames, maps: {m: np.zeros((len(frames), *SHAPE)) for m in maps}))
    assert not empty.missing(WANTED)
    assert (empty.read("target", range(len(empty))) == 0).all()


def test_a_renderer_that_dies_leaves_the_shards_before_it(empty: Pairs) -> None:
    class Dies(Recorder):
        def __call__(self, frames: np.ndarray, maps: frozenset[str]) -> Mapping[str, np.ndarray]:
            if frames[0] >= 8:
                raise MemoryError
            return super().__call__(frames, maps)

    with pytest.raises(MemoryError):
        list(fill_pairs(empty, WANTED, Dies()))
    assert empty.missing(WANTED) == (2, 3, 4)


def truncate(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:-9])


@pytest.mark.parametrize("damage", [flip, truncate])
def test_only_what_is_damaged_is_made_again(pairs: Pairs, damage: Callable[[Path], None]) -> None:
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
    flip(pairs.shard_file("target", 0))
    with FileLock(pairs.folder / ".shard0.lock"):
        assert remove_damaged(pairs, WANTED) == ()
    assert len(remove_damaged(pairs, WANTED)) == 1


@pytest.mark.parametrize("frames", [SPLIT == Part.test, [-1], [len(SPLIT)], [0.0, 1.0]])
def test_frames_are_numbers_of_the_set(pairs: Pairs, frames: object) -> None:
    with pytest.raises(IndexError, match="allowed are their numbers, 0 to 17"):
        pairs.read("target", np.asarray(frames))
    assert pairs.read("target", []).shape == (0, *SHAPE)


def test_words_stand_for_a_space_and_unknown_ones_are_refused(pairs: Pairs) -> None:
    np.testing.assert_array_equal(pairs.mask("beam"), np.ones(pairs.beam_shape, bool))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="nowhere"):
        pairs.read("target", [0], "nowhere")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="test"):
        pairs.frames("test")  # type: ignore[arg-type]
