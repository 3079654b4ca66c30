"""Messages as a robot sends them, made with rosbags alone."""

import numpy as np
from rosbags.typesys import Stores, get_typestore

from bubbleviz.recordings import Message
from tests.recordings.bagmaker import BagMaker
from tests.recordings.compressed_depth import compressed

STORE = get_typestore(Stores.ROS2_JAZZY)
HEIGHT, WIDTH = 48, 64
SECOND = 1_000_000_000
NOW = 1_790_000_000 * SECOND
PERIOD = 33_333_333

IMAGE = "sensor_msgs/msg/Image"
INFO = "sensor_msgs/msg/CameraInfo"
PRESSURE = "sensor_msgs/msg/FluidPressure"
WRENCH = "geometry_msgs/msg/WrenchStamped"
CLOUD = "sensor_msgs/msg/PointCloud2"
COMPRESSED = "sensor_msgs/msg/CompressedImage"


def header(stamp):
    return BagMaker("mcap file").header(stamp)


def cdr(message, kind):
    return bytes(STORE.serialize_cdr(message, kind))


def sent(make, *given, **changes):
    """Payload of the message that a method of `BagMaker` makes."""
    bag = BagMaker("mcap file")
    make(bag, *given, **changes)
    ((_, kind, _, message),) = bag.rows
    return bag.payload(kind, message)


def image(stamp, k=0, height=HEIGHT, width=WIDTH, encoding="16UC1", **changes):
    """An image all of whose pixels are 100 + k mm, unless others are given."""
    pixels = np.full((height, width), 100 + k % 60_000, dtype="<u2")
    return sent(BagMaker.image, stamp, pixels, encoding, **changes)


def number_of(payload):
    """k of an image."""
    return int(np.frombuffer(payload[-2:], "<u2")[0]) - 100


def number_shown(frame):
    """k of the image of a frame."""
    return round(1e3 * float(frame.depth_m[0, 0])) - 100


def camera_info(stamp, width=WIDTH, height=HEIGHT):
    matrix = np.array([60.0, 0, 31.5, 0, 61.0, 23.5, 0, 0, 1])
    return sent(BagMaker.camera_info, stamp, k=matrix, width=width, height=height)


def pressure(stamp, value):
    return sent(BagMaker.pressure, stamp, value)


def wrench(stamp, values):
    return sent(BagMaker.wrench, stamp, values)


def cloud(stamp, points, height, width):
    field = STORE.types["sensor_msgs/msg/PointField"]
    table = np.ascontiguousarray(points, dtype="<f4")
    message = STORE.types[CLOUD](
        header=header(stamp),
        height=height,
        width=width,
        fields=[field(name, 4 * k, 7, 1) for k, name in enumerate("xyz")],
        is_bigendian=False,
        point_step=12,
        row_step=12 * width,
        data=table.view(np.uint8).ravel(),
        is_dense=True,
    )
    return cdr(message, CLOUD)


def compressed_depth(stamp, k=0):
    """The pixels of `image`, compressed as ROS's transport does."""
    text, data = compressed(np.full((HEIGHT, WIDTH), 1e-3 * (100 + k)), "16UC1")
    pixels = np.frombuffer(data, np.uint8)
    return cdr(STORE.types[COMPRESSED](header(stamp), text, pixels), COMPRESSED)


def arrived(topic, kind, payload, stamp, arrival=None):
    """As the source of a robot on this clock delivers it, a millisecond after its stamp."""
    return Message(topic, kind, payload, stamp, stamp + 1_000_000 if arrival is None else arrival)


def depth(stamp, k=0, arrival=None, topic="/cam/depth"):
    return arrived(topic, IMAGE, image(stamp, k), stamp, arrival)


def gas(stamp, value, arrival=None):
    return arrived("/gas", PRESSURE, pressure(stamp, value), stamp, arrival)


def grey(stamp, k, topic="/cam/color/image_raw", **changes):
    """A colour camera's grey image all of whose pixels are k."""
    pixels = np.full(HEIGHT * WIDTH, k, np.uint8)
    shown = {"encoding": "mono8", "step": WIDTH, "data": pixels, **changes}
    return arrived(topic, IMAGE, image(stamp, **shown), stamp)
