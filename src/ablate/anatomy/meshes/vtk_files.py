"""Meshes in VTK's own formats, as 3D Slicer and ParaView save them: .vtk and .vtp."""

from pathlib import Path
from typing import Any

import numpy as np

from ablate.extras import installing

VTK_SUFFIXES = (".vtk", ".vtp")
NEEDS_VTK = f".vtk and .vtp need the package vtk: {installing('vtk')}"


def read_vtk(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) float64 and triangles (m, 3) int64 of a file; other polygons are cut into triangles.

    Lines and points are left out. Raises ValueError when the file holds no polygonal data or is damaged, or when the
    package is not installed.
    """
    try:
        from vtkmodules.util.numpy_support import vtk_to_numpy
        from vtkmodules.vtkCommonCore import vtkLogger, vtkStringOutputWindow
        from vtkmodules.vtkFiltersCore import vtkTriangleFilter
        from vtkmodules.vtkIOLegacy import vtkPolyDataReader
        from vtkmodules.vtkIOXML import vtkXMLPolyDataReader
    except ImportError as error:
        raise ValueError(NEEDS_VTK) from error
    complaints = vtkStringOutputWindow()  # takes what would be written to the screen
    window, verbosity = complaints.GetInstance(), vtkLogger.GetCurrentVerbosityCutoff()
    complaints.SetInstance(complaints)
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    try:
        reader: Any = vtkPolyDataReader() if path.suffix.lower() == ".vtk" else vtkXMLPolyDataReader()
        reader.SetFileName(str(path))
        reader.Update()
        surface = reader.GetOutput()
        if "ERROR" in complaints.GetOutput():
            raise ValueError(_reason(complaints.GetOutput()))
        for cells in (surface.GetVerts(), surface.GetLines(), surface.GetPolys(), surface.GetStrips()):
            if cells is None or cells.GetNumberOfCells() == 0:
                continue
            ends, numbers = (vtk_to_numpy(part) for part in (cells.GetOffsetsArray(), cells.GetConnectivityArray()))
            in_order = ends[0] == 0 and ends[-1] == len(numbers) and (np.diff(ends) >= 0).all()
            if not (in_order and numbers.min() >= 0 and numbers.max() < surface.GetNumberOfPoints()):
                raise ValueError("a polygon names a vertex that is not in the file")  # else the filter reads beside it
        cut = vtkTriangleFilter()
        cut.SetInputData(surface)
        cut.PassLinesOff()
        cut.PassVertsOff()
        cut.Update()
    finally:
        complaints.SetInstance(window)
        vtkLogger.SetStderrVerbosity(verbosity)
    triangles = cut.GetOutput()
    if "ERROR" in complaints.GetOutput() or triangles.GetNumberOfPolys() == 0:
        raise ValueError(_reason(complaints.GetOutput()))
    vertices = vtk_to_numpy(triangles.GetPoints().GetData()).astype(np.float64)
    return vertices, vtk_to_numpy(triangles.GetPolys().GetConnectivityArray()).reshape(-1, 3).astype(np.int64)


def _reason(output: str) -> str:
    """The first complaint of VTK, without the names of its classes and addresses."""
    reasons = (line.partition("): ")[2] for line in output.splitlines() if "): " in line)
    return next(reasons, "it holds no polygons; allowed is polygonal data (a surface)")
