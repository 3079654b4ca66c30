"""Frames of recordings: bags, MCAP, folders of images; read, written, put in order by time."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
