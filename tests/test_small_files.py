"""Small files that grow: what a stranger sends is bounded by its headers before it is read, whatever kind it is."""

import gzip
import io
import json
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import nibabel
import nrrd
import numcodecs
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
import zarr
from zarr.codecs import BloscCodec, ZstdCodec

import ablate
from ablate.anatomy.meshes.mesh_file import read_mesh
from ablate.anatomy.scene import _read as read_scene
from ablate.anatomy.scene_values import read_yaml
from ablate.anatomy.volumes.volume_file import check_volume, slabs
from ablate.dataset.own_poses import read_poses
from ablate.dataset.pairs_folder import PlacedFrames, StoredAs, create_pairs, open_pairs
from ablate.publish.training_view import _publish_images
from ablate.storage import MOST_UNPACKED, check_archive
from ablate.study.log import LoggedImage
from ablate.study.parquet_pages import check_pages
from ablate.study.scores import is_whole, read_score
from ablate.study.training import Training
from ablate.ultrasound import ConvexProbe
from support.memory import taking_at_most

MB = 2**20
SHIPPED = Path(ablate.__file__).parent / "pretrained" / "sa2h.pt"


def rezipped(source: Path, path: Path, method: int, **more: bytes) -> None:
    """The parts of an archive, and more of them, compressed by a method."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(path, "w", method, compresslevel=1) as new:
        for part in old.infolist():
            new.writestr(part.filename, old.read(part))
        for name, content in more.items():
            new.writestr(f"{old.infolist()[0].filename.partition('/')[0]}/data/{name}", content)


def weights_compressed(folder: Path) -> Callable[[], object]:
    rezipped(SHIPPED, folder / "a.pt", zipfile.ZIP_DEFLATED, more=bytes(64 * MB))
    return lambda: ablate.load(folder / "a.pt")


def weights_of_the_first_versions(folder: Path) -> Callable[[], object]:
    """torch took their sizes from the pickle, before it read them."""
    torch.save(torch.load(SHIPPED, weights_only=True), folder / "a.pt", _use_new_zipfile_serialization=False)
    return lambda: ablate.load(folder / "a.pt")


def pictures(folder: Path) -> Callable[[], object]:
    with zipfile.ZipFile(folder / "pictures.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, shape in (("frames", (1,)), ("images", (1, 1, MOST_UNPACKED + 1))):
            header = io.BytesIO()
            np.lib.format.write_array_header_1_0(header, {"descr": "|u1", "fortran_order": False, "shape": shape})
            with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
                stream.write(header.getvalue())
                for start in range(0, shape[-1], MB):
                    stream.write(bytes(min(MB, shape[-1] - start)))
    return lambda: check_archive(folder / "pictures.npz", MOST_UNPACKED)


def scene_that_is_kept(folder: Path) -> Callable[[], object]:
    np.savez_compressed(folder / "scene.npz", vertices=np.zeros((2 * MB, 3)))
    return lambda: read_scene(folder / "scene.npz")


def archive_of_another_method(folder: Path) -> Callable[[], object]:
    with zipfile.ZipFile(folder / "a.npz", "w", zipfile.ZIP_BZIP2) as archive:
        archive.writestr("images.npy", b"")
    return lambda: check_archive(folder / "a.npz")


def scores_of_many_rows(folder: Path) -> Callable[[], object]:
    values = pa.table({"metric": pa.array(["psnr"] * MB).dictionary_encode(), "value": np.zeros(MB)})
    with pq.ParquetWriter(folder / "psnr@a.parquet", values.schema, store_schema=False) as writer:
        for _ in range(20):
            writer.write_table(values)
    return lambda: read_score(folder / "psnr@a.parquet")


def scores_of_lists(folder: Path) -> Callable[[], object]:
    pq.write_table(pa.table({"value": [[1.0] * 10]}), folder / "psnr@a.parquet")
    return lambda: read_score(folder / "psnr@a.parquet")


def signed(number: int) -> bytes:
    """A number as Thrift's compact protocol has it: its sign is the last bit, and a byte has seven."""
    value, parts = number << 1, bytearray()
    while value > 127:
        parts.append(value & 127 | 128)
        value >>= 7
    return bytes([*parts, value])


