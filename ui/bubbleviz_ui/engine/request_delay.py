"""How long to wait before the next request, so that no result waits for the window."""

from __future__ import annotations

SLACK_S = 0.004
"""How long a result may wait for the window: a little, so that the window does not wait for it."""
GAIN = 0.4  # of the delay's integral control; chosen
MOST_S = 0.1  # s; longer delays are felt


class RequestDelay:
    """Delays requests while the window draws: a frame taken too early would be old by then.

    Attributes
    ----------
    hold_s : float
        How long after the last result the next frame is to be taken.
    """

    def __init__(self) -> None:
        self.hold_s = 0.0

    def waited(self, seconds: float) -> None:
        """Take note of how long a result waited for the window."""
        self.hold_s = min(max(self.hold_s + GAIN * (seconds - SLACK_S), 0.0), MOST_S)
