"""A data folder from a stranger runs no code: what is not stored as this program stores it is refused unread."""

import json
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path

import numcodecs.pickles
import numpy as np
import pytest
import zarr
from zarr.codecs import GzipCodec

from ablate.dataset import Pairs, fill_pairs, open_pairs

Blank = Callable[..., Pairs]
MAPS = frozenset({"segmentation", "target"})


class Payload:
    """What unpickles to a new file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, ...]:
        return Path.touch, (self.path,)


@pytest.fixture
def pairs(tmp_path: Path, blank: Blank, monkeypatch: pytest.MonkeyPatch) -> Pairs:
    """A whole data set, read with filters that unpickle, as numcodecs has them before 0.16.6."""
    monkeypatch.setattr(numcodecs.pickles, "ALLOW_UNSAFE_PICKLE_DECODE", True, raising=False)
    made = blank(tmp_path / "set", 8, 4)
    shape = made.stored_shape
    list(fill_pairs(made, MAPS, lambda frames, maps: {name: np.ones((len(frames), *shape)) for name in maps}))
    return made


def write_v2_array(folder: Path, shape: tuple[int, ...], payload: Payload) -> None:
    """Put an array of Zarr version 2, all of it in one chunk, in the place of another."""
    shutil.rmtree(folder)
    folder.mkdir()
    about = {"zarr_format": 2, "shape": shape, "chunks": shape, "dtype": "|O", "compressor": None, "order": "C"}
    filters = [{"id": "vlen-utf8"}, {"id": "pickle", "protocol": 5}]  # of text, which gets past Zarr's own checks
    (folder / ".zarray").write_text(json.dumps({**about, "fill_value": "", "filters": filters}))
    (folder / ".zattrs").write_text("{}")
    (folder / ".".join("0" for _ in shape)).write_bytes(pickle.dumps(payload))


def refused(read: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        read()
    assert "\n" not in str(caught.value)


def test_an_array_of_version_2_is_refused_before_its_filter_unpickles(tmp_path: Path, pairs: Pairs) -> None:
    ran = tmp_path / "ran"
    mask = pairs.folder / "pairs.zarr" / "mask"
    write_v2_array(mask, pairs.shape, Payload(ran))
    refused(lambda: open_pairs(pairs.folder), r"pairs\.zarr/mask: is no array of Zarr version 3")
    assert not ran.exists()
    with pytest.raises(TypeError):  # what is unpickled is no array
        zarr.open_array(mask, mode="r")[...]
    assert ran.exists(), "the filter is one that runs"


def test_a_map_of_version_2_is_refused(tmp_path: Path, pairs: Pairs) -> None:
    ran = tmp_path / "ran"
    target = pairs.folder / "pairs.zarr" / "target"
    write_v2_array(target, (len(pairs), *pairs.stored_shape), Payload(ran))
    shard = pairs.shard_file("target", 0)
    shard.parent.mkdir(parents=True)
    shard.write_bytes(pickle.dumps(Payload(ran)))
    refused(lambda: pairs.read("target", [0]), r"pairs\.zarr/target: is no array of Zarr version 3")
    assert not ran.exists()


def test_a_store_of_version_2_is_refused(pairs: Pairs) -> None:
    store = pairs.folder / "pairs.zarr"
    (store / "zarr.json").unlink()
    (store / ".zgroup").write_text(json.dumps({"zarr_format": 2}))
    (store / ".zattrs").write_text(json.dumps({"version": 6}))
    refused(lambda: open_pairs(pairs.folder), r"pairs\.zarr: is no group of Zarr version 3")


@pytest.mark.parametrize("shards", [None, (8, 9, 9)], ids=["of chunks", "within shards"])
def test_a_codec_that_is_not_written_here_is_refused(pairs: Pairs, shards: tuple[int, ...] | None) -> None:
    group = zarr.open_group(pairs.folder / "pairs.zarr", mode="a")
    data = np.ones((8, 9, 9), np.uint8)
    group.create_array("target", data=data, chunks=(1, 9, 9), shards=shards, compressors=[GzipCodec()], overwrite=True)
    shard = pairs.shard_file("target", 0)
    assert shard.exists()
    refused(lambda: pairs.read("target", [0]), r"pairs\.zarr/target: is stored with GzipCodec; allowed are BytesCodec,")
