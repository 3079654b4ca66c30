"""ROS 1 bags as the recorder of the RealSense library (2.x) lays them out, written with rosbags."""

from functools import cache
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

HEIGHT, WIDTH = 24, 32
STATIC = 1
"""Log time of what does not change, ns; the frames' begins at 0 with the recording."""
CLOCK_MS, PERIOD_MS = 1_234_567.25, 1e3 / 30.0
"""Of the camera, which counts from when it was switched on."""
SENSOR = "/device_0/sensor_0"
OWN_TYPES = {"realsense_msgs/msg/StreamInfo": "uint32 fps\nstring encoding\nbool is_recommended\n"}


def depth_units(k):
    """Frame k in units of the device: every pixel and frame differs; 0 where no return."""
    units = 1000 + 40 * k + np.arange(HEIGHT * WIDTH, dtype=np.uint16).reshape(HEIGHT, WIDTH)
    units[0, :3] = 0
    return units


@cache
def _typestore():
    store = get_typestore(Stores.ROS1_NOETIC)
    for name, text in OWN_TYPES.items():
        store.register(get_types_from_msg(text, name))
    return store


def write_realsense_bag(path, unit_m, option="Depth_Units", extrinsics=None):
    """Four frames of depth and infrared, and of colour with `extrinsics`, then uncompressed.

    The library itself does not read what rosbags compresses.

    Parameters
    ----------
    path : Path
    unit_m : float or None
        Of the depth images, m; None: the option is not recorded.
    option : str
        What its topic calls it; the older library had the space of its name.
    extrinsics : dict, optional
        Of `Depth_0` and `Color_0`: the pose of a common reference in their cameras.
    """
    store = _typestore()
    types, connections = store.types, dict[str, Any]()
    writer = Writer(path)
    if not extrinsics:
        writer.set_compression(Writer.CompressionFormat.LZ4)

    def write(topic, kind, log_ns, **fields):
        if topic not in connections:
            connections[topic] = writer.add_connection(topic, kind, typestore=store)
        payload = store.serialize_ros1(types[kind](**fields), kind)
        writer.write(connections[topic], log_ns, payload)

    def header(number, stamp_ms):
        stamp = types["builtin_interfaces/msg/Time"](*divmod(round(1e6 * stamp_ms), 10**9))
        return types["std_msgs/msg/Header"](number, stamp, "0")

    def placed(stream, position_m, quaternion):
        kind = "geometry_msgs/msg/Transform"
        vector = types["geometry_msgs/msg/Vector3"](*position_m)
        turn = types["geometry_msgs/msg/Quaternion"](*quaternion)
        write(f"{SENSOR}/{stream}/tf/0", kind, STATIC, translation=vector, rotation=turn)

    def image(stream, encoding, pixels, k):
        data = np.frombuffer(pixels.tobytes(), np.uint8)
        log = round(1e6 * PERIOD_MS * k) + 5_000_000
        step = pixels.nbytes // HEIGHT
        rows = {"height": HEIGHT, "width": WIDTH, "step": step, "is_bigendian": 0}
        head, topic = header(k, CLOCK_MS + PERIOD_MS * k), f"{SENSOR}/{stream}/image"
        kind = "sensor_msgs/msg/Image"
        write(f"{topic}/data", kind, log, header=head, encoding=encoding, data=data, **rows)
        note(f"{topic}/metadata", log, "timestamp_domain", "Hardware Clock")

    def note(topic, log_ns, key, value):
        write(topic, "diagnostic_msgs/msg/KeyValue", log_ns, key=key, value=value)

    def streaming(stream, encoding, model, bent):
        topic, region = f"{SENSOR}/{stream}/info", types["sensor_msgs/msg/RegionOfInterest"]
        own = "realsense_msgs/msg/StreamInfo"
        write(topic, own, STATIC, fps=30, encoding=encoding, is_recommended=False)
        matrix = np.array([30.0, 0, 15.25, 0, 31.0, 11.75, 0, 0, 1])
        write(
            f"{topic}/camera_info", "sensor_msgs/msg/CameraInfo", STATIC,
            header=header(0, 0.0), height=HEIGHT, width=WIDTH, distortion_model=model,
            D=np.array(bent), K=matrix, R=np.zeros(9), P=np.zeros(12),
            binning_x=0, binning_y=0, roi=region(0, 0, 0, 0, False),
        )  # fmt: skip

    with writer:
        write("/file_version", "std_msgs/msg/UInt32", STATIC, data=4)
        note("/device_0/info", STATIC, "Name", "Intel RealSense D405")
        note(f"{SENSOR}/info", STATIC, "Name", "Stereo Module")
        streaming("Infrared_1", "16UC1", "None", 5 * [0.0])
        streaming("Depth_0", "mono16", "Brown Conrady", [0.1, 0.0, 0.0, 0.0, 0.01])
        if unit_m is not None:
            topic = f"{SENSOR}/option/{option}"
            write(f"{topic}/value", "std_msgs/msg/Float32", STATIC, data=unit_m)
            said = "Number of meters represented by a single depth unit"
            write(f"{topic}/description", "std_msgs/msg/String", STATIC, data=said)
        for stream, pose in (extrinsics or {}).items():
            placed(stream, *pose)
        if extrinsics:
            streaming("Color_0", "rgb8", "None", 5 * [0.0])
        for k in range(4):
            if extrinsics:
                image("Color_0", "rgb8", np.full((HEIGHT, WIDTH, 3), k, np.uint8), k)
            image("Infrared_1", "16UC1", depth_units(k)[::-1], k)
            image("Depth_0", "mono16", depth_units(k), k)
