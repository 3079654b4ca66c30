"""Pose of an object that touches the membrane: dual-stage registration and tracking."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