def scores_whose_footer_lies(folder: Path) -> Callable[[], object]:
    """One text of 100 MB, as its page says, and in the footer sizes as small as the file is."""
    path = folder / "psnr@a.parquet"
    table, plainly = pa.table({"metric": ["x" * 100 * MB]}), {"use_dictionary": False, "write_statistics": False}
    with pq.ParquetWriter(path, table.schema, compression="zstd", store_schema=False, **plainly) as writer:
        writer.write_table(table)
        writer.add_key_value_metadata({b"ablate": b'{"scalars": {}, "notes": [], "scored": ""}'})
    size = pq.read_metadata(path).row_group(0).column(0).total_uncompressed_size
    content = path.read_bytes()
    start = len(content) - 8 - int.from_bytes(content[-8:-4], "little")
    footer = content[start:-8].replace(signed(size), signed(1000))
    path.write_bytes(content[:start] + footer + struct.pack("<I", len(footer)) + b"PAR1")
    assert pq.read_metadata(path).row_group(0).total_byte_size == 1000
    return lambda: read_score(path)


def poses(folder: Path) -> Callable[[], object]:
    header = {"descr": "<f8", "fortran_order": False, "shape": (10**12, 4, 4)}
    with (folder / "poses.npy").open("wb") as stream:
        np.lib.format.write_array_header_1_0(stream, header)
    return lambda: read_poses(folder / "poses.npy")


def picture_of_a_training(folder: Path) -> Callable[[], object]:
    """More pixels than Pillow itself refuses would be an error of its own."""
    chunks = ((b"IHDR", struct.pack(">IIBBBBB", 9000, 9000, 8, 6, 0, 0, 0)), (b"IDAT", zlib.compress(b"")))
    parts = [
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    ]
    (folder / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(parts))
    client = Mock(list_artifacts=lambda *_: [])
    return lambda: _publish_images(client, "run", [LoggedImage("a", 0, folder / "a.png")])


def text_beside_a_volume(folder: Path) -> Callable[[], object]:
    image = nibabel.Nifti1Image(np.zeros((4, 4, 4), np.uint8), np.eye(4))
    image.header["vox_offset"] = 300 * MB
    start = image.header.binaryblock + b"\x01\0\0\0" + struct.pack("<ii", 300 * MB - 352, 4)
    with gzip.open(folder / "a.nii.gz", "wb", compresslevel=1) as stream:
        stream.write(start)
        for _ in range(301):
            stream.write(bytes(MB))
    return lambda: check_volume(folder / "a.nii.gz", "labels.file")


def values_behind_a_volume(folder: Path) -> Callable[[], object]:
    geometry = {"space": "RAS", "space directions": np.eye(3), "space origin": [0, 0, 0], "encoding": "gzip"}
    nrrd.write(str(folder / "a.nrrd"), np.zeros((2**9, 2**9, 2**9), np.uint8), geometry, compression_level=1)
    content = (folder / "a.nrrd").read_bytes()
    (folder / "a.nrrd").write_bytes(content.replace(b"sizes: 512 512 512", b"sizes: 4 4 4"))
    return lambda: list(slabs(check_volume(folder / "a.nrrd", "labels.file")))


def pairs_at(folder: Path) -> zarr.Group:
    frames = PlacedFrames(np.eye(4)[None], np.zeros(1, int), np.zeros(1, np.uint8), np.ones((8, 8), bool))
    create_pairs(folder, frames, StoredAs(1, ["liver"], "beam", ConvexProbe(), (6, 4)), {})
    return zarr.open_group(folder / "pairs.zarr", mode="a")


def mesh_of_one_array_many_times(folder: Path) -> Callable[[], object]:
    """10^5 vertices, in each of 700 primitives that have one corner."""
    (folder / "a.bin").write_bytes(bytes(12 * 10**5))
    primitive = {"attributes": {"POSITION": 0}, "indices": 1, "mode": 5}
    tree = {
        "asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive] * 700}],
        "buffers": [{"uri": "a.bin", "byteLength": 12 * 10**5}],
        "bufferViews": [{"buffer": 0, "byteLength": 12 * 10**5}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 10**5, "type": "VEC3"},
            {"bufferView": 0, "componentType": 5121, "count": 1, "type": "SCALAR"},
        ],
    }  # fmt: skip
    (folder / "a.gltf").write_text(json.dumps(tree))
    return lambda: read_mesh(folder / "a.gltf")


