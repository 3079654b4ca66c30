"""Pictures of depth and contact pressure as the camera sees them, pixel for pixel."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from bubbleviz.camera.depth_camera import DepthCamera
from bubbleviz.camera.membrane_view import MembraneView
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.output.exporter import estimate_of, is_known
from bubbleviz.output.nodal_image import nodal_at
from bubbleviz.pipeline import Product
from bubbleviz.result import Result

COLOURS, NOT_KNOWN = "viridis", "#28282c"
"""Perceptually uniform (Smith and van der Walt, 2015), and dark where there is no number."""

HIGHEST_PRESSURE = 4.0
"""End of the colours in gauge pressures: what lies flat on the membrane carries about one, an edge
some more."""


class DepthPngExporter:
    """Writes NAME_depth_000012.png for each frame: the depth image as measured; nothing is solved.

    The colours go from the depth of the membrane's nearest to its farthest reference node, so
    that pictures of one sensor compare. NAME_depth.json says what they stand for.

    Parameters
    ----------
    folder : Path
    name : str
    camera : DepthCamera
    mesh : MembraneMesh
    """

    products: frozenset[Product] = frozenset()

    def __init__(self, folder: Path, name: str, camera: DepthCamera, mesh: MembraneMesh) -> None:
        self._folder, self._name = folder, f"{name}_depth"
        self._range = depth_range(camera, mesh)

    def add(self, result: Result) -> None:
        """Write the picture of the next frame."""
        path = self._folder / f"{self._name}_{result.frame.index:06d}.png"
        _write_png(path, result.frame.depth_m, self._range)

    def finish(self) -> None:
        """Write what the colours stand for."""
        _write_range(self._folder / f"{self._name}.json", "depth_m", self._range)


class PressurePngExporter:
    """Writes NAME_pressure_000012.png for each frame: contact pressure where each pixel looks.

    The colours go from 0 to `HIGHEST_PRESSURE` times the gauge pressure. NAME_pressure.json says
    what they stand for.

    Parameters
    ----------
    folder : Path
    name : str
    view : MembraneView
    gauge_pressure_pa : float
    """

    products: frozenset[Product] = frozenset({"estimate"})

    def __init__(
        self, folder: Path, name: str, view: MembraneView, gauge_pressure_pa: float
    ) -> None:
        self._folder, self._name, self._view = folder, f"{name}_pressure", view
        self._range = (0.0, HIGHEST_PRESSURE * gauge_pressure_pa)
        self._pixels = np.arange(view.shape[0] * view.shape[1])

    def add(self, result: Result) -> None:
        """Write the picture of the next frame."""
        estimate = estimate_of(result)
        image = np.full(self._view.shape, np.nan)
        if is_known(estimate):
            u, pressure = estimate.motion_m, estimate.contact_pressure_pa
            image = nodal_at(self._view, u, pressure, self._pixels).reshape(image.shape)
        path = self._folder / f"{self._name}_{result.frame.index:06d}.png"
        _write_png(path, image, self._range)

    def finish(self) -> None:
        """Write what the colours stand for."""
        _write_range(self._folder / f"{self._name}.json", "contact_pressure_pa", self._range)


def depth_range(camera: DepthCamera, mesh: MembraneMesh) -> tuple[float, float]:
    """Least and greatest z-depth of the reference nodes, m."""
    T = camera.T_B_C
    depths = (mesh.nodes - T[:3, 3]) @ T[:3, 2]
    return float(depths.min()), float(depths.max())


def _write_png(path: Path, image: np.ndarray, limits: tuple[float, float]) -> None:
    from matplotlib import colormaps  # only where pictures are written
    from PIL import Image

    low, high = limits
    colours = colormaps[COLOURS].with_extremes(bad=NOT_KNOWN)((image - low) / (high - low))
    Image.fromarray((255.0 * colours[..., :3]).astype(np.uint8)).save(path)


def _write_range(path: Path, quantity: str, limits: tuple[float, float]) -> None:
    said = {
        "quantity": quantity,
        "darkest": limits[0],
        "brightest": limits[1],
        "colours": COLOURS,
        "not_known": NOT_KNOWN,
    }
    path.write_text(json.dumps(said, indent=1) + "\n", encoding="utf-8")
