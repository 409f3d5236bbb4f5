"""Meshes in VTK's own formats, as 3D Slicer and ParaView save them: .vtk and .vtp."""

from pathlib import Path
from typing import Any

import numpy as np

VTK_SUFFIXES = (".vtk", ".vtp")
NEEDS_VTK = ".vtk and .vtp need the package vtk: pip install 'ablate-ultrasound[vtk]'"


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
    said = vtkStringOutputWindow()  # takes what would be written to the screen
    window, verbosity = said.GetInstance(), vtkLogger.GetCurrentVerbosityCutoff()
    said.SetInstance(said)
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    try:
        reader: Any = vtkPolyDataReader() if path.suffix.lower() == ".vtk" else vtkXMLPolyDataReader()
        reader.SetFileName(str(path))
        cut = vtkTriangleFilter()
        cut.SetInputConnection(reader.GetOutputPort())
        cut.PassLinesOff()
        cut.PassVertsOff()
        cut.Update()
    finally:
        said.SetInstance(window)
        vtkLogger.SetStderrVerbosity(verbosity)
    found = cut.GetOutput()
    if "ERROR" in said.GetOutput() or found.GetNumberOfPolys() == 0:
        raise ValueError(_reason(said.GetOutput()))
    vertices = vtk_to_numpy(found.GetPoints().GetData()).astype(np.float64)
    return vertices, vtk_to_numpy(found.GetPolys().GetConnectivityArray()).reshape(-1, 3).astype(np.int64)


def _reason(said: str) -> str:
    """The first complaint of VTK, without the names of its classes and addresses."""
    complaints = [line.partition("): ")[2] for line in said.splitlines() if "): " in line]
    return complaints[0] if complaints else "it holds no polygons; allowed is polygonal data (a surface)"
