"""Solver backend for Soft-bubble tactile sensors: no Qt, runs with no screen.

Data flows one way: source → `Frame` → `Pipeline` → `Result` → window, file, publisher.
Units are SI throughout: m, Pa, N, N/m, s, rad.
"""

__version__ = "0.1.0"
