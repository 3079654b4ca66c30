"""^C and SIGTERM as events of Qt's event loop."""

from __future__ import annotations

import signal
import socket
import threading

from PySide6.QtCore import QCoreApplication, QObject, QSocketNotifier

EXIT_CODE = 130
"""What shells report of a program that ^C ended."""
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupt(QObject):
    """Ends the event loop after ^C or SIGTERM, between two events.

    Python runs a signal handler wherever the main thread happens to be. A window that is closed
    while VTK draws takes the OpenGL context away under it, and the process aborts. So the handler
    does nothing; Python writes a byte to a socket, which the event loop reads when it comes to it.
    Signals that are ignored (`nohup`) stay ignored. Does nothing outside the main thread, where
    Python handles no signals.

    Attributes
    ----------
    came : bool
        Whether there was one.
    """

    def __init__(self) -> None:
        super().__init__()
        self.came = False
        self._former: dict[signal.Signals, object] = {}
        handled = [k for k in _SIGNALS if signal.getsignal(k) is not signal.SIG_IGN]
        if not handled or threading.current_thread() is not threading.main_thread():
            return
        self._read, self._write = socket.socketpair()
        self._read.setblocking(False)
        self._write.setblocking(False)
        self._former_fd = signal.set_wakeup_fd(self._write.fileno(), warn_on_full_buffer=False)
        self._former = {number: signal.signal(number, lambda *_: None) for number in handled}
        self._notifier = QSocketNotifier(self._read.fileno(), QSocketNotifier.Type.Read, self)
        self._notifier.activated.connect(self._end)

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

    def _end(self) -> None:
        if not set(self._read.recv(64)) & set(_SIGNALS):
            return  # a signal that somebody else handles
        self.came = True
        application = QCoreApplication.instance()
        if application is not None:
            application.exit(EXIT_CODE)
