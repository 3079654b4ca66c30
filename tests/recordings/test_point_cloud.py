"""Point clouds in the memory layouts of other programs."""

from types import SimpleNamespace

import numpy as np
import pytest

from bubbleviz.camera import Intrinsics
from bubbleviz.recordings import decode_cloud

CAMERA = Intrinsics(5, 4, 6.0, 7.0, 2.0, 1.5)
POINTS = np.random.default_rng(0).uniform(0.1, 0.2, (4, 5, 3))


def cloud(points, *, kind="<f4", step=24, padding=8, offsets=(4, 16, 8), **changes):
    """A PointCloud2 of points (h, w, 3) among other bytes, with padding after every row."""
    height, width, _ = points.shape
    row = width * step + padding
    data = np.random.default_rng(1).integers(0, 256, height * row, np.uint8)
    for i in range(height):
        for j in range(width):
            for value, offset in zip(points[i, j], offsets, strict=True):
                start = i * row + j * step + offset
                data[start : start + np.dtype(kind).itemsize] = list(
                    np.array(value, kind).tobytes()
                )
    fields = [
        SimpleNamespace(name=name, offset=offset, datatype={4: 7, 8: 8}[np.dtype(kind).itemsize])
        for name, offset in zip("xyz", offsets, strict=True)
    ]
    message = {
        "height": height, "width": width, "point_step": step, "row_step": row, "data": data,
        "is_bigendian": kind.startswith(">"), "fields": fields,
    }  # fmt: skip
    return SimpleNamespace(**{**message, **changes})


@pytest.mark.parametrize(
    ("kind", "offsets", "step"),
    [("<f4", (4, 16, 8), 24), (">f4", (0, 4, 8), 12), ("<f8", (8, 0, 16), 32)],
)
def test_fields_steps_and_rows_follow_the_message(kind, offsets, step):
    decoded = decode_cloud(cloud(POINTS, kind=kind, offsets=offsets, step=step), None)
    np.testing.assert_array_equal(decoded, POINTS[..., 2].astype(np.float32))


def test_invalid_depths_are_missing_returns():
    points = POINTS.copy()
    points[0, :4, 2] = np.nan, np.inf, 0.0, -0.1
    decoded = decode_cloud(cloud(points), None)
    assert np.isnan(decoded[0, :4]).all() and np.isfinite(decoded[0, 4])
    np.testing.assert_array_equal(decoded[1:], points[1:, :, 2].astype(np.float32))


@pytest.mark.parametrize("kind", ["<f4", "<f8"])
def test_unorganised_points_are_projected_by_the_camera(kind):
    """The nearest of those that meet in a pixel; none outside the image or behind it."""
    rows, columns = np.indices((4, 5))
    z = np.random.default_rng(2).uniform(0.1, 0.2, (4, 5)).astype(np.float32).astype(float)
    at = np.stack([(columns - CAMERA.cx) / CAMERA.fx, (rows - CAMERA.cy) / CAMERA.fy], axis=-1)
    image = np.dstack([at * z[..., None], z])
    image[2, 3] = np.nan  # a hole
    behind, outside = -image[:1, :2], np.array([[[0.3, 0.0, 0.1], [0.0, -0.3, 0.1]]])
    farther = 1.4 * image
    points = np.concatenate([p.reshape(-1, 3) for p in (farther, image, farther, behind, outside)])
    offsets = (0, 8, 16) if kind == "<f8" else (0, 4, 8)
    decoded = decode_cloud(cloud(points[None], kind=kind, offsets=offsets), CAMERA)
    expected = np.where(np.isnan(image[..., 2]), np.nan, z)
    np.testing.assert_allclose(decoded, expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"row_step": 5 * 24 - 1}, "not plausible"),
        ({"point_step": 0}, "not plausible"),
        ({"point_step": 2000, "row_step": 20_000}, "not plausible"),
        ({"width": 0}, "not plausible"),
        ({"data": np.zeros(4 * 128 - 1, np.uint8)}, "do not make a cloud of 4×5 points"),
        ({"fields": []}, "no fields x, y, z"),
    ],
)
def test_numbers_that_do_not_fit_are_refused(change, says):
    with pytest.raises(ValueError, match=says):
        decode_cloud(cloud(POINTS, **change), None)
    whole = cloud(POINTS, data=cloud(POINTS).data[: 4 * 128])
    assert decode_cloud(whole, None).shape == (4, 5)


def test_integer_points_are_refused_and_unorganised_ones_need_a_camera():
    message = cloud(POINTS)
    message.fields[1].datatype = 5
    with pytest.raises(ValueError, match="not floating-point"):
        decode_cloud(message, None)
    with pytest.raises(ValueError, match="needs intrinsics"):
        decode_cloud(cloud(POINTS[:1]), None)
