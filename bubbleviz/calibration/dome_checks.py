"""Checks that contact-free frames show a still, visible dome that nothing touches."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from bubbleviz.calibration.ellipsoid import fit_sphere
from bubbleviz.calibration.rest_frames import FrameSamples, away_from_edges, traced_pixels
from bubbleviz.camera import MAD, DepthCamera, median
from bubbleviz.errors import InputError
from bubbleviz.membrane import MembraneMesh
from bubbleviz.recordings import correlated_samples, robust_sigma, spatial_correlation

_MIN_VISIBLE_SHARE = 0.5  # of the dome's area; chosen: the fit extrapolates over the rest
_SIGNIFICANT = 6.0  # robust standard deviations of the residual
_MIN_DENT_PIXELS = 20  # chosen: smaller dents are false returns
_MIN_DENT_SAMPLES = 5.0
"""Fewest independent samples in a dent. Patches of a camera's fixed pattern have at most two: up to
250 pixels and 1.5 mm deep on the real camera."""
_DEEP = 1e-2  # of the dome's radius: shallower deviations belong to the dome's shape


def check_dome(
    samples: FrameSamples,
    mesh: MembraneMesh,  # of the chosen surface, in B
    residual_m: np.ndarray,  # (H, W), measured range minus that of the mesh, m; NaN: unknown
    camera: DepthCamera,
    membrane: np.ndarray,  # (H, W) bool, pixels that see the membrane
) -> float:
    """Visible share of the dome. Raises InputError: it is pressed in, or less than half visible."""
    filled = ndimage.binary_fill_holes(_closed(membrane))
    visible = _visible_share(mesh, camera, filled)
    if visible < _MIN_VISIBLE_SHARE:
        raise InputError(
            f"{samples.source_name}: only {100 * visible:.0f} % of the dome is visible, too little "
            "to determine its shape, volume and γ0; uncover the camera, or give a sensor file with "
            "this camera's pose"
        )
    radius = float(np.sqrt(mesh.areas.sum() / (2.0 * np.pi)))  # of a hemisphere of this area
    _check_no_dent(samples, residual_m, radius, membrane, filled)
    return visible


def _visible_share(
    mesh: MembraneMesh,
    camera: DepthCamera,
    filled: np.ndarray,  # (H, W) bool, pixels that see the membrane, and holes between them
) -> float:
    """Share of a dome's area that the camera sees."""
    centres = mesh.nodes[mesh.triangles].mean(axis=1)
    uv = np.rint(camera.project(centres)).astype(int)
    height, width = filled.shape
    inside = ((uv >= 0) & (uv < (width, height))).all(axis=1)
    visible = np.zeros(len(uv), bool)
    visible[inside] = filled[uv[inside, 1], uv[inside, 0]]
    return float(mesh.facet_areas[visible].sum() / mesh.facet_areas.sum())


def _check_no_dent(
    samples: FrameSamples,
    residual_m: np.ndarray,  # (H, W), measured minus modelled range, m
    radius_m: float,
    membrane: np.ndarray,
    filled: np.ndarray,
) -> None:
    """Refuse a dome that is pressed in, as by a contact in every frame.

    The chosen surface is fitted robustly, and too smooth to follow more than a part of a dent.
    """
    inner = away_from_edges(filled, samples.statistics.correlation_length_px + 1.0)
    measured = inner & np.isfinite(residual_m)
    least = max(_SIGNIFICANT * robust_sigma(residual_m[measured & membrane]), _DEEP * radius_m)
    # The camera correlates neighbouring pixels in noise and in residuals alike. While a press
    # settles, the whole dome moves, and noise is correlated over more pixels; where the shape is
    # wrong, residuals are. So the smaller of both counts.
    usual = np.where(measured & membrane & (np.abs(residual_m) < least), residual_m, np.nan)
    of_residual = correlated_samples(spatial_correlation(usual[None], np.ones_like(usual)))
    together = min(samples.statistics.correlated_pixels, of_residual)
    known = (measured & membrane) | _steep_dents(measured & ~membrane, -residual_m)
    labels, _ = ndimage.label(known & (residual_m < -least), np.ones((3, 3)))
    sizes = np.bincount(labels.ravel())[1:]
    if sizes.max(initial=0) < max(_MIN_DENT_PIXELS, _MIN_DENT_SAMPLES * together):
        return
    patch = labels == 1 + np.argmax(sizes)
    depth = float(np.quantile(-residual_m[patch], 0.95))
    row, column = (round(float(x)) for x in ndimage.center_of_mass(patch))
    raise InputError(
        f"{samples.source_name}: in the frames taken as contact-free the membrane is pressed in by "
        f"{1e3 * depth:.1f} mm or more around pixel ({column}, {row}); record the membrane "
        "untouched, or choose other frames"
    )


