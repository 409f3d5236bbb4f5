"""Pairs on disk: what is written is read back, here and by zarr, and what is not there or damaged is named."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
import zarr

from ablate.dataset import PAIRS_VERSION, DamagedShardError, Pairs, Part, create_pairs, fill_pairs, open_pairs

SHAPE = (24, 40)
SPLIT = np.array([Part.train] * 11 + [Part.validation] * 3 + [Part.test] * 4, np.uint8)
WANTED = frozenset({"segmentation", "attenuation", "target", "resimulation"})


def render(frames: np.ndarray, maps: frozenset[str]) -> Mapping[str, np.ndarray]:
    """Images that tell which frame and map they are."""
    return {
        m: np.stack([np.full(SHAPE, f / 20 if m == "attenuation" else f * 10 + len(m)) for f in frames]) for m in maps
    }


@pytest.fixture
def empty(tmp_path: Path) -> Pairs:
    n = len(SPLIT)
    poses = np.tile(np.eye(4), (n, 1, 1))
    return create_pairs(tmp_path / "set", poses, np.arange(n), SPLIT, np.ones(SHAPE, bool), 4, ["gel"], {"a": 1})


@pytest.fixture
def pairs(empty: Pairs) -> Pairs:
    assert sum(fill_pairs(empty, WANTED, render)) == len(SPLIT)
    assert not empty.missing(WANTED)
    return empty


def test_what_is_written_is_read_back(pairs: Pairs) -> None:
    frames = [0, 5, 17]
    target = pairs.read("target", frames)
    assert target.dtype == np.uint8
    assert (target == np.array([6, 56, 176])[:, None, None]).all()
    np.testing.assert_allclose(pairs.read("attenuation", frames)[:, 0, 0], [0, 0.25, 0.85], rtol=2**-9)


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
    again = open_pairs(pairs.folder)
    assert (again.shape, again.shard, again.tissues, len(again)) == (SHAPE, 4, ("gel",), len(SPLIT))
    for ours, theirs in ((again.poses, pairs.poses), (again.sites, pairs.sites), (again.split, SPLIT)):
        np.testing.assert_array_equal(ours, theirs)
    assert again.mask().all()


def test_a_damaged_shard_is_named_on_reading_with_what_mends_it(pairs: Pairs) -> None:
    file = pairs.shard_file("target", 2)
    content = bytearray(file.read_bytes())
    content[5] ^= 0x10
    file.write_bytes(content)
    with pytest.raises(
        DamagedShardError, match=r"target/c/2/0/0, 'target' of frames 8 to 11.*checksum; .*task=simulate"
    ):
        pairs.read("target", [8])
    pairs.read("target", [7, 12])


def test_a_frame_that_is_not_made_is_an_error_and_not_an_empty_image(empty: Pairs) -> None:
    list(fill_pairs(empty, frozenset({"target"}), render))
    empty.shard_file("target", 1).unlink()
    with pytest.raises(FileNotFoundError, match=r"target/c/1/0/0: not made yet.*task=simulate"):
        empty.read("target", [4])


@pytest.mark.parametrize("name", ["pose", "site", "split", "mask"])
def test_a_damaged_list_of_frames_is_named(empty: Pairs, name: str) -> None:
    (file,) = (p for p in (empty.folder / "pairs.zarr" / name / "c").rglob("*") if p.is_file())
    whole = file.read_bytes()
    for damaged in (whole[:-1], bytes([whole[0] ^ 1]) + whole[1:], b""):
        file.write_bytes(damaged)
        with pytest.raises(ValueError, match=rf"pairs.zarr/{name} is damaged"):
            open_pairs(empty.folder)


def test_a_missing_set_says_how_to_make_it(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="task=simulate"):
        open_pairs(tmp_path)


def test_pairs_of_another_version_are_refused_in_words(empty: Pairs) -> None:
    zarr.open_group(empty.folder / "pairs.zarr", mode="a").attrs["version"] = PAIRS_VERSION + 1
    message = f"stored in version {PAIRS_VERSION + 1}, this program reads version {PAIRS_VERSION}; .*=simulate"
    with pytest.raises(ValueError, match=message):
        open_pairs(empty.folder)
