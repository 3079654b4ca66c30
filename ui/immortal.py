"""None and the truth values made as good as immortal, as Python 3.12 and later make them.

The wheels of PySide6 6.12.0 say that they are for Python 3.10 and later, but return None as if it
were immortal: on Python 3.11 every call that returns nothing takes one reference to None away that
nobody added. A window at 30 frames a second uses them up within minutes, and Python aborts with
"deallocating None". PySide6 up to 6.11.3, and 6.12.0 on Python 3.12, do not need this.
"""

from __future__ import annotations

import ctypes
import sys

ENOUGH = 1 << 40
"""References a process cannot use up: a million a second last for twelve days."""


def make_immortal() -> None:
    """Give None, True and False references enough for the life of the process; once is enough."""
    if sys.version_info >= (3, 12) or sys.implementation.name != "cpython":
        return
    for thing in (None, True, False):
        if sys.getrefcount(thing) < ENOUGH:
            ctypes.c_ssize_t.from_address(id(thing)).value += ENOUGH  # ob_refcnt comes first
