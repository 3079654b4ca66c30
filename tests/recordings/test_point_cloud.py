"""Point clouds in the memory layouts of other programs."""

from types import SimpleNamespace

import numpy as np
import pytest

from bubbleviz.recordings import decode_cloud

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
