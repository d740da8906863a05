"""The finite-element mesh and its displacements as files for ParaView."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import (
    VTK_QUADRATIC_HEXAHEDRON,
    VTK_QUADRATIC_TETRA,
    vtkCellArray,
    vtkPointSet,
    vtkUnstructuredGrid,
)
from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter, vtkXMLUnstructuredGridWriter

from acoustube.base.types import Array
from acoustube.base.units import MM
from acoustube.base.writing import write as write_file
from acoustube.indentation import Mesh
from acoustube.indentation.reference_element import HEX20, Reference

VTK_HEXAHEDRON = (
    *((0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (0, 0, 2), (2, 0, 2), (2, 2, 2), (0, 2, 2)),
    *((1, 0, 0), (2, 1, 0), (1, 2, 0), (0, 1, 0), (1, 0, 2), (2, 1, 2), (1, 2, 2), (0, 1, 2)),
    *((0, 0, 1), (2, 0, 1), (2, 2, 1), (0, 2, 1)),
)
"""Nodes of VTK's quadratic hexahedron in its order: local coordinates (-1 to 1) plus 1."""
VTK_TETRAHEDRON = (0, 1, 2, 3, 4, 7, 5, 6, 8, 9)
"""Node numbers in acoustube of a tetrahedron's nodes in VTK's order.

Mid-edge nodes are ordered by edges 01, 12, 02, 03, 13, 23 in VTK; here 01, 02, 03, 12, 13, 23.
"""


def write(mesh: Mesh, depths: Array, displacements: Array, folder: Path) -> Path:
    """Write mesh and displacements, one file per depth, and a collection of these for ParaView.

    Parameters
    ----------
    mesh : Mesh
    depths : array of shape (n_depths,)
        Depths in m.
    displacements : array of shape (n_depths, n_nodes, 3)
        Displacements of the nodes in m.
    folder : path
        Folder to write, created if missing.

    Returns
    -------
    Path
        The collection, ``press.pvd``, whose time is the depth in mm.
    """
    folder.mkdir(parents=True, exist_ok=True)
    grid, entries = _grid(mesh), []
    for number, (depth, displacement) in enumerate(
        zip(depths, displacements, strict=True), start=1
    ):
        name = f"press-{number:04d}.vtu"
        values = numpy_to_vtk(displacement, deep=True)
        values.SetName("displacement")
        grid.GetPointData().AddArray(values)  # replaces that of the previous depth
        write_file(folder / name, in_xml(grid))
        entries.append(f'<DataSet timestep="{MM * depth:.6g}" file="{name}"/>')
    collection = folder / "press.pvd"
    write_file(
        collection,
        '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1"><Collection>\n'
        + "\n".join(entries)
        + "\n</Collection></VTKFile>\n",
    )
    return collection


def in_xml(shape: vtkPointSet) -> str:
    """Return the content of a VTU or VTP file as text: VTK's own writer fails on a full disk."""
    of_grid = isinstance(shape, vtkUnstructuredGrid)
    writer = vtkXMLUnstructuredGridWriter() if of_grid else vtkXMLPolyDataWriter()
    writer.SetInputData(shape)
    writer.SetDataModeToBinary()
    writer.WriteToOutputStringOn()
    writer.Write()
    return str(writer.GetOutputString())


def _grid(mesh: Mesh) -> vtkUnstructuredGrid:
    """Return the undeformed mesh with quadratic cells.

    It is made with VTK alone, since importing PyVista takes longer than writing the files.
    """
    kind = VTK_QUADRATIC_HEXAHEDRON if mesh.reference is HEX20 else VTK_QUADRATIC_TETRA
    points, cells, grid = vtkPoints(), vtkCellArray(), vtkUnstructuredGrid()
    points.SetData(numpy_to_vtk(np.ascontiguousarray(mesh.points), deep=True))
    nodes = np.ascontiguousarray(mesh.elements[:, _order(mesh.reference)], np.int64)
    cells.SetData(nodes.shape[1], numpy_to_vtk(nodes.ravel(), deep=True))
    grid.SetPoints(points)
    grid.SetCells(kind, cells)
    return grid


def _order(reference: Reference) -> NDArray[np.int64]:
    """Return the local node numbers of an element, in VTK's order."""
    if reference is not HEX20:
        return np.array(VTK_TETRAHEDRON)
    ours = [tuple(node) for node in (reference.nodes + 1).astype(int)]
    return np.array([ours.index(node) for node in VTK_HEXAHEDRON])
