"""Messages to arrays, against images built byte by byte."""

import struct
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from bubbleviz.recordings import decode_depth, decode_intrinsics, has_returns, header_stamp_ns


def image(values, encoding, big, padding):
    code = (">" if big else "<") + ("H" if encoding == "16UC1" else "f")
    rows = [b"".join(struct.pack(code, v) for v in row) + b"\xee" * padding for row in values]
    data = np.frombuffer(b"".join(rows), dtype=np.uint8)
    return SimpleNamespace(
        encoding=encoding,
        height=len(values),
        width=len(values[0]),
        step=len(rows[0]),
        is_bigendian=int(big),
        data=data,
    )


sizes = st.tuples(st.integers(1, 12), st.integers(1, 12))


@given(sizes, st.booleans(), st.integers(0, 9), st.data())
def test_millimetres_become_metres(size, big, padding, data):
    row = st.lists(st.integers(0, 65_535), min_size=size[1], max_size=size[1])
    values = data.draw(st.lists(row, min_size=size[0], max_size=size[0]))
    depth = decode_depth(image(values, "16UC1", big, padding))
    assert depth.shape == size
    assert depth.dtype == np.float32
    for got, mm in zip(depth.ravel(), np.ravel(values), strict=True):
        assert np.isnan(got) if mm == 0 else abs(got - mm / 1000) < 1e-5


@given(sizes, st.booleans(), st.integers(0, 9), st.data())
def test_metres_are_kept_and_invalid_depths_are_nan(size, big, padding, data):
    row = st.lists(st.floats(width=32), min_size=size[1], max_size=size[1])
    values = data.draw(st.lists(row, min_size=size[0], max_size=size[0]))
    depth = decode_depth(image(values, "32FC1", big, padding))
    assert depth.shape == size
    for got, metres in zip(depth.ravel(), np.ravel(values), strict=True):
        assert got == metres if 0 < metres < 1e4 else np.isnan(got)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"encoding": "rgb8"}, "rgb8"),
        ({"height": 0}, "a side"),
        ({"width": 4_000_000_000}, "a side"),
        ({"height": 9_999}, "not a 3×9999 image"),
        ({"step": 11}, "step"),
        ({"step": 4_000_000_000}, "step"),
    ],
)
def test_inconsistent_images_are_refused(change, words):
    message = image([[0.1, 0.2, 0.3]] * 2, "32FC1", False, 0)
    for name, value in change.items():
        setattr(message, name, value)
    with pytest.raises(ValueError, match=words):
        decode_depth(message)


def test_has_returns():
    assert not has_returns(decode_depth(image([[0.0, 0.0]], "32FC1", False, 0)))
    assert has_returns(decode_depth(image([[0.0, 0.1]], "32FC1", False, 0)))


def camera_info(model, d, fx=400.0):
    k = np.array([fx, 0, 320, 0, 410, 240, 0, 0, 1.0])
    return SimpleNamespace(k=k, d=np.array(d), distortion_model=model, width=640, height=480)


@pytest.mark.parametrize(
    ("model", "d", "expected", "coefficients"),
    [
        ("", [], "none", ()),
        ("none", [0.0] * 5, "none", ()),
        ("plumb_bob", [0.0] * 5, "none", ()),
        ("plumb_bob", [0.1, 0.2, 0.3, 0.4, 0.5], "plumb_bob", (0.1, 0.2, 0.3, 0.4, 0.5)),
        ("Inverse Brown Conrady", [0.1, 0, 0, 0, 0], "inverse_brown_conrady", (0.1, 0, 0, 0, 0)),
        ("rational_polynomial", [0.1, 0, 0, 0, 0.2, 0, 0, 0], "plumb_bob", (0.1, 0, 0, 0, 0.2)),
    ],
)
def test_distortion_models(model, d, expected, coefficients):
    camera = decode_intrinsics(camera_info(model, d))
    assert camera.distortion_model == expected
    assert camera.distortion == coefficients
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (400, 410, 320, 240)
    assert (camera.width, camera.height) == (640, 480)


@pytest.mark.parametrize(
    ("model", "d"),
    [
        ("rational_polynomial", [0.1, 0, 0, 0, 0, 0.2, 0, 0]),
        ("equidistant", [0.1, 0, 0, 0]),
        ("", [0.1]),
        ("plumb_bob", [np.nan]),
    ],
)
def test_unknown_distortion_is_refused(model, d):
    with pytest.raises(ValueError, match="distortion"):
        decode_intrinsics(camera_info(model, d))


def test_uncalibrated_camera_has_no_intrinsics():
    message = camera_info("plumb_bob", [])
    message.k = np.zeros(9)
    assert decode_intrinsics(message) is None
    with pytest.raises(ValueError, match="focal"):
        decode_intrinsics(camera_info("plumb_bob", [], fx=-1.0))


@given(st.integers(0, 2**31 - 1), st.integers(0, 10**9 - 1), st.booleans())
def test_header_stamp(sec, nanosec, little):
    order = "<" if little else ">"
    cdr = bytes([0, little, 0, 0]) + struct.pack(f"{order}iI", sec, nanosec) + bytes(4)
    assert header_stamp_ns(cdr, ros1=False) == sec * 10**9 + nanosec
    ros1 = struct.pack("<III", 77, sec, nanosec)
    assert header_stamp_ns(ros1, ros1=True) == sec * 10**9 + nanosec
