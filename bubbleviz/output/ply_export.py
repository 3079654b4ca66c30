"""PLY series: the membrane, or the measured points of the patch, one file a frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bubbleviz.camera.membrane_view import MembraneView
from bubbleviz.files.ply_writer import write_ply
from bubbleviz.frames.frame import Frame
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.output.deformed_shape import Shape
from bubbleviz.output.exporter import estimate_of, is_known
from bubbleviz.output.nodal_image import nodal_at
from bubbleviz.pipeline import Product
from bubbleviz.result import Result


class MembranePlyExporter:
    """Writes NAME_membrane_000012.ply for each frame, with displacement and contact pressure.

    Parameters
    ----------
    folder : Path
    name : str
    mesh : MembraneMesh
    """

    products: frozenset[Product] = frozenset({"estimate"})

    def __init__(self, folder: Path, name: str, mesh: MembraneMesh) -> None:
        self._folder, self._name, self._mesh = folder, name, mesh

    def add(self, result: Result) -> None:
        """Write the membrane of the next frame."""
        shape = Shape.of(self._mesh, result)
        values = {
            "displacement_m": shape.displacement_m,
            "contact_pressure_pa": shape.contact_pressure_pa,
        }
        path = self._folder / f"{self._name}_membrane_{result.frame.index:06d}.ply"
        write_ply(path, shape.points_m, values, self._mesh.triangles, _comment(result.frame))

    def finish(self) -> None:
        """Nothing needs all frames."""


class PatchPlyExporter:
    """Writes NAME_patch_000012.ply for each frame: measured points in the patch, with pressure.

    A frame without a patch has a file without points, so that every frame has one.

    Parameters
    ----------
    folder : Path
    name : str
    view : MembraneView
    """

    products: frozenset[Product] = frozenset({"estimate", "patch", "pixel_mask", "cloud"})

    def __init__(self, folder: Path, name: str, view: MembraneView) -> None:
        self._folder, self._name, self._view = folder, name, view

    def add(self, result: Result) -> None:
        """Write the patch of the next frame."""
        points, pressure = self._patch(result)
        path = self._folder / f"{self._name}_patch_{result.frame.index:06d}.ply"
        write_ply(path, points, {"contact_pressure_pa": pressure}, comment=_comment(result.frame))

    def finish(self) -> None:
        """Nothing needs all frames."""

    def _patch(self, result: Result) -> tuple[np.ndarray, np.ndarray]:
        estimate, patch = estimate_of(result), result.patch
        cloud, pixels = result.cloud_m, result.cloud_pixels
        if patch is None or patch.pixel_mask is None or cloud is None or pixels is None:
            raise ValueError("the products pixel_mask and cloud were not asked for")
        inside = patch.pixel_mask.ravel()[pixels]
        if not is_known(estimate) or not inside.any():
            return np.empty((0, 3)), np.empty(0)
        return cloud[inside], nodal_at(
            self._view, estimate.motion_m, estimate.contact_pressure_pa, pixels[inside]
        )


def _comment(frame: Frame) -> str:
    return f"bubble frame B, metres; frame {frame.index}, {frame.time_s!r} s"
