"""Results as ROS 2 messages: membrane, patch, force, pose, markers and diagnostics."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bubbleviz.live.assembler import Counters
from bubbleviz.live.contact_markers import CONTACT_MARKERS, ContactMarkers
from bubbleviz.live.live_stream import LiveStream, Status
from bubbleviz.membrane import MembraneMesh
from bubbleviz.recordings import (
    POINT_CLOUD,
    RESULTS,
    WRENCH,
    Message,
    make_header,
    make_pose,
    make_static_pose,
    make_wrench,
    ros2_types,
    serialise,
)
from bubbleviz.result import Estimate, Result
from bubbleviz.rigid_object import RigidObject
from bubbleviz.sensor_model import SensorModel

if TYPE_CHECKING:
    from bubbleviz.pipeline import Pipeline

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
POINT = "geometry_msgs/msg/PointStamped"
NUMBER = "std_msgs/msg/Float64"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"

_DIAGNOSTICS_S = 1.0  # period, as usual in ROS
_OK, _WARN, _ERROR, _STALE = 0, 1, 2, 3  # levels of diagnostic_msgs/DiagnosticStatus
_LEVELS = {"ok": _OK, "no_contact": _OK, "no_data": _WARN}
_UINT8, _FLOAT32 = 2, 7  # datatypes of sensor_msgs/PointField


class ResultMessages:
    """Makes the messages of results; everything is in the bubble's frame B.

    Topics are the prefix and a name of `RESULT_TOPICS`, `/tf_static` and `/diagnostics`. There are
    no numbers for an untrusted estimate: the membrane has no pressure, and markers and diagnostics
    say why.
    """

    def __init__(
        self,
        mesh: MembraneMesh,  # of the pipeline that makes the results
        prefix: str = "/bubble",  # prefix of the topics
        frame_id: str = "bubble",  # name of B in the headers
        obj: RigidObject | None = None,  # that is tracked
        model: SensorModel | None = None,  # for the residuals of the nodes; None: unknown
    ) -> None:
        self.mesh, self.model, self.markers = mesh, model, ContactMarkers(mesh, obj)
        self._prefix, self._frame_id = prefix.rstrip("/"), frame_id

    def placed(self, stream: LiveStream) -> Iterator[Message]:
        """Pose of B in the frame of reference of a stream's depth images, on `/tf_static`.

        B is the child, as the camera may have a parent on the robot. Nothing where the images name
        no frame, or before the first.
        """
        camera_frame = stream.depth_frame
        if camera_frame not in ("", self._frame_id):
            T_C_B = np.linalg.inv(stream.sensor.camera.T_B_C)
            yield make_static_pose(camera_frame, self._frame_id, T_C_B, time.time_ns())

    def of(
        self, result: Result, is_wanted: Callable[[str, str], bool] = lambda topic, kind: True
    ) -> Iterator[Message]:
        """Messages of a result, stamped as its frame.

        `is_wanted(topic, type)` decides before a message is made.
        """
        stamp = result.frame.stamp_ns
        header = make_header(max(stamp, 0), self._frame_id)
        for name, (kind, product, make) in RESULT_TOPICS.items():
            topic = f"{self._prefix}/{name}"
            if getattr(result, product) is None or not is_wanted(topic, kind):
                continue
            if (content := make(self, header, result)) is not None:
                yield Message(topic, kind, serialise(content, kind), stamp)

    def diagnostics(
        self, now_ns: int, status: Status, counters: Counters, result: Result | None
    ) -> Message:
        """State of the source and of the estimate."""
        kinds = ros2_types().types
        entry, pair = (kinds[f"diagnostic_msgs/msg/{n}"] for n in ("DiagnosticStatus", "KeyValue"))
        estimate = None if result is None else result.estimate
        values = {name: str(value) for name, value in asdict(counters).items()}
        if estimate is not None and result is not None:
            values["residual_rms_m"] = f"{estimate.residual_rms_m:.3g}"
            values["total_ms"] = f"{result.times_ms.get('total', np.nan):.3g}"
        if result is not None and (traction := result.traction) is not None:
            values["traction"] = ": ".join(filter(None, (traction.status, traction.reason)))
        level, text = _level(status, estimate)
        body = entry(
            level=level,
            name=f"{self._prefix.strip('/')}: contact",
            message=text,
            hardware_id=self._frame_id,
            values=[pair(key=key, value=value) for key, value in values.items()],
        )
        message = kinds[DIAGNOSTICS](make_header(now_ns, ""), [body])
        return Message("/diagnostics", DIAGNOSTICS, serialise(message, DIAGNOSTICS), now_ns)


class ResultSender:
    """Sends the results of a stream as messages, and once a second their diagnostics."""

    def __init__(
        self,
        stream: LiveStream,
        send: Callable[[Message], None],
        is_wanted: Callable[[str, str], bool],  # As in `ResultMessages.of`
        name: str = "",  # Of one of two sensors: part of the topics, and the frame id
    ) -> None:
        self._stream, self._send, self._is_wanted, self._name = stream, send, is_wanted, name
        self._messages: ResultMessages | None = None
        self._object: RigidObject | None = None
        self._last: Result | None = None
        self._last_s = 0.0

    def __call__(self, result: Result, pipeline: Pipeline) -> None:
        """Send a result; after a change of pipeline or object first the pose of the sensor."""
        mesh, obj = pipeline.mesh, pipeline.object
        if self._messages is None or self._messages.mesh is not mesh or self._object is not obj:
            self._object = obj
            frame_id = self._name or "bubble"
            prefix, model = f"{RESULTS}{self._name}", pipeline.model
            self._messages = ResultMessages(mesh, prefix, frame_id, obj, model)
            for message in self._messages.placed(self._stream):
                self._send(message)
        self._last = result
        for message in self._messages.of(result, self._is_wanted):
            self._send(message)

    def diagnose(self) -> bool:
        """Send the diagnostics if they are due; returns whether they were."""
        now = time.monotonic()
        due = self._messages is not None and now - self._last_s >= _DIAGNOSTICS_S
        if self._messages is not None and due:
            self._last_s = now
            status, counters = self._stream.status(), self._stream.counters
            self._send(self._messages.diagnostics(time.time_ns(), status, counters, self._last))
        return due


def _level(status: Status, estimate: Estimate | None) -> tuple[int, str]:
    if status.state == "connecting":
        return _WARN, status.text
    if status.state != "live":
        return _STALE, status.text
    if estimate is None:
        return _OK, status.text
    return _LEVELS.get(estimate.status, _ERROR), estimate.status_text


def _membrane(messages: ResultMessages, header: Any, result: Result) -> Any:
    """All nodes; for an untrusted estimate at rest, with NaN pressure."""
    mesh = messages.mesh
    unknown = np.full(len(mesh.nodes), np.nan)
    if (trusted := result.trusted_estimate) is None:
        return _cloud(header, mesh.nodes, unknown, unknown, np.zeros(len(unknown), bool))
    model, motion, depth = messages.model, trusted.motion_m, result.frame.depth_m
    residual = unknown if model is None else model.node_residuals(depth, trusted)
    x, inside = mesh.deformed(motion), result.solution[1].node_mask
    return _cloud(header, x, trusted.contact_pressure_pa, residual, inside)


def _patch(messages: ResultMessages, header: Any, result: Result) -> Any:
    estimate, patch = result.solution
    if not estimate.trusted:
        return None
    inside = patch.node_mask
    points = messages.mesh.deformed(estimate.motion_m)[inside]
    return _cloud(header, points, estimate.contact_pressure_pa[inside])


def _cloud(
    header: Any,
    points: np.ndarray,
    pressure_pa: np.ndarray,
    residual_m: np.ndarray | None = None,
    inside: np.ndarray | None = None,
) -> Any:
    """x, y, z, pressure and residual as float32, and whether in the patch as uint8."""
    columns = {"x": points[:, 0], "y": points[:, 1], "z": points[:, 2], "pressure": pressure_pa}
    if residual_m is not None:
        columns["residual"] = residual_m
    kinds = dict.fromkeys(columns, "<f4")
    if inside is not None:
        columns["in_patch"], kinds["in_patch"] = inside, "u1"
    table = np.zeros(len(points), np.dtype(list(kinds.items()), align=True))
    for name, values in columns.items():
        table[name] = values
    field, size = ros2_types().types["sensor_msgs/msg/PointField"], table.itemsize
    return ros2_types().types[POINT_CLOUD](
        header=header,
        height=1,
        width=len(table),
        fields=[
            field(name, 4 * k, _UINT8 if kind == "u1" else _FLOAT32, 1)
            for k, (name, kind) in enumerate(kinds.items())
        ],
        is_bigendian=False,
        point_step=size,
        row_step=size * len(table),
        data=table.view(np.uint8).reshape(-1),
        is_dense=all(np.isfinite(column).all() for column in columns.values()),
    )


def _wrench(_: ResultMessages, header: Any, result: Result) -> Any:
    """Force of the patch and its torque about B's origin; zero without contact."""
    patch = result.trusted_patch
    if patch is None:
        return None
    center, torque = patch.center_of_pressure_m, np.zeros(3)
    if np.isfinite(center).all():
        torque = patch.torque_nm + np.cross(center, patch.force_n)
    return make_wrench(header, np.concatenate([patch.force_n, torque]))


