"""Depth images as ROS's compressed_depth_image_transport sends them, made with Pillow."""

import io
import struct

import numpy as np
from PIL import Image

Z0_M, FARTHEST_M = 50.0, 10.0
"""The transport's settings: the largest depth, and quantisation of near depth, by default 100, with
which what is nearer than 0.15 m does not fit into 16 bits."""


def compressed(depth_m, encoding):
    """Format and data of the message; NaN: no return."""
    gone = np.isnan(depth_m)
    if encoding == "16UC1":
        a, b, numbers = 0.0, 0.0, np.where(gone, 0.0, 1000.0 * depth_m)
    else:
        a = Z0_M * (Z0_M + 1.0)
        b = 1.0 - a / FARTHEST_M
        numbers = np.where(gone, 0.0, a / np.where(gone, 1.0, depth_m) + b)
    file = io.BytesIO()
    Image.fromarray(np.round(numbers).astype(np.uint16)).save(file, "PNG")
    return f"{encoding}; compressedDepth", struct.pack("<iff", 0, a, b) + file.getvalue()