def _steep_dents(outside: np.ndarray, depth_m: np.ndarray) -> np.ndarray:
    """Pixels (H, W) of dents that segmentation cut off the membrane because of their steep flanks.

    The distance from the edge explains most of a dent's variance in depth. A false return is as
    far off at its edge as in its middle.
    """
    pieces, _ = ndimage.label(_closed(outside))
    dents = np.zeros_like(outside)
    for k, sides in enumerate(ndimage.find_objects(pieces), start=1):
        box = tuple(slice(max(side.start - 1, 0), side.stop + 1) for side in sides)
        region = pieces[box] == k
        piece = region & outside[box]
        if np.count_nonzero(piece) < _MIN_DENT_PIXELS:
            continue
        inwards = ndimage.distance_transform_edt(region)[piece]
        if np.corrcoef(inwards, depth_m[box][piece])[0, 1] > np.sqrt(0.5):
            dents[box] |= piece
    return dents


def _closed(region: np.ndarray) -> np.ndarray:
    """Morphological closing of a region; pixels beyond the image border repeat its edge."""
    padded = np.pad(region, 3, mode="edge")
    closed: np.ndarray = ndimage.binary_closing(padded, iterations=2)[3:-3, 3:-3]
    return closed


# Motion of the dome relative to the camera while frames are collected.


_NOISE_LIMIT = 4.0  # standard deviations that noise does not exceed in some hundred frames
_MAX_MOTION = 5e-3  # of the dome's radius, which is the relative error that it causes in γ0


def check_motion(samples: FrameSamples) -> float:
    """Largest motion of the dome between frames, beyond noise, m.

    The motion is that of a fitted sphere's centre about its mean. Its noise follows from the
    residuals, with correlated ones counted as one.

    Raises InputError: the dome moves by more than 0.5 % of its radius.
    """
    statistics, camera = samples.statistics, samples.camera
    known, stride = traced_pixels(statistics)
    ranges = statistics.range_m.ravel()[known]
    points = camera.points_at(statistics.range_m, known)
    sphere = fit_sphere(points)
    near = np.abs(sphere.distance(points)) < 0.1 * sphere.semi_axes_m[0]
    known, points, ranges = known[near], points[near], ranges[near]
    # the radius is fixed; single precision, as in the images
    J = sphere.derivatives(points, sphere=True)[:, :3].astype(np.float32)
    facing = np.einsum("ij,ij->i", sphere.normals(points), camera.directions[known])
    to_range = camera.range_per_depth.ravel()[known]
    # J holds derivatives of the distance by the centre, so the step is minus the pseudo-inverse.
    solve = -np.linalg.pinv(J)
    change = np.nan_to_num((samples.traced_depth_m[:, near] * to_range - ranges) * facing).astype(
        np.float32
    )
    limit = np.float32(_NOISE_LIMIT / MAD) * median(np.abs(change))[:, None]
    moved = np.clip(change, -limit, limit) @ solve.T
    together = max(1.0, statistics.correlated_pixels / stride)
    noise = robust_sigma(change + moved @ J.T) * np.sqrt(together) * np.linalg.norm(solve, axis=1)
    motion = np.linalg.norm(np.maximum(np.abs(moved) - _NOISE_LIMIT * noise, 0.0), axis=1)
    worst = int(np.argmax(motion))
    if motion[worst] > _MAX_MOTION * sphere.semi_axes_m[0]:
        raise InputError(
            f"{samples.source_name}: the dome moves by {1e3 * motion[worst]:.2g} mm against the"
            f" camera in the contact-free frames (most in frame {samples.frames[worst]}); fasten "
            "the camera, let the gas settle, or choose frames without contact"
        )
    return float(motion[worst])
