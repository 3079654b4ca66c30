"""Messages to arrays: depth images in metres, intrinsics, and time stamps."""

from __future__ import annotations

import io
import struct
from typing import Any

import numpy as np

from bubbleviz.camera import MAX_SIDE, DistortionModel, Intrinsics, check_rows
from bubbleviz.errors import InputError

DEPTH_ENCODINGS: dict[str, np.dtype[Any]] = {
    "16UC1": np.dtype(np.uint16),
    "32FC1": np.dtype(np.float32),
}
"""Encodings of a depth image: `16UC1` in mm, `32FC1` in m."""
COMPRESSED = "compressedDepth"
"""Format of a `sensor_msgs/CompressedImage` of depth, and last part of its topic."""
REALSENSE_ENCODING = "mono16"
"""Of the depth images that the RealSense library records, in units of the device."""

_PNG_SIZE = struct.Struct(">II")  # after the signature and the start of the first chunk
_CONFIGURATION = struct.Struct("<iff")
"""Header of a compressed depth image: format, A and B."""

_MODELS: dict[str, DistortionModel] = {
    "": "none",
    "none": "none",
    "plumb_bob": "plumb_bob",
    "brown_conrady": "plumb_bob",  # as the RealSense library calls it
    "rational_polynomial": "plumb_bob",  # with k4 … k6 = 0, which is checked
    "inverse_brown_conrady": "inverse_brown_conrady",
}


MAX_STAMP_NS = 2**31 * 1_000_000_000 - 1  # the latest time that a message's stamp can hold
MAX_DEPTH_M = 1e4
"""Beyond any depth camera, even with millimetres mistaken for metres."""


def decode_depth(
    # `sensor_msgs/Image`, or `CompressedImage` of `compressed_depth_image_transport` (PNG only)
    message: Any,
    metres_per_unit: float | None = None,  # of an image in `REALSENSE_ENCODING`
) -> np.ndarray:
    """z-depth of an image message, shape (H, W), float32, m; NaN where no return.

    0, NaN, inf, negative values and more than `MAX_DEPTH_M` all mean no return.

    Raises ValueError: encoding, size and data of the image do not match.
    """
    if hasattr(message, "format"):
        return _decode_compressed(message)
    encoding, unit = message.encoding, 1e-3
    if metres_per_unit is not None and encoding == REALSENSE_ENCODING:
        encoding, unit = "16UC1", metres_per_unit
    if encoding not in DEPTH_ENCODINGS:
        raise ValueError(
            f"encoding is {message.encoding[:40]!r}, not a depth image's 16UC1 or 32FC1"
        )
    height, width, step = int(message.height), int(message.width), int(message.step)
    dtype = DEPTH_ENCODINGS[encoding]
    check_rows(width, height, step, dtype.itemsize, len(message.data))
    data = np.ascontiguousarray(message.data[: height * step], dtype=np.uint8)
    rows: np.ndarray = data.reshape(height, step)[:, : width * dtype.itemsize]
    raw = np.ascontiguousarray(rows).view(dtype.newbyteorder(">" if message.is_bigendian else "<"))
    return metres(raw, unit if dtype.kind == "u" else 1.0)


def encoding_of(message: Any) -> str:
    """Encoding of the depth in an image message, compressed or not; `points` of any other."""
    if hasattr(message, "format"):
        return str(message.format).partition(";")[0].strip()
    return str(getattr(message, "encoding", "points"))


def _decode_compressed(message: Any) -> np.ndarray:
    """As `decode_depth`, of 12 bytes of configuration and a 16-bit PNG.

    Its pixels q are mm for `16UC1`; for `32FC1`, q = A/z + B with A and B of the configuration,
    which resolves near depths better.
    """
    from PIL import Image, UnidentifiedImageError  # few recordings have such images

    encoding, data = encoding_of(message), bytes(message.data)
    if COMPRESSED not in message.format or encoding not in DEPTH_ENCODINGS:
        raise ValueError(f"format is {message.format[:60]!r}, not {COMPRESSED} of 16UC1 or 32FC1")
    if "rvl" in message.format.lower():
        raise ValueError(
            "depth is compressed by RVL, but only PNG is supported (compressedDepth.format of the "
            "publisher)"
        )
    try:
        _, quant_a, quant_b = _CONFIGURATION.unpack_from(data)
        size = _PNG_SIZE.unpack_from(data, _CONFIGURATION.size + 16)
        if max(size) > MAX_SIDE:  # Pillow warns of large ones when it opens them
            raise ValueError(f"a PNG of {size[0]}×{size[1]} pixels has more than {MAX_SIDE} a side")
        with Image.open(io.BytesIO(data[_CONFIGURATION.size :]), formats=("PNG",)) as image:
            if not image.mode.startswith("I"):
                raise ValueError(f"a PNG in mode {image.mode} is not a 16-bit depth image")
            raw = np.asarray(image).astype(np.uint16)
    except (struct.error, UnidentifiedImageError, OSError, SyntaxError) as error:
        raise ValueError(f"{len(data)} bytes are not a compressed depth image") from error
    if encoding == "16UC1":
        return metres(raw, 1e-3)
    inverse = np.where(raw == 0, np.nan, raw.astype(np.float64) - quant_b)
    with np.errstate(divide="ignore"):
        return metres((quant_a / inverse).astype(np.float32), 1.0)


