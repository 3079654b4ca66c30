"""A file of the RealSense SDK, recorded from its software device."""

from typing import Any

import numpy as np
import pytest


def record_realsense(path, frames, colour_pose=None):
    """Depth of 0.1 m + 0.1 mm an image with a hole, and colour where its pose (4, 4) is given."""
    rs = pytest.importorskip("pyrealsense2")
    device = rs.software_device()
    streams = {"Depth": (rs.stream.depth, rs.format.z16, 2)}
    if colour_pose is not None:
        streams["Color"] = (rs.stream.color, rs.format.rgb8, 3)
    profiles: dict[str, tuple[Any, Any, int]] = {}
    for uid, (name, (kind, form, size)) in enumerate(streams.items()):
        stream = rs.video_stream()
        stream.type, stream.index, stream.uid, stream.fmt = kind, 0, uid, form
        stream.width, stream.height, stream.fps, stream.bpp = 64, 48, 30, size
        stream.intrinsics = lens_of(rs, uid)
        sensor = device.add_sensor(name)
        profiles[name] = sensor, sensor.add_video_stream(stream), size
    profiles["Depth"][0].add_read_only_option(rs.option.depth_units, 1e-4)
    if colour_pose is not None:
        placed = rs.extrinsics()
        placed.rotation = colour_pose[:3, :3].T.ravel().tolist()
        placed.translation = colour_pose[:3, 3].tolist()
        profiles["Color"][1].register_extrinsics_to(profiles["Depth"][1], placed)
    recorder, queue = rs.recorder(str(path), device), rs.frame_queue(50)
    recorded = recorder.query_sensors()
    for sensor in recorded:
        sensor.open(sensor.get_stream_profiles()[0])
        sensor.start(queue)
    for k in range(frames):
        for name, (sensor, profile, size) in profiles.items():
            frame = rs.software_video_frame()
            depth, colour = np.full((48, 64), 1000 + k, np.uint16), np.zeros((48, 64, 3), np.uint8)
            depth[0, 0], colour[:] = 0, (k, 2 * k, 3 * k)
            frame.pixels = depth if name == "Depth" else colour
            frame.stride, frame.bpp, frame.depth_units = 64 * size, size, 1e-4
            frame.timestamp, frame.domain = 1e6 + 1e3 * k / 30.0, rs.timestamp_domain.system_time
            frame.frame_number, frame.profile = k, profile.as_video_stream_profile()
            sensor.on_video_frame(frame)
            assert queue.try_wait_for_frame(5000)[0]
    for sensor in recorded:
        sensor.stop()
        sensor.close()
    del recorded, recorder
    return path


def lens_of(rs, uid):
    lens = rs.intrinsics()
    lens.width, lens.height, lens.ppx, lens.ppy = 64, 48, 31.5, 23.5
    lens.fx, lens.fy = 60.0 + uid, 61.0
    lens.model = rs.distortion.inverse_brown_conrady
    lens.coeffs = [0.1, 0.0, 0.0, 0.0, 0.01]
    return lens
