"""Shards are read by zarr as they were written, and every way of damaging them is noticed."""

from pathlib import Path

import numpy as np
import pytest
import zarr
from hypothesis import given
from hypothesis import strategies as st

from ablate.dataset import DamagedShardError, Pairs, Part, PlacedFrames, StoredAs, create_pairs, fill_pairs
from ablate.dataset.encoding import decode_attenuation, encode_attenuation
from ablate.dataset.filling import frame_array, write_shard
from ablate.dataset.pairs import FORMATS

SHAPE, SLOTS = (9, 7), 4


def frames(name: str, count: int) -> np.ndarray:
    dtype, _ = FORMATS[name]
    stack = np.random.default_rng(count).integers(0, np.iinfo(dtype).max, (count, *SHAPE), dtype, endpoint=True)
    stack[0] = 0  # Zarr's fill value: zarr itself would leave such a frame out
    return stack


@pytest.mark.parametrize("name", ["segmentation", "attenuation", "target"])
@pytest.mark.parametrize("count", [1, 3, 4])
def test_zarr_reads_what_is_written(tmp_path: Path, name: str, count: int) -> None:
    stack = frames(name, count)
    group = zarr.open_group(tmp_path / "set.zarr", mode="w", zarr_format=3)
    group.create_array(name, **frame_array(name, count, SHAPE, SLOTS))
    write_shard(tmp_path / "set.zarr" / name / "c" / "0" / "0" / "0", name, stack, SLOTS)
    np.testing.assert_array_equal(group[name][...], stack)


@pytest.fixture
def pairs(tmp_path: Path) -> Pairs:
    """Three frames of the target in a shard that has room for four."""
    stack, split = frames("target", 3), np.full(3, Part.train, np.uint8)
    placed = PlacedFrames(np.zeros((3, 4, 4)), np.arange(3), split, np.ones(SHAPE, bool))
    made = create_pairs(tmp_path / "set", placed, StoredAs(SLOTS, ["gel"]), {})
    list(fill_pairs(made, frozenset({"target"}), lambda chosen, _: {"target": stack[chosen]}))
    return made


@pytest.fixture
def shard(pairs: Pairs) -> Path:
    return pairs.shard_file("target", 0)


def test_any_flipped_bit_and_any_truncation_is_noticed(pairs: Pairs, shard: Path) -> None:
    whole, numbers = shard.read_bytes(), pairs.frames_of_shard(0)
    pairs.stored("target", numbers)
    flipped = (whole[:i] + bytes([whole[i] ^ 1 << i % 8]) + whole[i + 1 :] for i in range(len(whole)))
    for damaged in (*flipped, *(whole[:length] for length in range(len(whole)))):
        shard.write_bytes(damaged)
        with pytest.raises(DamagedShardError, match="checksum"):
            pairs.stored("target", numbers)


def test_a_damaged_frame_costs_only_itself(pairs: Pairs, shard: Path) -> None:
    content = bytearray(shard.read_bytes())
    content[7] ^= 4
    shard.write_bytes(content)
    damaged = []
    for k, frame in enumerate(frames("target", 3)):
        try:
            np.testing.assert_array_equal(pairs.stored("target", k), frame)
        except DamagedShardError:
            damaged.append(k)
    assert len(damaged) == 1


@given(st.lists(st.floats(0, 1, width=32), min_size=1))
def test_attenuation_is_kept_to_a_fifth_of_a_percent(values: list[float]) -> None:
    wanted = np.array(values, np.float32)
    got = decode_attenuation(encode_attenuation(wanted))
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, wanted, rtol=2**-9, atol=0.5001 / 65535)


def test_attenuation_keeps_its_order_its_ends_and_its_coded_values() -> None:
    stored = encode_attenuation(np.linspace(-0.1, 1.1, 400_001))
    assert (np.diff(stored.astype(int)) >= 0).all()
    assert (stored[0], stored[-1]) == (0, 65535)
    np.testing.assert_array_equal(encode_attenuation(decode_attenuation(stored)), stored)