def _wrench_sigma(_: ResultMessages, header: Any, result: Result) -> Any:
    estimate = result.trusted_estimate
    if estimate is None or estimate.force_sigma_n is None:
        return None
    torque = estimate.torque_sigma_about(np.zeros(3))
    return make_wrench(header, np.concatenate([estimate.force_sigma_n, torque]))


def _object_pose(_: ResultMessages, header: Any, result: Result) -> Any:
    pose, kinds = result.pose, ros2_types().types
    if pose is None or pose.status != "ok":  # a stale pose is not published
        return None
    covariance = np.ascontiguousarray(pose.covariance.ravel())
    body = kinds["geometry_msgs/msg/PoseWithCovariance"](make_pose(pose.T_B_O), covariance)
    return kinds[POSE](header, body)


def _by_colour(result: Result) -> bool:
    """Whether colour took part in the force."""
    traction = result.traction
    return traction is not None and traction.status == "ok" and result.trusted_estimate is not None


def _traction_wrench(messages: ResultMessages, header: Any, result: Result) -> Any:
    """The wrench, where colour took part in it or there is no contact."""
    untouched = result.traction is not None and result.traction.status == "no_contact"
    return _wrench(messages, header, result) if untouched or _by_colour(result) else None


def _traction_sigma(messages: ResultMessages, header: Any, result: Result) -> Any:
    return _wrench_sigma(messages, header, result) if _by_colour(result) else None


