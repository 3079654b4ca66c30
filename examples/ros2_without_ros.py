"""ROS 2 messages in and out over Zenoh, with no ROS on this computer.

    python examples/ros2_without_ros.py zenoh:tcp/ROBOT:7447 mine.toml tcp/ROBOT:7447

Depth images, camera info and gas pressure come in; force and contact patch go out as
`/bubbleviz/contact_wrench` and `/bubbleviz/contact_patch`, which `ros2 topic echo` shows on the
robot (with `rmw_zenoh`, or its Zenoh bridge). `bubbleviz watch --connect` does that and more.
"""

from __future__ import annotations

import sys

import bubbleviz as bv
from bubbleviz.live import LiveStream, ResultMessages, SessionOptions, ZenohPublisher


def publish_results(stream: LiveStream, out: ZenohPublisher, prefix: str = "/bubbleviz/") -> int:
    """Estimate every newest frame and publish what was found; count of frames."""
    messages, count = None, 0
    for found in bv.estimate(stream):
        count += 1
        messages = messages or ResultMessages(found.model.mesh, prefix)
        for message in messages.of(found.result, out.is_subscribed):
            out.put(message)
    return count


if __name__ == "__main__":
    source, sensor, router = sys.argv[1:]
    place = SessionOptions("the robot's router", connect=router)
    with bv.connect(source, sensor) as connected, ZenohPublisher(place) as publisher:
        publish_results(connected, publisher)