def metres(raw: np.ndarray, unit_m: float) -> np.ndarray:
    """Depth in m, float32, NaN for invalid values."""
    with np.errstate(invalid="ignore"):  # signalling NaNs
        depth = raw * np.float32(unit_m)
    depth[~((depth > 0) & (depth < MAX_DEPTH_M))] = np.nan
    return depth


def has_returns(depth_m: np.ndarray) -> bool:
    """Whether any pixel of a depth image (H, W) has a return: a covered camera has none."""
    return bool(np.isfinite(depth_m).any())


_WRONG_UNIT = np.sqrt(10.0)
"""Ratio of depths to those of the membrane at rest beyond which they are in a wrong unit: the
geometric mean of 1 and 10, the smallest wrong factor (0.1 mm taken for 1 mm)."""


def check_unit(
    name: str,
    depth_m: np.ndarray,  # (H, W)
    rest_m: np.ndarray,  # depths of the membrane at rest; NaN: none
    remedy: str,
) -> None:
    """Raise InputError if depths look like a wrong unit; not if there are none."""
    if not has_returns(depth_m):
        return
    measured, rest = float(np.nanmedian(depth_m)), float(np.nanmedian(rest_m))
    if not 1.0 / _WRONG_UNIT < measured / rest < _WRONG_UNIT:
        raise InputError(
            f"{name}: {measured:.3g} m in the median, but the membrane of the sensor file is "
            f"{rest:.3g} m from the camera; {remedy}, or choose the sensor file of this camera"
        )


def decode_intrinsics(message: Any) -> Intrinsics | None:
    """Intrinsics of a `sensor_msgs/CameraInfo`; None where it says the camera is uncalibrated.

    Raises ValueError: unknown distortion model, or impossible numbers.
    """
    matrix = np.asarray(message.K if hasattr(message, "K") else message.k, dtype=np.float64)
    coefficients = np.asarray(message.D if hasattr(message, "D") else message.d, dtype=np.float64)
    if matrix.size != 9 or not matrix.any():
        return None  # ROS: K = 0 means uncalibrated
    fx, cx, fy, cy = (float(matrix[k]) for k in (0, 2, 4, 5))
    if not (np.isfinite(matrix).all() and fx > 0 and fy > 0):
        raise ValueError(
            f"its matrix has a focal length that is not positive ({fx:g}, {fy:g} px), or a number "
            "that is not finite"
        )
    model, distortion = distortion_of(str(message.distortion_model), coefficients)
    return Intrinsics(int(message.width), int(message.height), fx, fy, cx, cy, model, distortion)


def distortion_of(name: str, coefficients: np.ndarray) -> tuple[DistortionModel, tuple[float, ...]]:
    """Distortion model by its name in ROS or the RealSense library, and coefficients.

    Raises ValueError: unknown model, or a coefficient is not finite.
    """
    if not np.isfinite(coefficients).all():
        raise ValueError("distortion coefficients are not finite")
    if not coefficients.any():
        return "none", ()
    key = name.strip().lower().replace(" ", "_")
    if key not in _MODELS or key in ("", "none") or coefficients[5:].any():
        raise ValueError(
            f"distortion model {name[:40]!r} with {len(coefficients)} coefficients is not "
            "supported, unlike plumb_bob and inverse_brown_conrady with up to 5"
        )
    return _MODELS[key], tuple(coefficients[:5].tolist())


