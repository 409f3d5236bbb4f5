"""Shards against zarr, which wrote the format down, and against every way of damaging them."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest
import zarr
from hypothesis import given
from hypothesis import strategies as st

from ablate.dataset.pairs import FORMATS, decode_attenuation, encode_attenuation
from ablate.dataset.shards import check_shard, create_array, read_frame, write_shard

SHAPE, SLOTS = (21, 13), 4


def frames(name: str, count: int) -> np.ndarray:
    top = np.iinfo(FORMATS[name].dtype).max
    stack = np.random.default_rng(count).integers(0, top, (count, *SHAPE), FORMATS[name].dtype, endpoint=True)
    stack[0] = 0  # Zarr's fill value: zarr itself would leave such a frame out
    return stack


@pytest.mark.parametrize("name", ["segmentation", "attenuation", "high"])
@pytest.mark.parametrize("count", [1, 3, 4])
def test_zarr_reads_what_is_written(tmp_path: Path, name: str, count: int) -> None:
    stack = frames(name, count)
    group = zarr.open_group(tmp_path / "set.zarr", mode="w", zarr_format=3)
    create_array(group, name, (count, *SHAPE), SLOTS, FORMATS[name])
    file = tmp_path / "set.zarr" / name / "c" / "0" / "0" / "0"
    write_shard(file, stack, SLOTS, FORMATS[name])
    np.testing.assert_array_equal(group[name][...], stack)
    for k in range(count):
        np.testing.assert_array_equal(read_frame(file, k, SLOTS, FORMATS[name], SHAPE), stack[k])


@pytest.mark.parametrize("name", ["segmentation", "attenuation", "high"])
def test_what_zarr_writes_is_read(tmp_path: Path, name: str) -> None:
    stack = np.maximum(frames(name, 3), 1)
    group = zarr.open_group(tmp_path / "set.zarr", mode="w", zarr_format=3)
    create_array(group, name, (3, *SHAPE), SLOTS, FORMATS[name])
    group[name][...] = stack
    file = tmp_path / "set.zarr" / name / "c" / "0" / "0" / "0"
    check_shard(file, 3, SLOTS)
    for k in range(3):
        np.testing.assert_array_equal(read_frame(file, k, SLOTS, FORMATS[name], SHAPE), stack[k])


@pytest.fixture
def shard(tmp_path: Path) -> Path:
    write_shard(tmp_path / "0", frames("high", 3), SLOTS, FORMATS["high"])
    return tmp_path / "0"


def test_any_flipped_bit_is_noticed(shard: Path) -> None:
    whole = shard.read_bytes()
    check_shard(shard, 3, SLOTS)
    for at in range(len(whole)):
        shard.write_bytes(whole[:at] + bytes([whole[at] ^ 1 << at % 8]) + whole[at + 1 :])
        with pytest.raises(ValueError, match="checksum"):
            check_shard(shard, 3, SLOTS)


def test_any_truncation_is_noticed(shard: Path) -> None:
    whole = shard.read_bytes()
    for length in range(len(whole)):
        shard.write_bytes(whole[:length])
        with pytest.raises(ValueError, match=r"checksum|shorter"):
            check_shard(shard, 3, SLOTS)


def test_a_damaged_frame_costs_only_itself(shard: Path) -> None:
    content = bytearray(shard.read_bytes())
    content[7] ^= 4
    shard.write_bytes(content)
    with pytest.raises(ValueError, match="frame 0 of the shard"):
        read_frame(shard, 0, SLOTS, FORMATS["high"], SHAPE)
    np.testing.assert_array_equal(read_frame(shard, 1, SLOTS, FORMATS["high"], SHAPE), frames("high", 3)[1])


def test_a_shard_with_fewer_frames_than_expected_is_noticed(shard: Path) -> None:
    with pytest.raises(ValueError, match="frame 3 of the shard is absent"):
        check_shard(shard, 4, SLOTS)


def test_a_full_disk_leaves_what_was_there(shard: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = shard.read_bytes()

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        write_shard(shard, frames("high", 4), SLOTS, FORMATS["high"])
    assert [p.name for p in shard.parent.iterdir()] == ["0"]
    assert shard.read_bytes() == before


def test_what_a_killed_process_left_is_removed(shard: Path) -> None:
    (shard.parent / "0.deadbeef.partial").write_bytes(b"half a shard")
    write_shard(shard, frames("high", 3), SLOTS, FORMATS["high"])
    assert [p.name for p in shard.parent.iterdir()] == ["0"]


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
