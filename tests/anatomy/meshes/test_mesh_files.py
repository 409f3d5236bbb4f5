"""Files of OBJ, STL, PLY and OFF: dialects that mean the same, files that end early, what is refused by name."""

import logging
import struct
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from ablate.anatomy.meshes.mesh_file import read_mesh
from ablate.anatomy.meshes.repair import load_mesh

Polygons = list[list[int]]
CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
SQUARES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4]]
TRIANGLES = [[1, 5, 7], [1, 7, 3]]
BODIES = [(30.0, 0.0), (20.0, 200.0)]  # half a side, and where on x
VOLUME = 60.0**3 + 40.0**3


def body(half: float, x: float) -> np.ndarray:
    return CORNERS * half + (x, 0, 0)


def joined() -> tuple[np.ndarray, Polygons]:
    """Both bodies, of squares and triangles."""
    polygons = [[8 * n + i for i in polygon] for n in range(2) for polygon in SQUARES + TRIANGLES]
    return np.vstack([body(*one) for one in BODIES]), polygons


def words(values: Sequence[float] | np.ndarray) -> str:
    return " ".join(f"{value:.7g}" for value in values)


def obj(relative: bool = False) -> str:
    lines = []
    for number, one in enumerate(BODIES):
        lines += [f"o {number}", *(f"v {words(point)}" for point in body(*one))]
        shift = -8 if relative else 1 + 8 * number
        lines += ["f " + " ".join(str(i + shift) for i in polygon) for polygon in SQUARES + TRIANGLES]
    return "\n".join([*lines, ""])


def off(head: str = "OFF\n16 14 0") -> str:
    points, polygons = joined()
    return "\n".join([head, *map(words, points), *(f"{len(p)} {words(p)}" for p in polygons), ""])


def stl() -> str:
    text = ""
    for number, one in enumerate(BODIES):
        box = trimesh.Trimesh(body(*one), trimesh.creation.box().faces)
        lines = trimesh.exchange.stl.export_stl_ascii(box).splitlines()[1:-1]
        text += "\n".join([f"solid body {number}", *lines, f"endsolid body {number}", ""])
    return text


def ply(form: str = "ascii", count: str = "uchar", corner: str = "int", polygons: Polygons | None = None) -> bytes:
    points, faces = joined()
    faces = polygons or faces
    codes = {"uchar": "B", "int": "i", "uint": "I", "short": "h", "uint8": "B", "int32": "i", "ushort": "H"}
    head = [
        "ply", f"format {form} 1.0", "comment of a test", f"element vertex {len(points)}",
        *(f"property double {axis}" for axis in "xyz"), "property uchar red", f"element face {len(faces)}",
        "property float quality", f"property list {count} {corner} vertex_indices", "end_header", "",
    ]  # fmt: skip
    if form == "ascii":
        rows = [f"{words(point)} 255" for point in points] + [f"0.5 {len(face)} {words(face)}" for face in faces]
        return "\n".join([*head, *rows, ""]).encode()
    order = "<" if "little" in form else ">"
    vertices = [struct.pack(f"{order}3dB", *point, 255) for point in points]
    rows = [struct.pack(f"{order}f{codes[count]}{len(f)}{codes[corner]}", 0.5, len(f), *f) for f in faces]
    return "\n".join(head).encode() + b"".join([*vertices, *rows])


def strips() -> str:
    """A PLY of one strip for each triangle of the first body, some in a row of their own."""
    faces = trimesh.creation.box().faces
    rows = [[i for face in part for i in (*face, -1)][:-1] for part in (faces[:7], faces[7:])]
    head = "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n"
    head += "element tristrips 2\nproperty list int int vertex_indices\nend_header\n"
    return head + "\n".join([*map(words, body(30, 0)), *(f"{len(row)} {words(row)}" for row in rows), ""])


