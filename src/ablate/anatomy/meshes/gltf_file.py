"""glTF 2.0: the triangles of the meshes in its scene, each where its nodes put it."""

import logging
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ablate.anatomy.meshes.gltf_accessors import Buffers, corners, positions
from ablate.anatomy.meshes.gltf_document import COMPRESSIONS, Document, buffer_bytes, check_extensions, gltf_document
from ablate.anatomy.meshes.polygons import triangles_of_strip
from ablate.setting import shown

logger = logging.getLogger(__name__)

_POINTS_AND_LINES, _TRIANGLES, _STRIP, _FAN = range(4), 4, 5, 6  # modes of primitives
_MOST = 2**26  # vertices and corners, also of a small file: nodes may hold a mesh, and primitives an array, many times
Surface = tuple[np.ndarray, np.ndarray]


def read_gltf(path: Path) -> Surface:
    """Vertices (n, 3) float64 and triangles (m, 3) int64 of the scene that the file names, in its unit.

    Read are lists, strips and fans of triangles, with whole and normalised integers and sparse accessors; and nodes
    where they stand before any animation. A warning says what is left out: points, lines, and what no node of the
    scene holds. Raises ValueError for what moves vertices and is not read (skins, morph targets with weights,
    extensions), and for what is not there.
    """
    document = gltf_document(path)
    try:
        return _scene(document)
    except KeyError as error:
        raise ValueError(f"an entry of it has no {error}") from error


def _scene(document: Document) -> Surface:
    @cache
    def buffer(index: int) -> bytes:
        return buffer_bytes(document, index)

    placed = [(node, matrix) for node, matrix in _placed(document) if "mesh" in node]
    solid = [(p, matrix) for node, matrix in placed for p in _solid(document, node)]
    if (declared := sum(_declared(document, primitive) for primitive, _ in solid)) > _MOST:
        raise ValueError(f"its nodes make {declared} vertices and corners of its meshes; allowed are {_MOST}")
    vertices, triangles, count = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)], 0
    for primitive, matrix in solid:
        points, faces = _surface(document, primitive, buffer)
        triangles.append(faces + count)
        vertices.append(points @ matrix[:3, :3].T + matrix[:3, 3])
        count += len(points)
    used = {node["mesh"] for node, _ in placed}
    meshes = document.tree.get("meshes", [])
    flat = sum(p.get("mode", 4) in _POINTS_AND_LINES for index in used for p in meshes[index]["primitives"])
    if flat or len(used) < len(meshes):
        what = f"{len(meshes) - len(used)} meshes that are not in its scene, {flat} pieces of points or lines"
        logger.warning("%s: left out: %s", document.path.name, what)
    return np.concatenate(vertices), np.concatenate(triangles)


def _solid(document: Document, node: dict[str, Any]) -> list[dict[str, Any]]:
    """The primitives of a node's mesh that are no points or lines."""
    mesh = document.entry("meshes", node["mesh"])
    _check_still(node, mesh)
    return [primitive for primitive in mesh["primitives"] if primitive.get("mode", 4) not in _POINTS_AND_LINES]


def _declared(document: Document, primitive: dict[str, Any]) -> int:
    """How many vertices and corners a primitive declares."""
    accessors = [primitive["attributes"]["POSITION"], *([primitive["indices"]] if "indices" in primitive else [])]
    return sum(max(document.entry("accessors", index)["count"], 0) for index in accessors)


def _placed(document: Document) -> Iterator[tuple[dict[str, Any], np.ndarray]]:
    """Each node of the scene, and the matrix (4, 4) from its coordinates to those of the scene."""
    scenes = document.tree.get("scenes", [])
    if "scene" not in document.tree and len(scenes) > 1:
        raise ValueError(f"it has {len(scenes)} scenes and names none of them in `scene`")
    roots = document.entry("scenes", document.tree.get("scene", 0)).get("nodes", [])
    to_visit, visited = [(index, np.eye(4)) for index in reversed(roots)], set()
    while to_visit:
        index, parent = to_visit.pop()
        node = document.entry("nodes", index)
        if index in visited:
            raise ValueError(f"nodes {index} is in its scene twice; a node has one parent")
        visited.add(index)
        matrix = parent @ _matrix(node, index)
        yield node, matrix
        to_visit += [(child, matrix) for child in reversed(node.get("children", []))]


def _matrix(node: dict[str, Any], index: int) -> np.ndarray:
    """Matrix (4, 4) from a node's coordinates to its parent's: given as such, or as translation, rotation, scale."""
    if "matrix" in node:
        matrix = np.array(node["matrix"], np.float64).reshape(4, 4).T
        if {"translation", "rotation", "scale"} & node.keys() or (matrix[3] != (0, 0, 0, 1)).any():
            raise ValueError(
                f"nodes {index}: its matrix has a last row other than 0, 0, 0, 1 or a translation, ... beside it"
            )
        return matrix
    x, y, z, w = quaternion = np.array(node.get("rotation", (0, 0, 0, 1)), np.float64)
    if abs(np.linalg.norm(quaternion) - 1) > 0.01:
        raise ValueError(f"nodes {index}: rotation={shown(node['rotation'])}: allowed are unit quaternions")
    turn = np.array(
        [
            (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
            (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
            (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
        ]
    )
    matrix = np.eye(4)
    matrix[:3, :3] = turn * np.array(node.get("scale", (1, 1, 1)), np.float64)
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix


def _check_still(node: dict[str, Any], mesh: dict[str, Any]) -> None:
    """Raise ValueError where the vertices of a node's mesh are moved by a skin or by morph targets."""
    if "skin" in node:
        raise ValueError("a mesh in it has a skin, which is not read; export it without, as it stands")
    targets = any("targets" in primitive for primitive in mesh["primitives"])
    if targets and any(node.get("weights", mesh.get("weights", []))):
        raise ValueError("a mesh in it has morph targets with weights, which are not read; export it as it stands")


def _surface(document: Document, primitive: dict[str, Any], buffers: Buffers) -> Surface:
    """Vertices (n, 3) and triangles (m, 3) of one primitive."""
    check_extensions(primitive, "a primitive")
    packed = ", ".join(sorted({*primitive.get("extensions", {})} & COMPRESSIONS))
    try:
        points = positions(document, primitive["attributes"]["POSITION"], buffers)
        order = corners(document, primitive["indices"], buffers) if "indices" in primitive else np.arange(len(points))
    except ValueError as error:
        raise ValueError(f"{error}{packed and f'; it is in {packed}, which is not read'}") from error
    if len(order) and order.max() >= len(points):
        raise ValueError(f"a primitive names vertex {order.max()}, it has {len(points)}")
    mode = primitive.get("mode", _TRIANGLES)
    if mode == _TRIANGLES and len(order) % 3 == 0:
        return points, order.reshape(-1, 3)
    if mode == _STRIP:
        return points, triangles_of_strip(order)
    if mode == _FAN:
        return points, np.stack([np.full(max(len(order) - 2, 0), order[0]), order[1:-1], order[2:]], axis=1)
    raise ValueError(
        f"a primitive has mode {shown(mode)} and {len(order)} corners; allowed are triangles, strips, fans"
    )
