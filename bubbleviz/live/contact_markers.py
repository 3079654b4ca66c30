"""Contact and object as `visualization_msgs/MarkerArray`, for RViz, Foxglove and Rerun."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from bubbleviz.live.live_stream import STALE_AFTER_S
from bubbleviz.membrane import MembraneMesh, level_line
from bubbleviz.recordings import make_pose, ros2_types
from bubbleviz.result import Estimate, Patch, Pose, Result
from bubbleviz.rigid_object import RigidObject, merged

CONTACT_MARKERS = "visualization_msgs/msg/MarkerArray"
METRES_PER_NEWTON = 0.01
"""Length of the force arrow."""

_MOST_TRIANGLES = 1000  # of the object, in every message: 72 kB
_WHITE, _RED, _ORANGE = (1.0, 1.0, 1.0, 1.0), (1.0, 0.0, 0.0, 1.0), (1.0, 0.6, 0.0, 1.0)
_GREY = (0.7, 0.7, 0.7, 0.5)
_LINE_M, _SHAFT_M, _HEAD_M, _TEXT_M = 0.0005, 0.002, 0.004, 0.006  # widths, and height of letters


class ContactMarkers:
    """Makes the markers of results: outline, force, object; a text of an untrusted estimate.

    Every message deletes the markers of the one before, and they expire when the stream is stale.
    """

    def __init__(self, mesh: MembraneMesh, obj: RigidObject | None = None) -> None:
        self._mesh, self._object_points = mesh, list[Any]()
        if obj is not None:
            shown = merged(obj, _MOST_TRIANGLES)
            self._object_points = _points(shown.vertices[shown.triangles])

    def of(self, header: Any, result: Result) -> Any:
        kinds = ros2_types().types
        return kinds[CONTACT_MARKERS](
            [_marker(header, action="DELETEALL"), *self._of(header, result)]
        )

    def _of(self, header: Any, result: Result) -> Iterator[Any]:
        estimate, patch = result.solution
        if not estimate.trusted:
            yield self._text(header, estimate)
        elif patch.area_m2 > 0.0:
            yield self._outline(header, estimate, patch)
            yield _force(header, patch)
        if result.pose is not None and result.pose.status == "ok" and self._object_points:
            yield self._object(header, result.pose)

    def _text(self, header: Any, estimate: Estimate) -> Any:
        above = np.eye(4)
        above[2, 3] = self._mesh.nodes[:, 2].max() + 2.0 * _TEXT_M
        return _marker(
            header, "status", "TEXT_VIEW_FACING", _ORANGE, (0.0, 0.0, _TEXT_M),
            pose=make_pose(above), text=estimate.status_text,
        )  # fmt: skip

    def _outline(self, header: Any, estimate: Estimate, patch: Patch) -> Any:
        mesh, finest, level = patch.finest(self._mesh, estimate)
        pieces = level_line(mesh.deformed(finest.motion_m), mesh.corners, level)
        size = (_LINE_M, 0.0, 0.0)
        return _marker(header, "patch", "LINE_LIST", _WHITE, size, points=_points(pieces))

    def _object(self, header: Any, pose: Pose) -> Any:
        place, points = make_pose(pose.T_B_O), self._object_points
        return _marker(header, "object", "TRIANGLE_LIST", _GREY, pose=place, points=points)


def _force(header: Any, patch: Patch) -> Any:
    """Arrow that ends at the centre of pressure."""
    tip = patch.center_of_pressure_m
    ends = np.stack([tip - METRES_PER_NEWTON * patch.force_n, tip])
    size = (_SHAFT_M, _HEAD_M, 0.0)  # 0: a head of RViz's usual length
    return _marker(header, "force", "ARROW", _RED, size, points=_points(ends))


def _points(places_m: np.ndarray) -> list[Any]:
    point = ros2_types().types["geometry_msgs/msg/Point"]
    return [point(*place) for place in places_m.reshape(-1, 3).tolist()]


def _marker(
    header: Any,
    name: str = "",
    shape: str = "ARROW",
    colour: tuple[float, ...] = _WHITE,
    size: tuple[float, float, float] = (1.0, 1.0, 1.0),
    *,
    action: str = "ADD",
    pose: Any = None,
    points: list[Any] | None = None,
    text: str = "",
) -> Any:
    kinds, none = ros2_types().types, np.zeros(0, np.uint8)
    marker = kinds["visualization_msgs/msg/Marker"]
    lifetime = divmod(round(1e9 * STALE_AFTER_S), 1_000_000_000)
    return marker(
        header=header,
        ns=name,
        id=0,
        type=getattr(marker, shape),
        action=getattr(marker, action),
        pose=pose or make_pose(np.eye(4)),
        scale=kinds["geometry_msgs/msg/Vector3"](*size),
        color=kinds["std_msgs/msg/ColorRGBA"](*colour),
        lifetime=kinds["builtin_interfaces/msg/Duration"](*lifetime),
        frame_locked=False,
        points=points or [],
        colors=[],
        texture_resource="",
        texture=kinds["sensor_msgs/msg/CompressedImage"](header, "", none),
        uv_coordinates=[],
        text=text,
        mesh_resource="",
        mesh_file=kinds["visualization_msgs/msg/MeshFile"]("", none),
        mesh_use_embedded_materials=False,
    )
