"""Messages as a robot sends them, made with rosbags alone."""

import io
import struct

import numpy as np
from PIL import Image
from rosbags.typesys import Stores, get_typestore

from bubbleviz.recordings import Message

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
    time = STORE.types["builtin_interfaces/msg/Time"](*divmod(stamp, SECOND))
    return STORE.types["std_msgs/msg/Header"](time, "camera")


def cdr(message, kind):
    return bytes(STORE.serialize_cdr(message, kind))


def image(stamp, k=0, height=HEIGHT, width=WIDTH, **changes):
    """A 16UC1 image all of whose pixels are 100 + k mm."""
    pixels = np.full((height, width), 100 + k % 60_000, dtype="<u2")
    fields = {
        "header": header(stamp),
        "height": height,
        "width": width,
        "encoding": "16UC1",
        "is_bigendian": 0,
        "step": 2 * width,
        "data": pixels.view(np.uint8).ravel(),
    }
    return cdr(STORE.types[IMAGE](**{**fields, **changes}), IMAGE)


def number_of(payload):
    """k of an image."""
    return int(np.frombuffer(payload[-2:], "<u2")[0]) - 100


def number_shown(frame):
    """k of the image of a frame."""
    return round(1e3 * float(frame.depth_m[0, 0])) - 100


def camera_info(stamp, width=WIDTH, height=HEIGHT):
    region = STORE.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    message = STORE.types[INFO](
        header=header(stamp),
        height=height,
        width=width,
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=np.array([60.0, 0, 31.5, 0, 61.0, 23.5, 0, 0, 1]),
        r=np.eye(3).ravel(),
        p=np.zeros(12),
        binning_x=0,
        binning_y=0,
        roi=region,
    )
    return cdr(message, INFO)


def pressure(stamp, value):
    return cdr(STORE.types[PRESSURE](header(stamp), value, 0.0), PRESSURE)


def wrench(stamp, values):
    vector = STORE.types["geometry_msgs/msg/Vector3"]
    body = STORE.types["geometry_msgs/msg/Wrench"](vector(*values[:3]), vector(*values[3:]))
    return cdr(STORE.types[WRENCH](header(stamp), body), WRENCH)


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
    """The pixels of `image`, compressed with Pillow as ROS's transport does."""
    file = io.BytesIO()
    Image.fromarray(np.full((HEIGHT, WIDTH), 100 + k, np.uint16)).save(file, "PNG")
    data = np.frombuffer(struct.pack("<iff", 0, 0.0, 0.0) + file.getvalue(), np.uint8)
    message = STORE.types[COMPRESSED](header(stamp), "16UC1; compressedDepth", data)
    return cdr(message, COMPRESSED)


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
