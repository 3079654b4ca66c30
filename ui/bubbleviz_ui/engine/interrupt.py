"""^C and SIGTERM as events of Qt's event loop."""

from __future__ import annotations

import signal
import socket
import threading
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from PySide6.QtCore import QCoreApplication

EXIT_CODE = 130
"""What shells report of a program that ^C ended."""
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupt:
    """Ends the event loop that runs after ^C or SIGTERM, between two events.

    Without one nothing is ended: whoever handles events by a loop of one's own looks at `came`. Qt
    would remember it, and end the loop that runs next.

    Python runs a signal handler wherever the main thread happens to be. An exception in the middle
    of an import of Qt or VTK, or a window that is closed while VTK draws, ends in a crash. So the
    handler only remembers it, from before these are imported on; Python also writes a byte to a
    socket, which wakes the event loop up. Signals that are ignored (`nohup`) stay ignored. Does
    nothing outside the main thread, where Python handles no signals.

    Attributes
    ----------
    came : bool
        Whether there was one.
    """

    def __init__(self) -> None:
        self.came = False
        self._former: dict[signal.Signals, object] = {}
        handled = [k for k in _SIGNALS if signal.getsignal(k) is not signal.SIG_IGN]
        if not handled or threading.current_thread() is not threading.main_thread():
            return
        self._read, self._write = socket.socketpair()
        self._read.setblocking(False)
        self._write.setblocking(False)
        self._former_fd = signal.set_wakeup_fd(self._write.fileno(), warn_on_full_buffer=False)
        self._former = {number: signal.signal(number, self._remember) for number in handled}

    def end(self, application: QCoreApplication) -> None:
        """From now on, end this application's event loop."""
        from PySide6.QtCore import QSocketNotifier  # the handlers are there before Qt is

        if not self._former:
            return
        self._application = application
        self._notifier = QSocketNotifier(self._read.fileno(), QSocketNotifier.Type.Read)
        self._notifier.activated.connect(self._wake)

    def close(self) -> None:
        """Give the signals back to who had them."""
        if not self._former:
            return
        for number, handler in self._former.items():
            signal.signal(number, handler)  # type: ignore[arg-type]
        self._former = {}
        signal.set_wakeup_fd(self._former_fd)
        self._notifier.setEnabled(False)
        self._read.close()
        self._write.close()

    def _remember(self, *_: object) -> None:
        self.came = True

    def _wake(self) -> None:
        self._read.recv(64)  # Python runs the handler before this line
        if self.came and self._application.thread().loopLevel() > 0:
            self._application.exit(EXIT_CODE)
