"""The depth camera's field of view."""

from __future__ import annotations

import numpy as np
import pyvista as pv

from bubbleviz.camera.depth_camera import DepthCamera
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.sensor import Camera, Sensor
from bubbleviz_ui.view3d.layers.layer import Canvas, Layer, Picture

LINES = np.array([[2, 0, 1], [2, 0, 2], [2, 0, 3], [2, 0, 4], [2, 1, 2], [2, 2, 3], [2, 3, 4],
                  [2, 4, 1]])  # fmt: skip


class FrustumLayer(Layer):
    """Lines from the camera through the corners of the image, as far as the membrane."""

    name = "frustum"

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._poly = pv.PolyData(np.zeros((5, 3)), lines=LINES.ravel())
        self._camera: Camera | None = None
        self._far_m = 0.1
        self._drawn_for: object = None
        lines = self.add(self._poly, line_width=1, lighting=False)
        canvas.view.follow_theme(lambda colours: setattr(lines.prop, "color", colours.frustum))

    def set_sensor(self, sensor: Sensor, mesh: MembraneMesh) -> None:
        """Take another camera and its distance to the membrane."""
        self._camera = sensor.camera
        self._far_m = float(np.linalg.norm(mesh.nodes.mean(axis=0) - sensor.camera.position_m))
        self._drawn_for = None

    def draw(self, picture: Picture) -> None:
        """Follow the recording's intrinsics, which win over the sensor's."""
        intrinsics = picture.result.frame.intrinsics
        if self._camera is None or self._drawn_for == (intrinsics or "sensor"):
            return
        self._drawn_for = intrinsics or "sensor"
        self._poly.points[:] = _corners(DepthCamera.of(self._camera, intrinsics), self._far_m)
        self._poly.Modified()


def _corners(camera: DepthCamera, far_m: float) -> np.ndarray:
    """Camera centre and the four corners of its image at a depth, in B."""
    slopes = camera.intrinsics.slopes()[[0, 0, -1, -1], [0, -1, -1, 0]]
    corners = np.column_stack([slopes, np.ones(4)]) * far_m
    return np.vstack([camera.center, corners @ camera.T_B_C[:3, :3].T + camera.center])