DIALECTS: dict[str, str | bytes] = {
    "plain.obj": obj(),
    "relative.obj": obj(relative=True),
    "crlf.obj": obj(relative=True).replace("\n", "\r\n"),
    "mac.obj": obj().replace("\n", "\r"),
    "tabs.obj": obj().replace(" ", "\t"),
    "blanks.obj": obj().replace("v ", "  v  ").replace("f ", " f  "),
    "continued.obj": obj().replace("f 1 2 ", "f 1 \\\n2 "),
    "textures.obj": obj().replace("f 1 2 ", "f 1/1/1 2//7 "),
    "coloured.obj": obj().replace("-30 -30 -30\n", "-30 -30 -30 0.1 0.2 0.3\n"),
    "weights.obj": obj().replace("-30 -30 -30\n", "-30 -30 -30 1.0\n"),
    "comments.obj": "\ufeff# Vertices: 16\n# Faces: 14\n" + obj().replace("-30\n", "-30 # a corner\n"),
    "folders.obj": "# of C:\\scans\\\n" + obj(relative=True).replace("-30 -30 -30\n", "-30 -30 -30 # of C:\\scans\\\n"),
    "looks.obj": "mtllib caf\u00e9.mtl\n" + obj().replace("o 1", "g f 9\ns 1\nusemtl v 9\nl 1 2\np 1"),
    "plain.off": off(),
    "coloured.off": off("COFF\n16 14 0").replace("30\n", "30 255 0 0 255\n").replace("2\n", "2 0.3 0.4 0.5\n"),
    "one_line.off": off("OFF 16 14 99"),
    "glued.off": off("OFF16 14 0"),
    "comments.off": "# a file\n" + off("OFF # of a test\n\n16 14").replace("\n4 ", " # here\n4 "),
    "plain.stl": stl(),
    "capitals.stl": stl().upper(),
    "end_solid.stl": stl().replace("endsolid", "end solid"),
    "named.stl": stl().replace("body 1", "endsolid facet vertex"),
    "ascii.ply": ply(),
    "crlf.ply": ply().replace(b"\n", b"\r\n"),
    "little.ply": ply("binary_little_endian"),
    "big.ply": ply("binary_big_endian", "ushort", "short"),
    "old_blender.ply": ply("binary_little_endian", "uint8", "int32").replace(b"comment of", b"Created by"),
    "int_lists.ply": ply("binary_little_endian", "int", "uint"),
}


