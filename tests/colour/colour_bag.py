"""Bags with colour images, written with rosbags alone, and images that another library encoded."""

import io
from typing import Any

import numpy as np
from PIL import Image
from rosbags.typesys import get_types_from_msg

COLOUR = "/cam/color/image_raw"
TRANSFORMS = "tf2_msgs/msg/TFMessage"


def picture(k, height=24, width=32):
    """Smooth colours of image k, (H, W, 3) uint8: smooth, so that a JPEG keeps them."""
    v, u = np.mgrid[:height, :width]
    return np.dstack([4 * u + k, 5 * v + 2 * k, 100 + u + v]).astype(np.uint8)


def add_colour(bag, stamp, k, topic=COLOUR, log=0, **changes):
    """Image k, raw."""
    rgb = picture(k)
    step = rgb.shape[1] * 3
    bag.image(stamp, rgb, "rgb8", topic=topic, log=log or stamp, step=step, **changes)


def encoded(rgb, kind):
    """JPEG or PNG file of an image."""
    file = io.BytesIO()
    Image.fromarray(rgb).save(file, kind.upper(), quality=98)
    return file.getvalue()


def add_compressed(bag, stamp, data, said, topic=COLOUR, header=None):
    """A compressed image whose declared format is `said`."""
    fields: dict[str, Any] = {
        "header": header or bag.header(stamp),
        "format": said,
        "data": np.frombuffer(data, np.uint8),
    }
    bag.add(f"{topic}/compressed", "sensor_msgs/msg/CompressedImage", stamp, **fields)


def add_pose(bag, parent, child, position_m, quaternion_xyzw=(0.0, 0.0, 0.0, 1.0)):
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
