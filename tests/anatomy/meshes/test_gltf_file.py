"""glTF: what moves or makes vertices is read or refused by name; trimesh writes the plain file."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from ablate.anatomy.meshes.repair import load_mesh

Tree = dict[str, Any]


def plain(folder: Path) -> tuple[Path, Tree]:
    """A box of 60 mm, whose tree is still to be written."""
    box = trimesh.creation.box((60, 60, 60))
    for name, content in trimesh.exchange.gltf.export_gltf(trimesh.Scene([box])).items():
        (folder / name).write_bytes(content)
    path = folder / "model.gltf"
    return path, json.loads(path.read_text())


def primitive(tree: Tree) -> Tree:
    found: Tree = tree["meshes"][0]["primitives"][0]
    return found


def holder(tree: Tree) -> Tree:
    return next(node for node in tree["nodes"] if "mesh" in node)


REFUSED: dict[str, tuple[Callable[[Tree], object], str]] = {
    "skin": (lambda t: holder(t).update(skin=0), "a mesh in it has a skin"),
    "morph": (
        lambda t: (primitive(t).update(targets=[{"POSITION": 0}]), t["meshes"][0].update(weights=[0.5])),
        "morph targets with weights",
    ),
    "instancing": (lambda t: holder(t).update(extensions={"EXT_mesh_gpu_instancing": {}}), "EXT_mesh_gpu_instancing"),
    "required": (lambda t: t.update(extensionsRequired=["ACME_bent_space"]), "requires 'ACME_bent_space'"),
    "mode": (lambda t: primitive(t).update(mode=9), "mode 9"),
    "no position": (lambda t: primitive(t).update(attributes={}), "no 'POSITION'"),
    "negative index": (lambda t: holder(t).update(mesh=-1), "meshes -1 is not among its 1"),
    "version": (lambda t: t["asset"].update(version="1.0"), "allowed is 2.0"),
    "short buffer": (lambda t: t["buffers"][0].update(byteLength=10**9), "declares 1000000000 bytes"),
    "short view": (lambda t: [a.update(count=10**7) for a in t["accessors"]], "more than its view"),
    "no data": (lambda t: [a.pop("bufferView") for a in t["accessors"]], "holds no data"),
    "two parents": (lambda t: t["scenes"][0]["nodes"].append(t["scenes"][0]["nodes"][0]), "one parent"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_read_is_refused_by_name(tmp_path: Path, name: str) -> None:
    path, tree = plain(tmp_path)
    change, message = REFUSED[name]
    change(tree)
    path.write_text(json.dumps(tree))
    with pytest.raises(ValueError, match=rf"model\.gltf: .*{message}") as refused:
        load_mesh(path)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("dtype", ["<i1", "<i2", "<u1", "<u2"])
def test_normalised_integers_are_fractions_and_sparse_values_take_their_places(tmp_path: Path, dtype: str) -> None:
    path, tree = plain(tmp_path)
    index = primitive(tree)["attributes"]["POSITION"]
    box = trimesh.creation.box((60, 60, 60))
    unit = box.vertices / 30 if "i" in dtype else box.vertices / 60 + 0.5
    whole = np.round(unit * np.iinfo(dtype).max).astype(dtype)
    places = np.arange(3, dtype="<u2")
    blob = np.zeros_like(whole).tobytes() + places.tobytes() + whole[:3].tobytes()
    base = np.concatenate([np.zeros_like(whole[:3]), whole[3:]]).tobytes()
    (tmp_path / "more numbers.bin").write_bytes(base + blob[len(base) :])
    first, buffer = len(tree["bufferViews"]), len(tree["buffers"])
    tree["buffers"].append({"uri": "more%20numbers.bin", "byteLength": len(blob)})
    for begin, length in ((0, len(base)), (len(base), 6), (len(base) + 6, whole[:3].nbytes)):
        tree["bufferViews"].append({"buffer": buffer, "byteOffset": begin, "byteLength": length})
    code = {"<i1": 5120, "<u1": 5121, "<i2": 5122, "<u2": 5123}[dtype]
    sparse = {
        "count": 3,
        "indices": {"bufferView": first + 1, "componentType": 5123},
        "values": {"bufferView": first + 2},
    }
    entry = {"componentType": code, "count": 8, "type": "VEC3", "normalized": True, "bufferView": first}
    tree["accessors"][index] = {**entry, "sparse": sparse}
    holder(tree)["scale"] = [30, 30, 30]
    holder(tree).pop("matrix", None)
    path.write_text(json.dumps(tree))
    side = 60 if "i" in dtype else 30
    np.testing.assert_allclose(load_mesh(path).extents, 3 * [side], rtol=0.01)
