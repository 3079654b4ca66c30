"""Soft-bubble tactile sensors from Python, without Qt or a screen.

Data flow: source → `Frame` → `Pipeline` → `Result` → window, file, publisher.
Units are SI: m, Pa, N, N/m, s, rad.

    import bubbleviz as bv

    run = bv.estimate(bv.open("press.mcap")[60:90])
    run.table()

Each name imports its modules when it is first used.
"""

import lazy_loader

__version__ = "0.3.0"
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
