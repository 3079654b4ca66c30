"""Traction with friction and slip as ROS 2 messages."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from bubbleviz.frames.depth_topics import WRENCH
from bubbleviz.frames.message_encoding import make_wrench, ros2_types
from bubbleviz.result import Result, Traction

POINT = "geometry_msgs/msg/PointStamped"
NUMBER = "std_msgs/msg/Float64"


def shear_messages(header: Any, result: Result) -> Iterator[tuple[str, str, Any]]:
    """Name, type and message of what is known of friction in a result; of depth alone, nothing.

    The torque is about B's origin, as transform libraries take it to be; the contact's centre goes
    out beside it. The standard deviation of a wrench is a message like the wrench itself.
    """
    traction, slip = result.traction, result.slip
    if traction is None or result.trusted_estimate is None:
        return
    if traction.status == "no_contact":
        yield "traction_wrench", WRENCH, make_wrench(header, np.zeros(6))
    if traction.status != "ok":
        return
    wrench, sigma = _wrenches(traction)
    yield "traction_wrench", WRENCH, make_wrench(header, wrench)
    yield "traction_wrench_sigma", WRENCH, make_wrench(header, sigma)
    yield "traction_center", POINT, _point(header, traction.center_m)
    if slip is not None:
        number = ros2_types().types[NUMBER]
        yield "slip_share", NUMBER, number(float(slip.share))
        yield "slip_share_sigma", NUMBER, number(float(slip.share_sigma))


def _wrenches(traction: Traction) -> tuple[np.ndarray, np.ndarray]:
    """Force and torque about B's origin, and their standard deviations, (6,) each."""
    origin = np.zeros(3)
    return (
        np.concatenate([traction.force_n, traction.torque_about(origin)]),
        np.concatenate([traction.force_sigma_n, traction.torque_sigma_about(origin)]),
    )


def _point(header: Any, point_m: np.ndarray) -> Any:
    kinds = ros2_types().types
    return kinds[POINT](header, kinds["geometry_msgs/msg/Point"](*(float(c) for c in point_m)))
