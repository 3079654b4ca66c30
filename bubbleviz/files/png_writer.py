"""Small pictures for reports: an image of numbers as a PNG, with no plotting library."""

from __future__ import annotations

import base64
import struct
import zlib

import numpy as np

_SEQUENTIAL = np.array(
    [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]], float
)
"""Five colours of viridis (Smith and van der Walt, 2015; CC0)."""
_DIVERGING = np.array(
    [[33, 102, 172], [146, 197, 222], [247, 247, 247], [244, 165, 130], [178, 24, 43]], float
)
"""Five colours of RdBu (Brewer, colorbrewer2.org), blue below."""
_NOTHING = np.array([40, 40, 44], np.uint8)


def coloured(
    image: np.ndarray, low: float, high: float, diverging: bool = False, largest: int = 480
) -> np.ndarray:
    """Colours of an image of numbers, (h, w, 3) uint8, thinned to at most `largest` pixels wide.

    Parameters
    ----------
    image : (H, W) array
        NaN is shown dark.
    low, high : float
        Values at the ends of the colours.
    diverging : bool
        Blue, white, red in place of dark to bright.
    """
    step = -(-image.shape[1] // largest)
    image = image[::step, ::step]
    colours = _DIVERGING if diverging else _SEQUENTIAL
    place = np.clip((np.nan_to_num(image) - low) / max(high - low, 1e-300), 0.0, 1.0) * 4.0
    channels = [np.interp(place, np.arange(5.0), colours[:, k]) for k in range(3)]
    shown = np.stack(channels, axis=-1).astype(np.uint8)
    shown[~np.isfinite(image)] = _NOTHING
    return shown


def png(colours: np.ndarray) -> bytes:
    """PNG file of colours (h, w, 3) uint8 (PNG specification, W3C 2003)."""
    height, width, _ = colours.shape
    rows = np.zeros((height, 1 + 3 * width), np.uint8)  # filter type 0 before every row
    rows[:, 1:] = colours.reshape(height, -1)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    parts = [
        b"\x89PNG\r\n\x1a\n",
        _chunk(b"IHDR", header),
        _chunk(b"IDAT", zlib.compress(rows.tobytes(), 6)),
        _chunk(b"IEND", b""),
    ]
    return b"".join(parts)


def data_uri(colours: np.ndarray) -> str:
    """The PNG as text that an HTML page holds in itself."""
    return "data:image/png;base64," + base64.b64encode(png(colours)).decode()


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
