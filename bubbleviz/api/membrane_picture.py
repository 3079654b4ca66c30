"""One frame in 3-D, for notebooks and scripts; pyvista, without Qt."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bubbleviz.errors import InputError
from bubbleviz.export.deformed_shape import Shape
from bubbleviz.files.output_files import refuse_existing, whole_file
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.result import Result
from bubbleviz.wording import how_to_install

_ARROW = 0.5  # of the membrane's width, the length of the force's arrow
_PRESSURE = "contact pressure, kPa"


def show_membrane(result: Result, mesh: MembraneMesh, screenshot: str | Path | None) -> Any:
    """Show membrane, contact pressure, the patch's outline and the force.

    Parameters
    ----------
    result : Result
        With its estimate and patch.
    mesh : MembraneMesh
    screenshot : path or None
        PNG to write without a screen; None opens a window, or a picture in a notebook.

    Returns
    -------
    object
        What `pyvista.Plotter.show` returns.

    Raises
    ------
    InputError
        pyvista is not installed, or the file exists.
    """
    try:
        import pyvista  # an extra
    except ImportError as error:
        install = how_to_install("window")
        raise InputError(f"pyvista is not installed; run {install}") from error
    if screenshot is not None:
        refuse_existing(screenshot)
    with pyvista.vtk_verbosity("error"):  # without an X server VTK warns, and draws
        plotter = pyvista.Plotter(off_screen=screenshot is not None)
        _draw(plotter, pyvista, result, mesh)
        backend = "static" if plotter.notebook else None  # needs neither a screen nor trame
        if screenshot is None:
            return plotter.show(jupyter_backend=backend)
        with whole_file(screenshot) as temporary:
            return plotter.show(jupyter_backend=backend, screenshot=str(temporary))


def _draw(plotter: Any, pyvista: Any, result: Result, mesh: MembraneMesh) -> None:
    shape, patch = Shape.of(mesh, result), result.patch
    surface = pyvista.PolyData.from_regular_faces(shape.points_m, mesh.triangles)
    surface[_PRESSURE] = 1e-3 * shape.contact_pressure_pa
    plotter.add_mesh(surface, scalars=_PRESSURE, cmap="viridis")
    if patch is not None and patch.area_m2 > 0.0:
        surface["level"] = patch.level
        edge = surface.contour([0.0], scalars="level")
        plotter.add_mesh(edge, color="white", line_width=4, render_lines_as_tubes=True)
        size = float(np.linalg.norm(patch.force_n))
        direction = patch.force_n / size
        length = _ARROW * float(np.ptp(mesh.nodes[:, 0]))
        tail = patch.center_of_pressure_m - length * direction
        arrow = pyvista.Arrow(
            start=tail, direction=direction, scale=length, shaft_radius=0.02, tip_radius=0.05
        )
        plotter.add_mesh(arrow, color="red")
    force = "" if patch is None or not patch.area_m2 else f", {np.linalg.norm(patch.force_n):.3g} N"
    plotter.add_text(f"frame {result.frame.index}: {_status(result)}{force}", font_size=10)


def _status(result: Result) -> str:
    return "" if result.estimate is None else result.estimate.status