def pressure_of(message: Any) -> np.ndarray:
    """Gas pressure of a `sensor_msgs/FluidPressure`, (1,), Pa; ValueError unless finite."""
    value = float(message.fluid_pressure)
    if not np.isfinite(value):
        raise ValueError("the gas pressure is not finite")
    return np.array([value])


def wrench_of(message: Any) -> np.ndarray:
    """Force and torque of a `geometry_msgs/WrenchStamped`, (6,); ValueError unless finite."""
    force, torque = message.wrench.force, message.wrench.torque
    values = np.array([force.x, force.y, force.z, torque.x, torque.y, torque.z], dtype=np.float64)
    if not np.isfinite(values).all():
        raise ValueError("the wrench is not finite")
    return values


def begins_as_cdr(payload: bytes) -> bool:
    """Whether a message of ROS 2 begins as serialised ones do."""
    return len(payload) >= 4 and payload[0] == 0 and payload[1] in (0, 1)


def header_stamp_ns(payload: bytes, *, ros1: bool) -> int:
    """Time stamp in ns of a serialised message that begins with a header; 0 when unset.

    Reads the first 16 bytes only, so that an index needs no image.
    """
    if ros1:
        sec, nanosec = struct.unpack_from("<II", payload, 4)  # after seq
    else:
        order = "<" if payload[1] & 1 else ">"  # CDR encapsulation
        sec, nanosec = struct.unpack_from(f"{order}iI", payload, 4)
    return min(max(int(sec) * 1_000_000_000 + int(nanosec), 0), MAX_STAMP_NS)


# Point clouds to depth images.


_FLOATS = {7: "f4", 8: "f8"}  # numpy type by the datatype of a PointField


def decode_cloud(message: Any, camera: Intrinsics | None) -> np.ndarray:
    """z-depth of a `sensor_msgs/PointCloud2` in the camera's optical frame, (H, W) float32, m.

    An organised cloud is an image already. Points of an unorganised cloud are projected, the
    nearest one in each pixel.

    Raises ValueError: fields, size and data do not match, or an unorganised cloud has no camera.
    """
    points = _points(message)
    if int(message.height) > 1:
        z = points[:, 2].reshape(int(message.height), int(message.width)).astype(np.float32)
        return metres(z, 1.0)
    if camera is None:
        raise ValueError("an unorganised point cloud needs intrinsics (calibrated camera info)")
    return project_points(points, camera)


def _points(message: Any) -> np.ndarray:
    """x, y, z of every point, (n, 3)."""
    fields = {field.name: field for field in message.fields}
    if not {"x", "y", "z"} <= fields.keys():
        raise ValueError("the cloud has no fields x, y, z")
    order = ">" if message.is_bigendian else "<"
    kinds = [_FLOATS.get(int(fields[name].datatype)) for name in "xyz"]
    if None in kinds:
        raise ValueError("the cloud's x, y, z are not floating-point numbers")
    step, row = int(message.point_step), int(message.row_step)
    height, width = int(message.height), int(message.width)
    if not (height > 0 and width > 0 and 0 < step <= 1024 and width * step <= row):
        raise ValueError(
            f"a cloud of {height}×{width} points of {step} bytes in rows of {row} is not plausible"
        )
    if height * row > len(message.data):
        raise ValueError(
            f"{len(message.data)} bytes do not make a cloud of {height}×{width} points"
        )
    layout = np.dtype(
        {
            "names": list("xyz"),
            "formats": [f"{order}{kind}" for kind in kinds],
            "offsets": [int(fields[name].offset) for name in "xyz"],
            "itemsize": step,
        }
    )
    data = np.ascontiguousarray(message.data[: height * row], np.uint8).reshape(height, row)
    table = np.ascontiguousarray(data[:, : width * step]).view(layout).ravel()
    return np.stack([table[name].astype(np.float64) for name in "xyz"], axis=1)


def project_points(points: np.ndarray, camera: Intrinsics) -> np.ndarray:
    """Depth image (H, W) float32 of points (n, 3): the nearest one in each pixel, else NaN."""
    depth = np.full((camera.height, camera.width), np.inf, np.float32)
    seen = points[np.isfinite(points).all(axis=1) & (points[:, 2] > 0)]
    column, row = np.rint(camera.project(seen)).T
    inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    where = (row[inside].astype(int), column[inside].astype(int))
    np.minimum.at(depth, where, seen[inside, 2].astype(np.float32))
    depth[np.isinf(depth)] = np.nan
    return depth