def written(folder: Path, name: str, content: str | bytes) -> Path:
    (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return folder / name


@pytest.mark.parametrize("name", DIALECTS)
def test_dialects_of_a_format_are_the_same_two_bodies(tmp_path: Path, name: str) -> None:
    mesh = load_mesh(written(tmp_path, name, DIALECTS[name]))
    assert abs(mesh.volume) == pytest.approx(VOLUME, rel=1e-6)
    np.testing.assert_allclose(mesh.bounds, [(-30, -30, -30), (220, 30, 30)])
    assert len(mesh.faces) == 24


def test_strips_of_ply_are_triangles(tmp_path: Path) -> None:
    mesh = load_mesh(written(tmp_path, "strips.ply", strips()))
    assert len(mesh.faces) == 12
    assert mesh.is_watertight
    np.testing.assert_allclose(mesh.bounds, [(-30, -30, -30), (30, 30, 30)])


MEASURED: dict[str, Callable[[], str | bytes]] = {
    "two.off": off,
    "two.stl": stl,
    "binary.stl": lambda: trimesh.exchange.stl.export_stl(trimesh.util.concatenate(
        [trimesh.Trimesh(body(*one), trimesh.creation.box().faces) for one in BODIES])),
    "ascii.ply": ply,
    "little.ply": lambda: ply("binary_little_endian"),
    "alike.ply": lambda: ply("binary_big_endian", polygons=[
        [8 * n + i for i in face] for n in range(2) for face in trimesh.creation.box().faces.tolist()]),
    "two.glb": lambda: trimesh.exchange.gltf.export_glb(trimesh.Scene(
        [trimesh.Trimesh(body(*one), trimesh.creation.box().faces) for one in BODIES])),
}  # fmt: skip


@pytest.mark.parametrize("name", MEASURED)
def test_two_bodies_in_a_file_that_ends_early_are_both_read_or_none(tmp_path: Path, name: str) -> None:
    content = MEASURED[name]()
    whole = content if isinstance(content, bytes) else content.encode()
    # within the last number of a text, or after a whole solid, nothing is missing that could be seen
    between = whole.find(b"solid body 1") if name == "two.stl" else len(whole)
    blind = {*range(len(whole) - 3, len(whole)), *range(between - 1, between + 1)}
    ends = {i for i, byte in enumerate(whole) if byte == ord("\n")} | {*range(0, len(whole), 37)} | {len(whole)}
    volumes = []
    for cut in sorted((ends - blind) | {len(whole)}):
        try:
            volumes.append(abs(load_mesh(written(tmp_path, name, whole[:cut])).volume))
        except ValueError as error:
            volumes.append(0.0)
            reason = str(error)
            if not (name in reason and "\n" not in reason):
                raise
    assert volumes[-1] == pytest.approx(VOLUME, rel=1e-6)
    assert {round(volume) for volume in volumes} == {0, round(VOLUME)}


def test_an_obj_that_ends_between_two_lines_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """It declares nothing; but vertices at its end that no face names are a sign, and MeshLab counts in a comment."""
    points, polygons = joined()
    lines = [f"v {words(p)}" for p in points] + ["f " + " ".join(str(i + 1) for i in p) for p in polygons[:7]]
    load_mesh(written(tmp_path, "cut.obj", "\n".join([*lines, ""])))
    assert "cut.obj: no face names its last vertices" in caplog.text
    with pytest.raises(ValueError, match="declares 14 faces, 7 are there"):
        load_mesh(written(tmp_path, "cut.obj", "\n".join(["# Vertices: 16", "# Faces: 14", *lines])))


HEAD = "ply\nformat ascii 1.0\nelement vertex 3\nproperty int x\nproperty int y\nproperty int z\n"
FACE = "element face 1\nproperty list int int vertex_indices\n"
POINTS = "0 0 0\n9 0 0\n0 9 0\n"
V = "v 0 0 0\nv 9 0 0\nv 0 9 0\n"
FACET = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 9 0 0\nvertex 0 9 0\nendloop\nendfacet\n"

REFUSED: list[tuple[str, str, str]] = [
    ("a.obj", V + "f 0 1 2\n", "names vertex 0; an OBJ counts from 1"),
    ("a.obj", V + "f 1/1 2/2 0/3\n", "names vertex 0"),
    ("a.obj", "v 0 0 0\nv 9 0 0\nf -3 -2 -1\nv 0 9 0\n", "counts back beyond the 2 vertices above it"),
    ("a.obj", V + "f 1 2 4\n", "vertices that are not among its 3"),
    ("a.obj", V + "f 1 2\n", "'f 1 2': a face has at least three corners"),
    ("a.obj", V + "f 1 2 x\n", "invalid literal for int"),
    ("a.obj", V.replace("9 0 0", "9 0 0 2") + "f 1 2 3\n", "'v 9 0 0 2': allowed are"),
    ("a.obj", V.replace("9 0 0", "9 0") + "f 1 2 3\n", "'v 9 0': allowed are"),
    ("a.obj", V.replace("9 0 0", "9,0 0 0") + "f 1 2 3\n", "could not convert string to float: '9,0'"),
    ("a.obj", V + "f 1 2 3\ncstype bezier\nsurf 0 1 0 1 1 2 3\n", "'cstype' is not read; export polygons"),
    ("a.obj", V + "f 1 2 3\ncall other.obj\n", "'call' is not read"),
    ("a.obj", f"\0{V}f 1 2 3\n", "no text of one byte a character"),
    ("a.off", f"OFF\n3 2 0\n{POINTS}3 0 1 2\n", "declares 3 vertices and 2 faces, a line each, but 4 lines are there"),
    ("a.off", f"OFF\n3 1 0\n{POINTS}3 0 1 2\n3 0 1 2\n", "declares 3 vertices and 1 faces, a line each, but 5"),
    ("a.off", f"OFF\n3 1 0\n{POINTS}4 0 1 2\n", "a face declares 4 corners"),
    ("a.off", f"OFF\n3 1 0\n{POINTS}-1 0 1 2\n", "a face declares -1 corners"),
    ("a.off", f"OFF\n3 1 0\n{POINTS}3 0 1 -1\n", "vertices that are not among its 3"),
    ("a.off", f"4OFF\n3 1 0\n{POINTS}3 0 1 2\n", "it begins with '4OFF'; allowed are OFF, COFF"),
    ("a.off", "OFF BINARY\n3 1 0\n", "'BINARY': allowed are the numbers of vertices, faces"),
    ("a.off", f"OFF\n999999999999 1 0\n{POINTS}", "declares 999999999999 vertices"),
    ("a.stl", f"solid a\n{FACET}", "after 1 whole triangles of solid 1, and before its endsolid, the file ends"),
    ("a.stl", f"solid a\n{FACET}endsolid\nsolid b\n{FACET}", "after 1 whole triangles of solid 2"),
    ("a.stl", f"solid a\n{FACET}solid b\n{FACET}endsolid b\n", "before its endsolid, there is 'solid b'"),
    ("a.stl", f"solid a\n{FACET[:-9]}endsolid\n", "after 0 whole triangles of solid 1, .* there is 'endsolid'"),
    ("a.stl", f"solid a\n{FACET.replace('endloop', 'vertex 9 9 0 endloop')}endsolid\n", "there is 'vertex 9 9 0"),
    ("a.stl", f"solid a\n{FACET.replace('9 0 0', '9 0')}endsolid\n", "'vertex 9 0': a vertex has three"),
    ("a.stl", f"solid a\n{FACET}endsolid\ncurve 1 2\n", "there is 'curve 1 2'"),
    ("a.stl", 84 * "\0" + "12", "declares 0 triangles, that is 84 bytes, but it has 86; nor is it an ASCII STL"),
    ("a.ply", f"{HEAD}{FACE}end_header\n{POINTS}", "element face: its header declares 1 rows, and 0 bytes"),
    ("a.ply", f"{HEAD}{FACE}end_header\n{POINTS}4 0 1 2\n", "element face: its header declares 1 rows, and it ends"),
    ("a.ply", f"{HEAD}{FACE}end_header\n{POINTS}3 0 1 2\n3 0 1 2\n", "bytes follow the rows that its header declares"),
    ("a.ply", f"{HEAD}{FACE}end_header\n{POINTS}-3 0 1 2\n", "row 1 has a list of -3 numbers"),
    ("a.ply", f"{HEAD}{FACE}end_header\n{POINTS}3 0 1 2.5\n", "element face: its corners are no whole numbers"),
    ("a.ply", f"{HEAD}{FACE}end_header\n{POINTS}3 0 1 -1\n", "vertices that are not among its 3"),
    ("a.ply", f"{HEAD}{FACE.replace('face', 'trifans')}end_header\n{POINTS}3 0 1 2\n", "element 'trifans' is not read"),
    ("a.ply", f"{HEAD}element range_grid 2\nproperty list int int vertex_indices\nend_header\n", "'range_grid' is not"),
    ("a.ply", HEAD.replace("int z", "int w") + f"{FACE}end_header\n{POINTS}3 0 1 2\n", "its vertices have no z"),
    ("a.ply", HEAD.replace("int z", "quad z") + f"{FACE}end_header\n{POINTS}3 0 1 2\n", "'property quad z' is no"),
    ("a.ply", HEAD.replace("vertex 3", "vertex 999999999999") + "end_header\n", "declares 999999999999 rows"),
    ("a.ply", f"{HEAD}{FACE}", "does not begin with a header of PLY"),
    ("a.ply", HEAD.replace("ascii 1.0", "ascii 2.0") + "end_header\n", "'format ascii 2.0' is no format"),
    ("a.ply", f"{HEAD}{FACE.replace('vertex_indices', 'a')}property list int int b\nend_header\n{POINTS}0 0\n", "a, b"),
    ("a.dae", "<x/>", r"'\.dae': allowed are \.obj, \.stl"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "content", "message"), REFUSED)
def test_what_is_not_read_or_not_there_is_refused_by_name(
    tmp_path: Path, name: str, content: str, message: str
) -> None:
    with pytest.raises(ValueError, match=rf"{name}: .*{message}") as refused:
        load_mesh(written(tmp_path, name, content))
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 500


polygons = st.lists(st.lists(st.integers(0, 15), min_size=3, max_size=7), min_size=1, max_size=9)
forms = st.sampled_from(["ascii", "binary_little_endian", "binary_big_endian"])


@settings(deadline=None, max_examples=60)
@given(drawn=polygons, form=forms, count=st.sampled_from(["uchar", "ushort", "int"]))
def test_any_polygons_are_the_same_triangles_in_every_format(
    tmp_path_factory: pytest.TempPathFactory, drawn: Polygons, form: str, count: str
) -> None:
    folder = tmp_path_factory.mktemp("polygons")
    points, _ = joined()
    expected = [points[[p[0], p[i], p[i + 1]]].tolist() for p in drawn for i in range(1, len(p) - 1)]
    lines = [f"v {words(p)}" for p in points]
    files: dict[str, str | bytes] = {
        "a.obj": "\n".join(lines + ["f " + " ".join(str(i + 1) for i in p) for p in drawn]),
        "b.obj": "\n".join(lines + ["f " + " ".join(str(i - 16) for i in p) for p in drawn]),
        "a.off": "\n".join([f"OFF\n16 {len(drawn)} 0", *map(words, points), *(f"{len(p)} {words(p)}" for p in drawn)]),
        "a.ply": ply(form, count, "int", drawn),
    }
    for name, content in files.items():
        vertices, faces = read_mesh(written(folder, name, content))
        assert vertices[faces].tolist() == expected, name


def test_no_warning_of_a_whole_obj(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        load_mesh(written(tmp_path, "whole.obj", obj()))
    assert not caplog.records
