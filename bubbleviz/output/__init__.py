"""Frames of a recording as tables, meshes, point clouds, pictures and videos for other programs."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
