"""Soft-bubble tactile sensors from Python: no Qt, runs with no screen.

Data flows one way: source → `Frame` → `Pipeline` → `Result` → window, file, publisher.
Units are SI throughout: m, Pa, N, N/m, s, rad.

    import bubbleviz as bv

    run = bv.estimate(bv.open("press.mcap")[60:90])
    run.table()

Importing this loads nothing; each name below loads what it needs when it is first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bubbleviz.api.chosen_frames import open
    from bubbleviz.api.connecting import connect
    from bubbleviz.api.identifying import identify
    from bubbleviz.api.simulating import simulate
    from bubbleviz.api.solving import estimate, register, track
    from bubbleviz.errors import InputError
    from bubbleviz.sensor import load_sensor, save_sensor

__version__ = "0.2.0"
__all__ = [
    "InputError",
    "connect",
    "estimate",
    "identify",
    "load_sensor",
    "open",
    "register",
    "save_sensor",
    "simulate",
    "track",
]

_PLACES = {
    "InputError": "bubbleviz.errors",
    "connect": "bubbleviz.api.connecting",
    "estimate": "bubbleviz.api.solving",
    "identify": "bubbleviz.api.identifying",
    "load_sensor": "bubbleviz.sensor",
    "open": "bubbleviz.api.chosen_frames",
    "register": "bubbleviz.api.solving",
    "save_sensor": "bubbleviz.sensor",
    "simulate": "bubbleviz.api.simulating",
    "track": "bubbleviz.api.solving",
}


if not TYPE_CHECKING:  # else a misspelt name would be of any type

    def __getattr__(name: str) -> Any:
        if name not in _PLACES:
            raise AttributeError(f"module 'bubbleviz' has no attribute {name!r}")
        found = globals()[name] = getattr(import_module(_PLACES[name]), name)
        return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
