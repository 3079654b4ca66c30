"""The solver thread: takes the latest request, hands answers to the GUI thread by a signal."""

from __future__ import annotations

from threading import Thread

from PySide6.QtCore import QCoreApplication, QObject, Qt, Signal

from bubbleviz_ui.engine.jobs import PATIENCE_S
from bubbleviz_ui.engine.requests import Answer, FrameRequest, Request, RequestSlots
from bubbleviz_ui.engine.solver_server import Server


class Worker(QObject):
    """Runs a `Server` in a thread of its own; the window never waits for it.

    Attributes
    ----------
    answered : Signal
        Emitted in the GUI thread with each `Answer`.
    dropped : int
        Frame requests replaced by a newer one before the solver got to them.
    """

    answered = Signal(object)
    _ready = Signal(object)

    def __init__(self, server: Server | None = None) -> None:
        super().__init__()
        self.dropped = 0
        self._slots = RequestSlots()
        self._server = server or Server()
        self._ready.connect(self._hand_over, Qt.ConnectionType.QueuedConnection)
        self._closed = False
        self._thread = Thread(target=self._run, name="solver", daemon=True)
        self._thread.start()

    @property
    def counts(self) -> dict[str, int]:
        """How often each stage has run for the open source."""
        return self._server.counts

    def ask(self, request: Request) -> None:
        """Ask for something; an unserved request of the same kind is forgotten."""
        replaced = self._slots.put(request)
        self.dropped += isinstance(replaced, FrameRequest)
        if self._slots.goes_before_newest(request):
            self._server.wait_no_longer()

    def close(self, timeout_s: float = PATIENCE_S) -> None:
        """Stop the thread once it is through with what it is doing."""
        self._closed = True
        self._slots.close()
        self.wait(timeout_s)

    @property
    def running(self) -> bool:
        """Whether the thread has not ended yet."""
        return self._thread.is_alive()

    def wait(self, timeout_s: float = PATIENCE_S) -> None:
        """Wait for the thread to end after `close`.

        A process that ends before its threads frees what they work with: SciPy's factorisations
        then fail, and the exit code is lost (scipy#25404).
        """
        self._thread.join(timeout_s)
        if self.running:  # or it would be the last to hold this object, and delete it there
            self.setParent(QCoreApplication.instance())

    def _run(self) -> None:
        while (request := self._slots.take()) is not None:
            answer = self._server.serve(request)
            if answer is not None and not self._closed:
                self._ready.emit(answer)
        self._server.close()

    def _hand_over(self, answer: Answer) -> None:
        if not self._closed:
            self.answered.emit(answer)
