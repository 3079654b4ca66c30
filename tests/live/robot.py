"""A robot in its own process: publishes with zenoh alone, in both layouts of keys.

Usage: python -m tests.live.robot PORT LAYOUT FIRST [MODE]. Counts images from FIRST, at 100 Hz, and
prints each count once it is sent. In mode `bad` every third message is none that a camera sends.
"""

import json
import struct
import sys
import time

import zenoh

from tests.live import wire

HASH = "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47"
KEYS = {
    "rmw": {
        "/cam/depth": f"0/cam/depth/sensor_msgs::msg::dds_::Image_/{HASH}",
        "/cam/camera_info": f"0/cam/camera_info/sensor_msgs::msg::dds_::CameraInfo_/{HASH}",
        "/gas": f"0/gas/sensor_msgs::msg::dds_::FluidPressure_/{HASH}",
    },
    "dds": {"/cam/depth": "cam/depth", "/cam/camera_info": "cam/camera_info", "/gas": "gas"},
}
TOKENS = {
    "rmw": [
        "@ros2_lv/0/b3f7/0/0/NN/%/%/camera",
        f"@ros2_lv/0/b3f7/0/10/MP/%/%/camera/%cam%depth/sensor_msgs::msg::dds_::Image_/{HASH}/"
        "::,5:,:,:,,",
        "@ros2_lv/0/b3f7/0/11/MP/%/%/camera/%cam%camera_info/"
        f"sensor_msgs::msg::dds_::CameraInfo_/{HASH}/::,5:,:,:,,",
        "@ros2_lv/0/b3f7/0/12/MP/%/%/gas/%gas/sensor_msgs::msg::dds_::FluidPressure_/"
        f"{HASH}/::,5:,:,:,,",
        f"@ros2_lv/0/b3f7/0/13/MS/%/%/gas/%other/sensor_msgs::msg::dds_::Image_/{HASH}/::,5:,:,:,,",
        f"@ros2_lv/7/b3f7/0/14/MP/%/%/gas/%far/sensor_msgs::msg::dds_::Image_/{HASH}/::,5:,:,:,,",
    ],
    "dds": [
        "@/b3f7/@ros2_lv/MP/cam§depth/sensor_msgs§msg§Image/:::",
        "@ros2_lv/b3f7/MP/cam§camera_info/sensor_msgs§msg§CameraInfo/:::",  # a bridge before 1.0
        "@/b3f7/@ros2_lv/MP/gas/sensor_msgs§msg§FluidPressure/:::",
        "@/b3f7/@ros2_lv/MS/other/sensor_msgs§msg§Image/:::",
    ],
}


def open_session(port, role="robot"):
    """A robot that is connected to; or a router, and a node that is found through it."""
    place = f"tcp/127.0.0.1:{port}"
    config = zenoh.Config()
    config.insert_json5("mode", '"router"' if role == "router" else '"peer"')
    listen = "tcp/127.0.0.1:0" if role == "node" else place
    config.insert_json5("listen/endpoints", json.dumps([listen]))
    config.insert_json5("connect/endpoints", json.dumps([place] if role == "node" else []))
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("timestamping/enabled", "true")  # as rmw_zenoh has it
    return zenoh.open(config)


def attachment(sequence):
    return struct.pack("<qqB", sequence, time.time_ns(), 16) + bytes(range(16))


def bad(k, stamp):
    """Random bytes, truncated, another size, 1970, the future, another message type, empty."""
    kinds = [
        b"\xff\xfe garbage" * 30,
        wire.image(stamp, k)[:900],
        wire.image(stamp, k, height=24, width=32),
        wire.image(7 * wire.SECOND, k),
        wire.image(2_100_000_000 * wire.SECOND, k),
        wire.pressure(stamp, 1e5),
        b"",
    ]
    return kinds[k // 3 % len(kinds)]


def main():
    port, layout, first = sys.argv[1], sys.argv[2], int(sys.argv[3])
    session = open_session(port)
    tokens = [session.liveliness().declare_token(key) for key in TOKENS[layout]]
    put = {
        topic: session.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK)
        for topic, key in KEYS[layout].items()
    }
    k = first
    while tokens:
        stamp = time.time_ns()
        extra = {"attachment": attachment(k)} if layout == "rmw" else {}
        put["/cam/camera_info"].put(wire.camera_info(stamp), **extra)
        put["/gas"].put(wire.pressure(stamp, 1e5 + k), **extra)
        wrong = sys.argv[4:] == ["bad"] and k % 3 == 2
        put["/cam/depth"].put(bad(k, stamp) if wrong else wire.image(stamp, k), **extra)
        print(k, flush=True)
        k += 1
        time.sleep(0.01)


if __name__ == "__main__":
    main()
