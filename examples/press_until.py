"""Press with a robot until a force is reached, guarded by every frame of the camera.

    python examples/press_until.py zenoh:tcp/ROBOT:7447 mine.toml

Without a window. The robot is moved by velocity commands that expire, as those of most arms do: if
the camera stops sending, or images are old, nothing renews the command, and the robot stands still.
After a second without an image the robot is also told to stop, and the program ends with the
reason. However it ends, it prints how old the last image was at the stop.
"""

from __future__ import annotations

import sys
from typing import Protocol

import bubbleviz as bv
from bubbleviz.api.results import FrameResult
from bubbleviz.live import LiveStream

SPEED_M_PER_S = 0.005
VALID_S = 0.1  # three frames at 30 Hz
LATEST_S = 0.25  # an older image does not describe the present press; chosen


class Robot(Protocol):
    """Interface of the arm that carries the bubble."""

    def move(self, velocity_m_per_s: float, valid_s: float) -> None:
        """Move along the bubble's axis for at most this long, unless told again."""

    def stop(self) -> None:
        """Stand still."""


class PrintedRobot:
    """Placeholder for the driver of an arm."""

    def move(self, velocity_m_per_s: float, valid_s: float) -> None:
        """Print what an arm would do."""
        print(f"move at {1e3 * velocity_m_per_s:.0f} mm/s for {valid_s} s")

    def stop(self) -> None:
        """Print what an arm would do."""
        print("stop")


def press_until(stream: LiveStream, robot: Robot, force_n: float) -> FrameResult | None:
    """Move while the force is below `force_n`; returns the last frame, None if none came.

    It stops when the upper end of the force's 95 % interval reaches the limit: images of a moving
    membrane are a few frames apart, and the true force may be larger than the estimate. A frame
    without a trusted number also ends it. If the camera stops sending, the robot is stopped, and
    `StreamStoppedError` is raised.
    """
    last = None
    try:
        for last in bv.estimate(stream):
            known = last.status in ("ok", "no_contact")
            known = known and not stream.counters.equal_in_a_row  # a camera that hung
            highest_n = last.force_magnitude_n + last.force_magnitude_half_width_n
            if not (known and highest_n < force_n):  # nor where the interval is not known
                break
            if last.age_s < LATEST_S:
                robot.move(SPEED_M_PER_S, VALID_S)
    finally:
        robot.stop()
        if last is not None:
            print(f"{last}: told to stop {1e3 * last.age_s:.0f} ms after this image was taken")
    return last


if __name__ == "__main__":
    try:
        with bv.connect(sys.argv[1], sensor=sys.argv[2]) as connected:
            press_until(connected, PrintedRobot(), force_n=3.0)
    except bv.InputError as error:
        sys.exit(str(error))
