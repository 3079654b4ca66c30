"""Garbage is looked for in the GUI thread only: another one may not delete Qt objects found in it.

Qt may be handing an event to such an object while it waits for Python, and crashes.
"""

from __future__ import annotations

import gc

from PySide6.QtCore import QCoreApplication, QObject, QTimer

EVERY_MS = 50


class GarbageCollector(QObject):
    """Does what Python would do in whichever thread makes an object, as often as Python would.

    Parameters
    ----------
    application : QCoreApplication
        Keeps the collector; garbage stays where its event loop does not run.
    """

    def __init__(self, application: QCoreApplication) -> None:
        super().__init__(application)
        gc.disable()
        timer = QTimer(self)
        timer.timeout.connect(_collect)
        timer.start(EVERY_MS)


def _collect() -> None:
    """Collect the oldest generation that is due, and the younger ones with it."""
    for generation in (2, 1, 0):
        if gc.get_count()[generation] > gc.get_threshold()[generation]:
            gc.collect(generation)
            return
