"""Bags with colour images, written with rosbags alone, and images that another library encoded."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from PIL import Image
from rosbags.typesys import get_types_from_msg

from tests.recordings.bagmaker import BagMaker

COLOUR = "/cam/color/image_raw"
TRANSFORMS = "tf2_msgs/msg/TFMessage"


def picture(k: int, height: int = 24, width: int = 32) -> np.ndarray:
    """Smooth colours of image k, (H, W, 3) uint8: smooth, so that a JPEG keeps them."""
    v, u = np.mgrid[:height, :width]
    return np.dstack([4 * u + k, 5 * v + 2 * k, 100 + u + v]).astype(np.uint8)


def add_colour(
    bag: BagMaker, stamp: int, k: int, topic: str = COLOUR, log: int = 0, **changes: Any
) -> None:
    """Image k, raw."""
    rgb = picture(k)
    step = rgb.shape[1] * 3
    bag.image(stamp, rgb, "rgb8", topic=topic, log=log or stamp, step=step, **changes)


def encoded(rgb: np.ndarray, kind: str) -> bytes:
    """JPEG or PNG file of an image."""
    file = io.BytesIO()
    Image.fromarray(rgb).save(file, kind.upper(), quality=98)
    return file.getvalue()


def add_compressed(
    bag: BagMaker, stamp: int, data: bytes, said: str, topic: str = COLOUR, header: Any = None
) -> None:
    """A compressed image, `said` to be of a format."""
    fields: dict[str, Any] = {
        "header": header or bag.header(stamp),
        "format": said,
        "data": np.frombuffer(data, np.uint8),
    }
    bag.add(f"{topic}/compressed", "sensor_msgs/msg/CompressedImage", stamp, **fields)


def add_pose(
    bag: BagMaker,
    parent: str,
    child: str,
    position_m: tuple[float, float, float],
    quaternion_xyzw: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0),
) -> None:
    """A static transform, T_parent_child."""
    if bag.ros1:  # rosbags' list lacks it
        text = "geometry_msgs/TransformStamped[] transforms"
        bag.store.register(get_types_from_msg(text, TRANSFORMS))
    types = bag.store.types
    transform = types["geometry_msgs/msg/Transform"](
        types["geometry_msgs/msg/Vector3"](*position_m),
        types["geometry_msgs/msg/Quaternion"](*quaternion_xyzw),
    )
    header = bag.header(1)
    header.frame_id = parent
    stamped = types["geometry_msgs/msg/TransformStamped"](header, child, transform)
    bag.add("/tf_static", TRANSFORMS, 1, transforms=[stamped])
