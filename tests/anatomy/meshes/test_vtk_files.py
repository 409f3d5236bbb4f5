"""Meshes in VTK's formats, written by VTK itself."""

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from ablate.anatomy import load_scene, scene_folder, validate_scene_folder
from ablate.anatomy.meshes.repair import load_mesh

pytest.importorskip("vtkmodules", reason="needs the extra: pip install 'ablate-ultrasound[vtk]'")

from vtkmodules.vtkCommonCore import vtkStringArray
from vtkmodules.vtkFiltersCore import vtkAppendPolyData
from vtkmodules.vtkFiltersSources import vtkCubeSource
from vtkmodules.vtkIOLegacy import vtkPolyDataWriter
from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter


def write(path: Path, binary: bool = False, count: int = 1) -> Path:
    """Boxes of 20 x 30 x 40, made of squares, beside each other."""
    boxes = vtkAppendPolyData()
    for number in range(count):
        box = vtkCubeSource()
        box.SetXLength(20), box.SetYLength(30), box.SetZLength(40), box.SetCenter(50 * number, 0, 0)
        boxes.AddInputConnection(box.GetOutputPort())
    writer: Any = vtkPolyDataWriter() if path.suffix == ".vtk" else vtkXMLPolyDataWriter()
    if binary and path.suffix == ".vtk":
        writer.SetFileTypeToBinary()
    writer.SetInputConnection(boxes.GetOutputPort())
    writer.SetFileName(str(path))
    assert writer.Write() == 1
    return path


@pytest.mark.parametrize("name", ["box.vtk", "box.vtp", "BINARY.vtk"])
def test_squares_become_triangles_that_enclose_the_same_volume(name: str, tmp_path: Path) -> None:
    mesh = load_mesh(write(tmp_path / name, binary=name.isupper()), mm_per_unit=2.0)
    assert (len(mesh.vertices), len(mesh.faces)) == (8, 12)
    assert abs(mesh.volume) == pytest.approx(8 * 20 * 30 * 40)
    np.testing.assert_allclose(mesh.bounds, [[-20, -30, -40], [20, 30, 40]])


