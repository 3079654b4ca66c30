"""Simulated sensors: presses with ground truth, depth noise, scenes for live streams."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
