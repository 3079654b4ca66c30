"""Contacts at the edge of the image: the camera sees a part of them."""

import numpy as np
import pytest

from tests.inverse.test_rubber_estimator import (
    BALL,
    CAMERA,
    NOISE_M,
    depth_image_of,
    estimator,
    oracle,
)
from tests.shear.drag import Eyes, stuck

ROWS, COLUMNS = np.indices((CAMERA.intrinsics.height, CAMERA.intrinsics.width))
FROM_MIDDLE_PX = {
    "left": CAMERA.intrinsics.cx - COLUMNS,
    "right": COLUMNS - CAMERA.intrinsics.cx,
    "top": CAMERA.intrinsics.cy - ROWS,
    "bottom": ROWS - CAMERA.intrinsics.cy,
}


@pytest.fixture(
    scope="module",
    params=[NOISE_M, pytest.param(6e-4, marks=pytest.mark.long)],
    ids=["0.1 mm", "1 %"],
)
def noisy(request):
    """Noise of the depth, m, and the estimator for it."""
    return request.param, estimator(1000, relative=request.param / 0.065)


@pytest.mark.parametrize(
    ("side", "depth", "ball", "cut"),
    [
        ("left", 0.009, BALL, 0.4),  # beyond the axis, over the contact's radius
        pytest.param("right", 0.009, BALL, -0.2, marks=pytest.mark.long),
        ("top", 0.006, BALL, -0.7),  # a sliver is seen
        pytest.param("top", 0.006, np.inf, 0.2, marks=pytest.mark.long),
        pytest.param("bottom", 0.006, np.inf, 0.15, marks=pytest.mark.long),
    ],
)
def test_force_of_a_contact_cut_off_by_the_edge_is_in_its_interval(noisy, side, depth, ball, cut):
    """Ball and plate by the meridian's equations: pressure continues where nothing is seen."""
    noise_m, solver = noisy
    exact, surface = oracle(depth, ball)
    image = depth_image_of(surface, np.zeros_like(surface.nodes), noise_m)
    radius_px = CAMERA.intrinsics.fx * exact.contact_radius_m / np.nanmin(image)
    hidden = FROM_MIDDLE_PX[side] > cut * radius_px
    estimate, _ = solver.estimate(np.where(hidden, np.nan, image))
    away = estimate.force_n - [0.0, 0.0, -exact.force_n]
    assert estimate.status == "ok"
    assert estimate.seen_share < 0.9
    assert np.linalg.norm(away) < 0.08 * exact.force_n
    assert (np.abs(away) < 1.96 * estimate.force_sigma_n).all()


@pytest.mark.parametrize(
    ("depth_m", "drag_m", "side", "cut"),
    [(0.002, 4e-4, 1.0, -1.5), pytest.param(0.0015, 3e-4, -1.0, -1.0, marks=pytest.mark.long)],
)
def test_friction_of_a_contact_beyond_the_edge_is_in_its_interval(depth_m, drag_m, side, cut):
    """A ball that sticks and is dragged, most of it or all of it out of view."""
    truth, eyes = stuck("sphere", depth_m, drag_m, 0.0), Eyes()
    x = (truth.mesh.nodes + truth.displacement_m)[truth.nodal_force_n.any(axis=1)]
    center, camera = x.mean(axis=0), eyes.pipeline.camera
    radius = np.linalg.norm((x - center)[:, :2], axis=1).max()
    places = np.array([center, center])
    places[1, 0] += radius
    middle, right = camera.intrinsics.project(camera.local(places))
    frame = eyes.see(truth)
    beyond = (np.arange(frame.depth_m.shape[1]) - middle[0]) * side > cut * abs(right - middle)[0]
    frame.depth_m[:, beyond] = np.nan
    estimate = eyes.pipeline.process(frame, frozenset({"patch"})).estimate
    assert estimate.seen_share < 0.5
    assert (np.abs(estimate.force_n - truth.force_n) < 1.96 * estimate.force_sigma_n).all()
