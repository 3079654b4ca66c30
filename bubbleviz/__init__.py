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
    from bubbleviz.api.batching import batch
    from bubbleviz.api.connecting import connect, publish, record
    from bubbleviz.api.estimating import estimate, register, track
    from bubbleviz.api.exporting import convert, export
    from bubbleviz.api.frames import info, open
    from bubbleviz.api.identifying import identify
    from bubbleviz.api.simulating import simulate
    from bubbleviz.api.watching import watch
    from bubbleviz.errors import InputError
    from bubbleviz.sensor import load_sensor, save_sensor

__version__ = "0.2.0"
_PLACES = {
    "InputError": "errors",
    "batch": "api.batching",
    "connect": "api.connecting",
    "convert": "api.converting",
    "estimate": "api.estimating",
    "export": "api.exporting",
    "identify": "api.identifying",
    "info": "api.frames",
    "load_sensor": "sensor",
    "open": "api.frames",
    "publish": "api.recording",
    "record": "api.recording",
    "register": "api.estimating",
    "save_sensor": "sensor",
    "simulate": "api.simulating",
    "track": "api.estimating",
    "watch": "api.watching",
}
__all__ = [
    "InputError",
    "batch",
    "connect",
    "convert",
    "estimate",
    "export",
    "identify",
    "info",
    "load_sensor",
    "open",
    "publish",
    "record",
    "register",
    "save_sensor",
    "simulate",
    "track",
    "watch",
]


if not TYPE_CHECKING:  # else a misspelt name would be of any type

    def __getattr__(name: str) -> Any:
        if name not in _PLACES:
            raise AttributeError(f"module 'bubbleviz' has no attribute {name!r}")
        module = import_module(f"bubbleviz.{_PLACES[name]}")
        found = globals()[name] = getattr(module, name)
        return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
