"""The depth camera: intrinsics to rays, ray casting, calibrated pixels, residuals by blocks."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
