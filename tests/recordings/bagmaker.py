"""Bags made with rosbags alone, independent of our writer."""

from functools import cache
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer as Writer2
from rosbags.typesys import Stores, get_typestore

START = 1_700_000_000_000_000_000
PERIOD = 33_333_333
HEIGHT, WIDTH = 24, 32
SECOND = 1_000_000_000

KINDS = (
    "mcap folder",
    "mcap file",
    "mcap messages",
    "mcap plain",
    "db3 folder",
    "db3 file",
    "bag none",
    "bag lz4",
    "bag bz2",
)


def depth_image(k, height=HEIGHT, width=WIDTH):
    """Depth of frame k, different in each pixel; m."""
    pixels = np.arange(height * width, dtype=np.float32).reshape(height, width)
    return (0.1 + 1e-5 * pixels + 0.01 * k).astype(np.float32)


def pressure_at(stamp_ns):
    """A gas pressure linear in time, so that interpolation is exact; Pa."""
    return 106_000.0 + 100.0 * (stamp_ns - START) / SECOND


typestore = cache(get_typestore)
"""It compiles each type it serialises, which takes longer than to write a whole recording."""


class BagMaker:
    """Messages by (topic, kind, stamp, log, object) written with rosbags in a chosen format."""

    def __init__(self, kind):
        self.kind = kind
        self.ros1 = kind.startswith("bag")
        self.store = typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        self.rows: list[tuple[str, str, int, Any]] = []

    def header(self, stamp):
        time = self.store.types["builtin_interfaces/msg/Time"](*divmod(stamp, SECOND))
        kind = self.store.types["std_msgs/msg/Header"]
        return kind(0, time, "camera") if self.ros1 else kind(time, "camera")

    def image(self, stamp, pixels, encoding="32FC1", **changes):
        topic, log = changes.pop("topic", "/cam/depth/image"), changes.pop("log", stamp)
        fields = {
            "header": self.header(stamp),
            "height": pixels.shape[0],
            "width": pixels.shape[1],
            "encoding": encoding,
            "is_bigendian": 0,
            "step": pixels.shape[1] * pixels.itemsize,
            "data": np.ascontiguousarray(pixels).view(np.uint8).ravel(),
        }
        self.add(topic, "sensor_msgs/msg/Image", log, **{**fields, **changes})

    def camera_info(self, stamp, model="plumb_bob", d=None, **k):
        region = self.store.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        matrices = {
            "d": np.zeros(5) if d is None else np.asarray(d, dtype=np.float64),
            "k": np.array([30.0, 0, 15.5, 0, 31.0, 11.5, 0, 0, 1]),
            "r": np.eye(3).ravel(),
            "p": np.zeros(12),
        }
        matrices.update({name: k.pop(name) for name in ("k",) if name in k})
        if self.ros1:
            matrices = {name.upper(): value for name, value in matrices.items()}
        fields = {"height": HEIGHT, "width": WIDTH, "distortion_model": model, **matrices}
        fields |= {"binning_x": 0, "binning_y": 0, "roi": region, "header": self.header(stamp)}
        topic = k.pop("topic", "/cam/depth/camera_info")
        self.add(topic, "sensor_msgs/msg/CameraInfo", k.pop("log", stamp), **{**fields, **k})

    def pressure(self, stamp, value, log=None):
        fields = {"header": self.header(stamp), "fluid_pressure": value, "variance": 0.0}
        log = stamp if log is None else log
        self.add("/gas", "sensor_msgs/msg/FluidPressure", log, **fields)

    def wrench(self, stamp, values):
        vector = self.store.types["geometry_msgs/msg/Vector3"]
        wrench = self.store.types["geometry_msgs/msg/Wrench"]
        value = wrench(vector(*values[:3]), vector(*values[3:]))
        fields = {"header": self.header(stamp), "wrench": value}
        self.add("/wrench", "geometry_msgs/msg/WrenchStamped", stamp, **fields)

    def add(self, topic, kind, log, **fields):
        self.rows.append((topic, kind, log, self.store.types[kind](**fields)))

    def payload(self, kind, message):
        """A message as sent; what are bytes already stays."""
        serialize = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        return message if isinstance(message, bytes) else bytes(serialize(message, kind))

    def write(self, folder, name="rec"):
        path = folder / (f"{name}.bag" if self.ros1 else name)
        with self._writer(path) as writer:
            connections = {}
            for topic, kind, log, message in self.rows:
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=self.store)
                writer.write(connections[topic], log, self.payload(kind, message))
        if self.kind.endswith("file"):
            (inner,) = path.glob(f"{name}.*")
            return inner.rename(folder / inner.name)
        return path

    def _writer(self, path):
        if self.ros1:
            writer1 = Writer1(path)
            if not self.kind.endswith("none"):
                writer1.set_compression(Writer1.CompressionFormat[self.kind[4:].upper()])
            return writer1
        plugin = StoragePlugin.MCAP if "mcap" in self.kind else StoragePlugin.SQLITE3
        writer2 = Writer2(path, version=9, storage_plugin=plugin)
        if self.kind == "mcap messages":
            writer2.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
        elif self.kind in ("mcap folder", "mcap file"):
            writer2.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        return writer2


def fill(bag, frames=6):
    """A small press: depth, camera info, and gas pressure and wrench half a period apart."""
    bag.pressure(START - PERIOD // 2, pressure_at(START - PERIOD // 2))
    for k in range(frames):
        stamp = START + k * PERIOD
        bag.image(stamp, depth_image(k), log=stamp + 5_000_000)
        bag.camera_info(stamp, log=stamp + 5_000_000)
        bag.wrench(stamp, [k, 2.0, 3.0, 4.0, 5.0, 6.0])
        bag.pressure(stamp + PERIOD // 2, pressure_at(stamp + PERIOD // 2))
    return bag