def test_all_ways_to_write_a_vtp_are_read(tmp_path: Path) -> None:
    modes, switches = ("SetDataModeToAppended", "SetDataModeToBinary", "SetDataModeToAscii"), (0, 1)
    for number, (mode, encoded, zipped, wide, big) in enumerate(product(modes, *[switches] * 4)):
        box, writer = vtkCubeSource(), vtkXMLPolyDataWriter()
        getattr(writer, mode)()
        writer.SetEncodeAppendedData(encoded)
        writer.SetCompressorTypeToZLib() if zipped else writer.SetCompressorTypeToNone()
        writer.SetHeaderTypeToUInt64() if wide else writer.SetHeaderTypeToUInt32()
        writer.SetByteOrder(int(not big))  # 0 is big endian
        writer.SetInputConnection(box.GetOutputPort())
        writer.SetFileName(str(tmp_path / f"{number}.vtp"))
        assert writer.Write() == 1
        assert len(load_mesh(tmp_path / f"{number}.vtp").faces) == 12


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("text.vtk", "hello\n", "Unrecognized file type"),
        ("text.vtp", "<hello", "unclosed token"),
        ("grid.vtk", "# vtk DataFile Version 3.0\nx\nASCII\nDATASET STRUCTURED_POINTS\n", "structured_points"),
        ("points.vtk", "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 1 int\n0 0 0\n", "no polygons"),
        (
            "beside.vtk",
            "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 3 int\n0 0 0 1 0 0 0 1 0\n"
            "POLYGONS 1 5\n4 0 1 2 99999999\n",
            "a polygon names a vertex that is not in the file",
        ),
        (
            "cut_between_lines.vtk",
            "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 4 int\n0 0 0 1 0 0 0 1 0 0 0 1\n"
            "POLYGONS 2 4\n3 0 1 2\n",
            "POLYGONS in it declares 2 of them, 1 can be read",
        ),
        (
            "twice.vtk",
            "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 4 int\n0 0 0 1 0 0 0 1 0 0 0 1\n"
            "POLYGONS 2 8\n3 0 1 2\n3 0 1 3\nPOLYGONS 1 4\n3 1 2 3\n",
            "POLYGONS in it declares 2 and 1 of them, 1 can be read",
        ),
        (
            "crossing.vtk",
            "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 4 int\n0 0 0 4 0 0 2 0 0 0 1 0\n"
            "POLYGONS 2 10\n3 0 1 3\n5 0 1 2 1 3\n",
            "polygons in it cannot be cut into triangles",
        ),
        ("cut.vtk", None, "Unrecognized keyword"),
        ("cut.vtp", None, "unclosed token"),
    ],
)
def test_a_file_that_cannot_be_used_is_named_with_a_reason(
    name: str, content: str | None, words: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / name
    if content is None:
        whole = write(path).read_bytes()
        path.write_bytes(whole[: len(whole) // 2])
    else:
        path.write_text(content)
    with pytest.raises(ValueError, match=rf"{name}: not readable as a mesh: .*{words}"):
        load_mesh(path)
    assert capfd.readouterr().err == "", "VTK writes to the screen"


@pytest.mark.parametrize("name", ["ascii.vtk", "binary.vtk", "two.vtp"])
def test_two_bodies_in_a_file_that_ends_early_are_both_read_or_none(name: str, tmp_path: Path) -> None:
    path = write(tmp_path / name, binary=name == "binary.vtk", count=2)
    whole = path.read_bytes()
    for cut in range(whole.index(b"POLYGONS" if name.endswith("vtk") else b"<Polys>"), len(whole) + 1, 9):
        path.write_bytes(whole[:cut])
        try:
            volume = load_mesh(path).volume  # where only normals are cut
        except ValueError:
            volume = 0
        assert volume in (0, pytest.approx(2 * 20 * 30 * 40)), f"the first {cut} of {len(whole)} bytes"


def test_a_scene_is_made_of_them_and_without_the_package_its_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path / "skin.vtp")
    trimesh.creation.icosphere(radius=8.0).export(tmp_path / "liver.stl")
    structures = "{mesh: skin.vtp, tissue: fat}, {mesh: liver.stl, tissue: liver}"
    (tmp_path / "scene.yaml").write_text(f"structures: [{structures}]\n")
    scene = load_scene(tmp_path)
    assert [s.mesh.metadata["name"] for s in scene.structures] == ["skin.vtp", "liver.stl"]
    monkeypatch.setattr(scene_folder, "find_spec", lambda _: None)
    with pytest.raises(ValueError, match=r"structures\[0\]\.mesh: .*pip install -e '\.\[vtk\]'"):
        validate_scene_folder(tmp_path)


@pytest.mark.parametrize("mode", ["SetDataModeToAppended", "SetDataModeToBinary", "SetDataModeToAscii"])
def test_the_space_that_3d_slicer_names_in_a_vtp_is_known(mode: str, tmp_path: Path) -> None:
    """It stands in the field data, as codes of its letters or packed."""
    for space in ("LPS", "RAS"):
        box, writer, named = vtkCubeSource(), vtkXMLPolyDataWriter(), vtkStringArray()
        named.SetName("SPACE")
        named.InsertNextValue(space)
        box.Update()
        surface = box.GetOutput()
        surface.GetFieldData().AddArray(named)
        getattr(writer, mode)()
        writer.SetInputData(surface)
        writer.SetFileName(str(tmp_path / f"in{space}.vtp"))
        assert writer.Write() == 1
    structures = "{mesh: inLPS.vtp, tissue: fat}, {mesh: inRAS.vtp, tissue: liver}"
    (tmp_path / "scene.yaml").write_text(f"structures: [{structures}]\n")
    with pytest.raises(ValueError, match=r"inLPS\.vtp is in LPS, but inRAS\.vtp is in RAS; export all as RAS"):
        validate_scene_folder(tmp_path)
