"""Point clouds to depth images."""

from __future__ import annotations

from typing import Any

import numpy as np

from bubbleviz.camera.intrinsics import Intrinsics

_FLOATS = {7: "f4", 8: "f8"}
"""numpy type by the datatype of a PointField."""


def decode_cloud(message: Any, camera: Intrinsics | None) -> np.ndarray:
    """z-depth of a `sensor_msgs/PointCloud2` in the camera's optical frame, (H, W) float32, m.

    An organised cloud is an image already. Points without order are put where the camera sees
    them, the nearest one where several meet.

    Raises
    ------
    ValueError
        Fields, size and data do not fit together, or a cloud without order has no camera.
    """
    points = _points(message)
    if int(message.height) > 1:
        z = points[:, 2].reshape(int(message.height), int(message.width)).astype(np.float32)
        z[~((z > 0) & (z < np.inf))] = np.nan
        return z
    if camera is None:
        raise ValueError("a cloud without rows and columns needs the camera info to be an image")
    return project_points(points, camera)


def _points(message: Any) -> np.ndarray:
    """x, y, z of every point, (n, 3)."""
    fields = {field.name: field for field in message.fields}
    if not {"x", "y", "z"} <= fields.keys():
        raise ValueError("the cloud has no fields x, y, z")
    order = ">" if message.is_bigendian else "<"
    kinds = [_FLOATS.get(int(fields[name].datatype)) for name in "xyz"]
    if None in kinds:
        raise ValueError("the cloud's x, y, z are no floating point numbers")
    step, row = int(message.point_step), int(message.row_step)
    height, width = int(message.height), int(message.width)
    if not (height > 0 and width > 0 and 0 < step <= 1024 and width * step <= row):
        raise ValueError(f"a cloud of {height}×{width} points of {step} bytes is not plausible")
    if height * row > len(message.data):
        raise ValueError(f"{len(message.data)} bytes are no cloud of {height}×{width} points")
    layout = np.dtype(
        {
            "names": list("xyz"),
            "formats": [f"{order}{kind}" for kind in kinds],
            "offsets": [int(fields[name].offset) for name in "xyz"],
            "itemsize": step,
        }
    )
    data = np.ascontiguousarray(message.data[: height * row], np.uint8).reshape(height, row)
    table = np.ascontiguousarray(data[:, : width * step]).view(layout).ravel()
    return np.stack([table[name].astype(np.float64) for name in "xyz"], axis=1)


def project_points(points: np.ndarray, camera: Intrinsics) -> np.ndarray:
    """Depth image (H, W) float32 of points (n, 3): the nearest one where several meet, else NaN."""
    depth = np.full((camera.height, camera.width), np.inf, np.float32)
    seen = points[np.isfinite(points).all(axis=1) & (points[:, 2] > 0)]
    column, row = np.rint(camera.project(seen)).T
    inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    where = (row[inside].astype(int), column[inside].astype(int))
    np.minimum.at(depth, where, seen[inside, 2].astype(np.float32))
    depth[np.isinf(depth)] = np.nan
    return depth