def mesh_with_a_long_word(folder: Path) -> Callable[[], object]:
    """NumPy gives all words the length of the longest one."""
    head = "ply\nformat ascii 1.0\nelement vertex 1\nproperty int x\nproperty int y\nproperty int z\nend_header\n"
    (folder / "a.ply").write_text(head + "0 " * 20_000 + "0" * 20_000)
    return lambda: read_mesh(folder / "a.ply")


def mask_of_pairs(folder: Path) -> Callable[[], object]:
    group = pairs_at(folder)
    group.create_array("mask", shape=(17_000, 17_000), chunks=(100, 100), dtype=bool, overwrite=True)
    return lambda: open_pairs(folder)


def beam_of_pairs(folder: Path) -> Callable[[], object]:
    pairs_at(folder).attrs["beam_shape"] = [10**6, 10**6]
    return lambda: open_pairs(folder)


def frames_of_pairs(folder: Path) -> Callable[[], object]:
    """A shard whose one frame is not of the shape that the data set declares."""
    array = pairs_at(folder).create_array(
        "target", shape=(1, 10_000, 10_000), chunks=(1, 10_000, 10_000), shards=(1, 10_000, 10_000), dtype="uint8"
    )
    array[...] = 1
    return lambda: open_pairs(folder).stored("target", 0, "beam")


def chunk_of_pairs(folder: Path) -> Callable[[], object]:
    """Few values, of which each chunk is unpacked whole."""
    group = pairs_at(folder)
    group.create_array("site", shape=(1,), chunks=(300 * MB,), dtype="uint8", overwrite=True)
    return lambda: open_pairs(folder)


def unpacked_frame_of_pairs(folder: Path) -> Callable[[], object]:
    """Where a chunk unpacks to more than its array has in it."""
    pairs_at(folder).create_array(
        "target", shape=(1, 6, 4), chunks=(1, 6, 4), dtype="uint8", compressors=[BloscCodec()]
    )
    file = folder / "pairs.zarr" / "target" / "c" / "0" / "0" / "0"
    file.parent.mkdir(parents=True)
    file.write_bytes(numcodecs.Blosc("zstd", 1).encode(np.zeros(200 * MB, np.uint8)))
    return lambda: open_pairs(folder).stored("target", 0, "beam")


def unpacked_sites_of_pairs(folder: Path) -> Callable[[], object]:
    group = pairs_at(folder)
    group.create_array("site", data=np.ones(1, np.int32), overwrite=True, compressors=[ZstdCodec()])
    (folder / "pairs.zarr" / "site" / "c" / "0").write_bytes(numcodecs.Zstd(1).encode(np.zeros(200 * MB, np.uint8)))
    return lambda: open_pairs(folder)


def scene_of_merges(folder: Path) -> Callable[[], object]:
    """Ten levels, of which each merges the one before ten times."""
    lines = ["a0: &a0 {x: 1}", *(f"a{k}: &a{k} {{<<: [{', '.join([f'*a{k - 1}'] * 10)}]}}" for k in range(1, 8))]
    (folder / "scene.yaml").write_text("\n".join(lines))
    return lambda: read_yaml(folder / "scene.yaml")


