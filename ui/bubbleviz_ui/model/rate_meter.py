"""How often something happens, counted over the last second."""

from __future__ import annotations

from collections import deque


class RateMeter:
    """Events per second over a sliding window.

    Parameters
    ----------
    window_s : float
        Length of the window, s.
    """

    def __init__(self, window_s: float = 1.0) -> None:
        self._window_s = window_s
        self._times: deque[float] = deque()

    def tick(self, now_s: float) -> None:
        """Note one event."""
        self._times.append(now_s)

    def rate_hz(self, now_s: float) -> float:
        """Events per second in the window that ends now."""
        while self._times and self._times[0] < now_s - self._window_s:
            self._times.popleft()
        return len(self._times) / self._window_s
