"""Check that the dome does not move relative to the camera while frames are collected."""

from __future__ import annotations

import numpy as np

from bubbleviz.calibration.rest.rest_frames import Samples
from bubbleviz.calibration.robust_statistics import robust_sigma
from bubbleviz.calibration.surface.cap_fit import fit_sphere
from bubbleviz.calibration.tension.bootstrap import tile_numbers, tile_side
from bubbleviz.errors import InputError

_PIXELS = 20_000  # fitted in each frame; chosen for run time
_ROUNDS = 5  # outliers give way to the motion
_LOUD = 4.0  # standard deviations that noise does not reach in some hundred frames
_WANDER = 5e-3  # of the dome's radius: the error it would put on γ0


def check_still(samples: Samples) -> float:
    """Refuse frames between which the dome moves as a whole; how far it does beyond noise, m."""
    centres, noise, radius = dome_motion(samples)
    wander = np.linalg.norm(np.maximum(np.abs(centres) - _LOUD * noise, 0.0), axis=1)
    worst = int(np.argmax(wander))
    if wander[worst] > _WANDER * radius:
        raise InputError(
            f"{samples.source_name}: the dome moves by {1e3 * wander[worst]:.2g} mm against the"
            f" camera in the contact-free frames (most in frame {samples.frames[worst]}): fix the"
            " camera, let the gas settle, or name frames without contact"
        )
    return float(wander[worst])


def dome_motion(samples: Samples) -> tuple[np.ndarray, np.ndarray, float]:
    """Centre of the dome's sphere in every frame about its mean (F, 3), its noise (3,), radius, m.

    The noise is that of the residuals after the motion, over tiles, since neighbours share it.
    """
    statistics, camera = samples.statistics, samples.camera
    known = np.flatnonzero(statistics.validity >= statistics.regular_validity)
    known = known[:: max(1, len(known) // _PIXELS)]
    ranges = statistics.range_m.ravel()[known]
    points = camera.center + ranges[:, None] * camera.directions[known]
    sphere = fit_sphere(points).ellipsoid
    near = np.abs(sphere.distance(points)) < 0.1 * sphere.semi_axes_m[0]
    known, points, ranges = known[near], points[near], ranges[near]
    J = sphere.derivatives(points, "sphere")[:, :3]  # of one size, wherever it is
    facing = np.einsum("ij,ij->i", sphere.normals(points), camera.directions[known])
    to_range = camera.range_per_depth.ravel()[known]
    # Derivatives are of the distance for motion of the sphere, so that −distance moves it there.
    solve = -np.linalg.pinv(J)
    depth = samples.depth_m.reshape(len(samples.depth_m), -1)[:, known]
    change = np.nan_to_num((depth * to_range - ranges) * facing)
    moved = np.zeros((len(change), 3))
    for _ in range(_ROUNDS):
        left = change + moved @ J.T
        limit = _LOUD * np.array([robust_sigma(row, center=0.0) for row in left])[:, None]
        moved = moved + np.clip(left, -limit, limit) @ solve.T
    left = np.clip(change + moved @ J.T, -limit, limit)
    side = tile_side(len(known), statistics.correlation_length_px)
    tile = tile_numbers(known, camera.intrinsics.width, max(side, 8))
    variance = np.zeros((len(left), 3))
    for k in range(3):
        cells = np.stack([np.bincount(tile, row * solve[k]) for row in left])
        variance[:, k] = np.sum(cells**2, axis=1)
    noise = np.sqrt(np.median(variance, axis=0))
    return moved[:, :3], noise, float(sphere.semi_axes_m[0])
