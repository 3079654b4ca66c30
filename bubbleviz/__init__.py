"""Soft-bubble tactile sensors from Python: no Qt, runs with no screen.

Data flows one way: source → `Frame` → `Pipeline` → `Result` → window, file, publisher.
Units are SI throughout: m, Pa, N, N/m, s, rad.

    import bubbleviz as bv

    run = bv.estimate(bv.open("press.mcap")[60:90])
    run.table()

Importing this loads nothing; each name below loads what it needs when it is first used.
"""

import lazy_loader

__version__ = "0.3.0"
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
