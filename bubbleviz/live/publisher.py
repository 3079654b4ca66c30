"""Publish ROS 2 messages over Zenoh, for ROS 2 nodes and the window."""

from __future__ import annotations

import secrets
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import zenoh
from scipy.spatial.transform import Rotation
from zenoh.ext import CacheConfig, MissDetectionConfig, declare_advanced_publisher

from bubbleviz.live.assembler import Counters
from bubbleviz.live.live_stream import LiveStream, Status
from bubbleviz.live.zenoh_session import (
    Attachment,
    Layout,
    SessionOptions,
    announcement,
    open_session,
    pack_attachment,
    publication,
)
from bubbleviz.membrane import MembraneMesh
from bubbleviz.recordings import (
    POINT_CLOUD,
    WRENCH,
    Message,
    are_static_poses,
    make_header,
    make_static_pose,
    make_wrench,
    ros2_types,
    serialise,
)
from bubbleviz.result import Estimate, Patch, Pose, Result

_STATIC_CACHE = 100  # messages of a topic; chosen: robots have a few
_NUMBERED = MissDetectionConfig(heartbeat=None, sporadic_heartbeat=None)
"""Numbers the cached messages; otherwise Zenoh requires time stamps on all messages."""


class ZenohPublisher:
    """Publishes serialised messages, each topic announced with its first one."""

    def __init__(
        self,
        options: SessionOptions,  # where to listen, or the router to publish through
        *,
        layout: Layout = "rmw",  # as `rmw_zenoh` publishes, or as the ROS 2 DDS bridge does
        domain: int = 0,  # ROS_DOMAIN_ID
        # wait for slow subscribers, so that no message is lost; else drop messages
        wait: bool = False,
    ) -> None:
        self._session = open_session(options)
        self._layout, self._domain, self._wait = layout, domain, wait
        self._publishers: dict[tuple[str, str], Any] = {}
        self._tokens: list[Any] = []
        self._sent: dict[tuple[str, str], int] = {}
        self._identity = secrets.token_bytes(16)

    def __enter__(self) -> ZenohPublisher:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def announce(self, topic: str, kind: str) -> None:
        if (topic, kind) in self._publishers:
            return
        type_hash = ros2_types().hash_rihs01(kind)
        control = zenoh.CongestionControl.BLOCK if self._wait else zenoh.CongestionControl.DROP
        key = publication(topic, kind, type_hash, self._layout, self._domain)
        if are_static_poses(topic, kind):  # later subscribers receive them too
            self._publishers[topic, kind] = declare_advanced_publisher(
                self._session,
                key,
                congestion_control=control,
                cache=CacheConfig(_STATIC_CACHE),
                sample_miss_detection=_NUMBERED,
                publisher_detection=True,
            )
        else:
            self._publishers[topic, kind] = self._session.declare_publisher(
                key, congestion_control=control
            )
        number = len(self._publishers)
        session = str(self._session.zid())
        token = announcement(topic, kind, type_hash, self._layout, self._domain, session, number)
        self._tokens.append(self._session.liveliness().declare_token(token))

    def put(self, message: Message) -> None:
        topic, kind = message.topic, message.type
        self.announce(topic, kind)
        sequence = self._sent.get((topic, kind), 0) + 1
        self._sent[topic, kind] = sequence
        stamp = message.stamp_ns or time.time_ns()
        attachment = pack_attachment(Attachment(sequence, stamp, self._identity))
        self._publishers[topic, kind].put(message.payload, attachment=attachment)

    @property
    def subscribed(self) -> int:
        """Number of announced topics that have a subscriber."""
        return sum(
            each.matching_status.matching
            for place, each in self._publishers.items()
            if not are_static_poses(*place)
        )

    def close(self) -> None:
        self._session.close()


# Traction with friction and slip as ROS 2 messages.


POINT = "geometry_msgs/msg/PointStamped"
NUMBER = "std_msgs/msg/Float64"


def shear_messages(header: Any, result: Result) -> Iterator[tuple[str, str, Any]]:
    """Name, type and message of the friction results; none for depth alone.

    The torque is about B's origin, as transform libraries assume; the contact's centre is published
    separately. The standard deviation of a wrench is a message of the same type.
    """
    traction, slip = result.traction, result.slip
    if traction is None or result.trusted_estimate is None:
        return
    if traction.status == "no_contact":
        yield "traction_wrench", WRENCH, make_wrench(header, np.zeros(6))
    if traction.status != "ok":
        return
    origin = np.zeros(3)
    wrench = np.concatenate([traction.force_n, traction.torque_about(origin)])
    sigma = np.concatenate([traction.force_sigma_n, traction.torque_sigma_about(origin)])
    yield "traction_wrench", WRENCH, make_wrench(header, wrench)
    yield "traction_wrench_sigma", WRENCH, make_wrench(header, sigma)
    yield "traction_center", POINT, _point(header, traction.center_m)
    if slip is not None:
        number = ros2_types().types[NUMBER]
        yield "slip_share", NUMBER, number(float(slip.share))
        yield "slip_share_sigma", NUMBER, number(float(slip.share_sigma))


def _point(header: Any, point_m: np.ndarray) -> Any:
    kinds = ros2_types().types
    return kinds[POINT](header, kinds["geometry_msgs/msg/Point"](*(float(c) for c in point_m)))


# Results as ROS 2 messages: patch, force, pose and diagnostics.


POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"

