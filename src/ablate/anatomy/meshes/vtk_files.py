"""Meshes in VTK's own formats, as 3D Slicer and ParaView save them: .vtk and .vtp."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ablate.extras import installing

VTK_SUFFIXES = (".vtk", ".vtp")
_HEAD = 2**14  # bytes of a .vtp, before its pieces: names of its field data
NEEDS_VTK = f".vtk and .vtp need the package vtk: {installing('vtk')}"


def read_vtk(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) float64 and triangles (m, 3) int64 of a file; other polygons are cut into triangles.

    Lines and points are left out. Raises ValueError when the file holds no polygonal data or is damaged, or when the
    package is not installed.
    """
    try:
        from vtkmodules.util.numpy_support import vtk_to_numpy
        from vtkmodules.vtkFiltersCore import vtkTriangleFilter
        from vtkmodules.vtkIOLegacy import vtkPolyDataReader
        from vtkmodules.vtkIOXML import vtkXMLPolyDataReader
    except ImportError as error:
        raise ValueError(NEEDS_VTK) from error
    with _complaints() as complaints:
        reader: Any = vtkPolyDataReader() if path.suffix.lower() == ".vtk" else vtkXMLPolyDataReader()
        reader.SetFileName(str(path))
        reader.Update()
        surface = reader.GetOutput()
        if "error" in complaints.GetOutput().lower():  # of what a file lacks, some are only warnings
            raise ValueError(_reason(complaints.GetOutput()))
        parts = {"VERTICES": surface.GetVerts(), "LINES": surface.GetLines()}
        parts |= {"POLYGONS": surface.GetPolys(), "TRIANGLE_STRIPS": surface.GetStrips()}
        least = 0
        for part, cells in parts.items():
            if cells is None or cells.GetNumberOfCells() == 0:
                continue
            ends = vtk_to_numpy(cells.GetOffsetsArray())
            numbers = vtk_to_numpy(cells.GetConnectivityArray())
            in_order = ends[0] == 0 and ends[-1] == len(numbers) and (np.diff(ends) >= 0).all()
            if not (in_order and numbers.min() >= 0 and numbers.max() < surface.GetNumberOfPoints()):
                raise ValueError("a polygon names a vertex that is not in the file")  # else the filter reads beside it
            if part == "POLYGONS":
                least = _fewest_triangles(np.diff(ends), numbers)
        if path.suffix.lower() == ".vtk":
            _check_declared(
                path.read_bytes(), {part: cells.GetNumberOfCells() for part, cells in parts.items() if cells}
            )
        cut = vtkTriangleFilter()
        cut.SetInputData(surface)
        cut.PassLinesOff()
        cut.PassVertsOff()
        cut.Update()
    triangles = cut.GetOutput()
    if "ERROR" in complaints.GetOutput() or triangles.GetNumberOfPolys() == 0:
        raise ValueError(_reason(complaints.GetOutput()))
    if triangles.GetNumberOfPolys() < least:
        raise ValueError("polygons in it cannot be cut into triangles; export it with triangles")
    vertices = vtk_to_numpy(triangles.GetPoints().GetData()).astype(np.float64)
    return vertices, vtk_to_numpy(triangles.GetPolys().GetConnectivityArray()).reshape(-1, 3).astype(np.int64)


def space_of_vtp(path: Path) -> str:
    """The space that 3D Slicer names in the field data of a .vtp, which may be packed; empty where it names none.

    A damaged file is told where it is read.
    """
    with path.open("rb") as stream:
        if b'Name="SPACE"' not in stream.read(_HEAD):
            return ""
    from vtkmodules.vtkIOXML import vtkXMLPolyDataReader

    with _complaints():
        reader: Any = vtkXMLPolyDataReader()
        reader.SetFileName(str(path))
        reader.Update()
        space = reader.GetOutput().GetFieldData().GetAbstractArray("SPACE")
        named = str(space.GetValue(0)) if space and space.GetNumberOfValues() else ""
    return named if named in ("LPS", "RAS") else ""


@contextmanager
def _complaints() -> Iterator[Any]:
    """Takes what VTK would write to the screen."""
    from vtkmodules.vtkCommonCore import vtkLogger, vtkStringOutputWindow

    complaints = vtkStringOutputWindow()
    window, verbosity = complaints.GetInstance(), vtkLogger.GetCurrentVerbosityCutoff()
    complaints.SetInstance(complaints)
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    try:
        yield complaints
    finally:
        complaints.SetInstance(window)
        vtkLogger.SetStderrVerbosity(verbosity)


def _fewest_triangles(lengths: np.ndarray, corners: np.ndarray) -> int:
    """How many triangles polygons of these lengths (m,) have, without corners that one of them names again."""
    span = int(corners.max()) + 1
    named = np.unique(np.repeat(np.arange(len(lengths)), lengths) * span + corners) // span
    return int(np.maximum(np.bincount(named) - 2, 0).sum())


def _check_declared(content: bytes, read: dict[str, int]) -> None:
    """Raise ValueError where a .vtk has other numbers of polygons than it declares, or a part twice.

    VTK reads the last of two.
    """
    for part, arrived in read.items():
        begins = rb"^[ \t]*" + part.encode() + rb"[ \t]+(\d+)[ \t]+\d+[ \t]*\r?\n(OFFSETS)?"
        found = re.findall(begins, content, re.MULTILINE | re.IGNORECASE)
        declared = [int(number) - bool(offsets) for number, offsets in found]  # offsets are one more
        if declared not in ([], [arrived]):
            what = " and ".join(map(str, declared))
            raise ValueError(f"{part} in it declares {what} of them, {arrived} can be read")


def _reason(output: str) -> str:
    """The first complaint of VTK, without the names of its classes and addresses."""
    lines = (line.partition("): ")[2] if "): " in line else line for line in output.splitlines())
    reasons = (
        line for line in lines if line and not line.startswith(("ERROR: In", "Warning: In", "Generic Warning: In"))
    )
    return next(reasons, "it holds no polygons; allowed is polygonal data (a surface)")