FILES = {
    weights_compressed: r"a\.pt: .*unpacks to 67,\d+,\d+ bytes; allowed are \d{6}|a\.pt: .*unpacks to",
    weights_of_the_first_versions: r"a\.pt: .*not a whole archive",
    pictures: r"pictures\.npz: unpacks to 268,435,\d+ bytes; allowed are 268,435,456",
    scene_that_is_kept: r"scene\.npz: unpacks to",
    archive_of_another_method: r"a\.npz: images\.npy is compressed by method 12; allowed is deflate",
    scores_of_many_rows: r"psnr@a\.parquet cannot be read: .*unpacks to 335,544,320 bytes",
    scores_of_lists: r"psnr@a\.parquet cannot be read: value is list<.*>; allowed are numbers and text",
    scores_whose_footer_lies: r"metric: its pages unpack to 104,857,6\d\d bytes; its footer says 1,000",
    poses: r"poses\.npy: not readable as \.npy",
    picture_of_a_training: r"a\.png: unpacks to 324,000,000 bytes",
    text_beside_a_volume: r"a\.nii\.gz: not readable: .*unpacks to 314,572,800 bytes",
    values_behind_a_volume: r"a\.nrrd: not readable to its end: .*unpacks to [\d,]+ bytes; allowed are 512",
    scene_of_merges: r"scene\.yaml: not readable as YAML: more than 1000 keys are merged by <<",
    mesh_of_one_array_many_times: r"a\.gltf: .*its nodes make 70000700 vertices and corners .*; allowed are 67108864",
    mesh_with_a_long_word: r"a\.ply: .*bytes follow the rows",
    mask_of_pairs: r"mask: unpacks to 289,000,000 bytes",
    beam_of_pairs: r"pairs\.zarr: unpacks to 1,000,000,000,000 bytes",
    frames_of_pairs: r"target: is uint8 of \(1, 10000, 10000\) .*; its data set has uint8 of \(1, 6, 4\)",
    unpacked_frame_of_pairs: r"target/c/0/0/0, 'target' of frames 0 to 0, is damaged",
    unpacked_sites_of_pairs: r"site is damaged \(a chunk declares 209,715,200 bytes; its array has 4 in each\)",
    chunk_of_pairs: r"site: unpacks to 314,572,800 bytes",
}


@pytest.mark.parametrize("made", FILES, ids=lambda made: made.__name__)
def test_a_small_file_takes_little_memory(tmp_path: Path, made: Callable[[Path], Callable[[], object]]) -> None:
    read = made(tmp_path)
    assert sum(path.stat().st_size for path in tmp_path.rglob("*") if path.is_file()) < 4 * MB
    with taking_at_most(40), pytest.raises(ValueError, match=FILES[made]):
        read()


def test_a_damaged_picture_file_of_a_training_is_as_none(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    pictures(tmp_path)
    with taking_at_most(40):
        assert Training(tmp_path).pictures == {}
    assert "pictures.npz is damaged: " in caplog.text


def test_a_long_text_that_many_scores_share_is_held_once(tmp_path: Path) -> None:
    path = tmp_path / "psnr@a.parquet"
    text = pa.DictionaryArray.from_arrays(np.zeros(4000, np.int8), ["x" * 2**16])
    about = b'{"scalars": {}, "notes": [], "scored": ""}'
    with pq.ParquetWriter(path, pa.schema({"metric": pa.string()}), store_schema=False) as writer:
        for _ in range(10):
            writer.write_table(pa.table({"metric": text.slice(0, 400).cast(pa.string())}))
        writer.add_key_value_metadata({b"ablate": about})
    with taking_at_most(60), pytest.raises(ValueError, match=r"holds values of 'x+") as raised:
        read_score(path)
    assert is_whole(path)
    assert len(str(raised.value)) < 1000


def test_the_pages_of_a_whole_file_are_followed_however_it_is_written(tmp_path: Path) -> None:
    """Dictionaries, statistics, checksums, several pages and groups, both versions of pages, absent values."""
    table = pa.table(
        {
            "metric": ["psnr", "mae", None, "x" * 300] * 5000,
            "value": np.random.default_rng(0).random(20_000),
            "frame": np.arange(20_000) % 9,
        }
    )
    ways: list[dict[str, Any]] = [
        {"use_dictionary": True, "write_page_checksum": True, "data_page_size": 1000},
        {"use_dictionary": False, "data_page_version": "2.0", "row_group_size": 777, "compression": "gzip"},
        {"use_dictionary": ["metric"], "compression": "none", "data_page_version": "2.0", "write_page_index": True},
    ]
    for number, how in enumerate(ways):
        path = tmp_path / f"{number}.parquet"
        pq.write_table(table, path, **how)
        check_pages(path, pq.read_metadata(path))
    pq.write_table(table.slice(0, 0), path)
    check_pages(path, pq.read_metadata(path))