_OK, _WARN, _ERROR, _STALE = 0, 1, 2, 3  # levels of diagnostic_msgs/DiagnosticStatus
_LEVELS = {"ok": _OK, "no_contact": _OK, "no_data": _WARN}
_FLOAT32 = 7  # datatype of sensor_msgs/PointField


class ResultMessages:
    """Makes the messages of results; everything is in the bubble's frame B.

    Topics after the prefix: `contact_patch` (PointCloud2 of the membrane's nodes in the patch,
    deformed, with the contact pressure in Pa), `contact_wrench` (WrenchStamped: the force on the
    membrane, its torque about B's origin), `object_pose` (PoseWithCovarianceStamped, while it is
    found), those of `shear_messages`, `/tf_static` and `/diagnostics`. Of an estimate that is not
    to be trusted only the last, which says why.
    """

    def __init__(
        self,
        mesh: MembraneMesh,  # of the pipeline that makes the results
        prefix: str = "/bubble",  # what the topic names begin with
        frame_id: str = "bubble",  # name of B in the headers
    ) -> None:
        self._mesh, self._prefix, self._frame_id = mesh, prefix.rstrip("/"), frame_id

    def placed(self, stream: LiveStream) -> Iterator[Message]:
        """Pose of B in the frame of reference of a stream's depth images, on `/tf_static`.

        B is the child, as the camera may have a parent on the robot. Nothing where the images name
        no frame, or before the first.
        """
        camera_frame = stream.depth_frame
        if camera_frame not in ("", self._frame_id):
            T_C_B = np.linalg.inv(stream.sensor.camera.T_B_C)
            yield make_static_pose(camera_frame, self._frame_id, T_C_B, time.time_ns())

    def of(self, result: Result) -> Iterator[Message]:
        """Messages of a result, stamped as its frame."""
        stamp = result.frame.stamp_ns
        header = make_header(max(stamp, 0), self._frame_id)
        estimate, patch = result.trusted_estimate, result.trusted_patch
        if estimate is not None and patch is not None:
            cloud = self._patch(header, estimate, patch)
            yield self._message("contact_patch", POINT_CLOUD, cloud, stamp)
            wrench = make_wrench(header, _wrench(patch))
            yield self._message("contact_wrench", WRENCH, wrench, stamp)
        if result.pose is not None and result.pose.status == "ok":  # a stale pose is not published
            yield self._message("object_pose", POSE, _pose(header, result.pose), stamp)
        for name, kind, message in shear_messages(header, result):
            yield self._message(name, kind, message, stamp)

    def diagnostics(
        self, now_ns: int, status: Status, counters: Counters, result: Result | None
    ) -> Message:
        """State of the source and of the estimate."""
        kinds = ros2_types().types
        entry, pair = (
            kinds["diagnostic_msgs/msg/DiagnosticStatus"],
            kinds["diagnostic_msgs/msg/KeyValue"],
        )
        estimate = None if result is None else result.estimate
        values = {name: str(value) for name, value in counters.as_dict().items()}
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

    def _message(self, name: str, kind: str, message: Any, stamp: int) -> Message:
        return Message(f"{self._prefix}/{name}", kind, serialise(message, kind), stamp)

    def _patch(self, header: Any, estimate: Estimate, patch: Patch) -> Any:
        """Deformed nodes of the patch: x, y, z, pressure, as float32."""
        inside = patch.node_mask
        points = self._mesh.deformed(estimate.motion_m)[inside]
        table = np.column_stack([points, estimate.contact_pressure_pa[inside]]).astype("<f4")
        field = ros2_types().types["sensor_msgs/msg/PointField"]
        names = ("x", "y", "z", "pressure")
        return ros2_types().types[POINT_CLOUD](
            header=header,
            height=1,
            width=len(table),
            fields=[field(name, 4 * k, _FLOAT32, 1) for k, name in enumerate(names)],
            is_bigendian=False,
            point_step=16,
            row_step=16 * len(table),
            data=np.ascontiguousarray(table).view(np.uint8).reshape(-1),
            is_dense=True,
        )


def _wrench(patch: Patch) -> np.ndarray:
    """Force of the patch and its torque about B's origin, (6,); zero without contact."""
    center = patch.center_of_pressure_m
    torque = np.zeros(3)
    if np.isfinite(center).all():
        torque = patch.torque_nm + np.cross(center, patch.force_n)
    return np.concatenate([patch.force_n, torque])


def _pose(header: Any, pose: Pose) -> Any:
    kinds, T_B_O = ros2_types().types, pose.T_B_O
    point, quaternion = kinds["geometry_msgs/msg/Point"], kinds["geometry_msgs/msg/Quaternion"]
    x, y, z, w = (float(q) for q in Rotation.from_matrix(T_B_O[:3, :3]).as_quat())
    place = point(*(float(p) for p in T_B_O[:3, 3]))
    found = kinds["geometry_msgs/msg/Pose"](place, quaternion(x, y, z, w))
    covariance = np.ascontiguousarray(pose.origin_covariance.ravel())
    return kinds[POSE](header, kinds["geometry_msgs/msg/PoseWithCovariance"](found, covariance))


def _level(status: Status, estimate: Estimate | None) -> tuple[int, str]:
    if status.state == "connecting":
        return _WARN, status.text
    if status.state != "live":
        return _STALE, status.text
    if estimate is None:
        return _OK, status.text
    text = f"{estimate.status}: {estimate.reason}" if estimate.reason else estimate.status
    return _LEVELS.get(estimate.status, _ERROR), text