def _traction_center(_: ResultMessages, header: Any, result: Result) -> Any:
    patch = result.trusted_patch
    if patch is None or not _by_colour(result):
        return None
    center = ros2_types().types["geometry_msgs/msg/Point"](*patch.center_of_pressure_m.tolist())
    return ros2_types().types[POINT](header, center)


def _slip(name: str, _: ResultMessages, header: Any, result: Result) -> Any:
    """A number of the slip, by the name of its field."""
    if result.slip is None or not _by_colour(result):
        return None
    return ros2_types().types[NUMBER](float(getattr(result.slip, name)))


class ResultTopic(NamedTuple):
    """Type of a topic, field of `Result` that it needs, and function that makes its message."""

    type: str
    product: str
    make: Callable[[ResultMessages, Any, Result], Any]


RESULT_TOPICS = {
    "membrane": ResultTopic(POINT_CLOUD, "patch", _membrane),
    "contact_patch": ResultTopic(POINT_CLOUD, "patch", _patch),
    "contact_wrench": ResultTopic(WRENCH, "patch", _wrench),
    "contact_wrench_sigma": ResultTopic(WRENCH, "patch", _wrench_sigma),
    "contact_markers": ResultTopic(CONTACT_MARKERS, "patch", lambda own, *of: own.markers.of(*of)),
    "object_pose": ResultTopic(POSE, "pose", _object_pose),
    "traction_wrench": ResultTopic(WRENCH, "traction", _traction_wrench),
    "traction_wrench_sigma": ResultTopic(WRENCH, "traction", _traction_sigma),
    "traction_center": ResultTopic(POINT, "traction", _traction_center),
    "slip_share": ResultTopic(NUMBER, "slip", partial(_slip, "share")),
    "slip_share_sigma": ResultTopic(NUMBER, "slip", partial(_slip, "share_sigma")),
}
"""Topics by name after the prefix."""
