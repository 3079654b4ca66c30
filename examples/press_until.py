"""Press with a robot until a force is reached, guarded by every frame of the camera.

    python examples/press_until.py zenoh:tcp/ROBOT:7447 mine.toml

Without a window. The robot is moved by velocity commands that end by themselves, as those of most
arms do: when the camera falls silent nothing renews them, and the robot stands still. Nor does an
image that is old already. After a second without an image the robot is told to stop, too, and the
program ends with the reason. However it ends, it says how old the last image was at the stop.
"""

from __future__ import annotations

import sys
from typing import Protocol

import bubbleviz as bv
from bubbleviz.api.results import FrameResult
from bubbleviz.live import LiveStream

SPEED_M_PER_S = 0.005
VALID_S = 0.1  # three frames at 30 Hz
LATEST_S = 0.25  # an older image says too little of the press now; chosen


class Robot(Protocol):
    """What is asked of the arm that holds the bubble."""

    def move(self, velocity_m_per_s: float, valid_s: float) -> None:
        """Move along the bubble's axis for at most this long, unless told again."""

    def stop(self) -> None:
        """Stand still."""


class PrintedRobot:
    """Stands for the driver of an arm."""

    def move(self, velocity_m_per_s: float, valid_s: float) -> None:
        """Say what an arm would do."""
        print(f"move at {1e3 * velocity_m_per_s:.0f} mm/s for {valid_s} s")

    def stop(self) -> None:
        """Say what an arm would do."""
        print("stop")


def press_until(stream: LiveStream, robot: Robot, force_n: float) -> FrameResult | None:
    """Move on while the force is below `force_n`; the frame that ended it, None if none came.

    It stops when the upper end of the force's 95 % interval reaches the limit: images of a moving
    membrane are a few frames apart, and the true force may be larger than the estimate. A frame
    without a number to trust ends it, too: nobody presses on blindly. When the camera sends no more
    the robot is stopped, and `StreamStoppedError` says so.
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
