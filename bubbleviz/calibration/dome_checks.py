"""Checks that contact-free frames show a still, visible dome that nothing touches."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from bubbleviz.calibration.ellipsoid import Ellipsoid, fit_sphere
from bubbleviz.calibration.fit_errors import tile_numbers, tile_side
from bubbleviz.calibration.rest_frames import FrameSamples, away_from_edges
from bubbleviz.camera import MAD, DepthCamera, median
from bubbleviz.errors import InputError
from bubbleviz.membrane import MembraneMesh
from bubbleviz.recordings import robust_sigma

_MIN_VISIBLE_SHARE = 0.5  # of the dome's area; chosen: the fit extrapolates over the rest
_SIGNIFICANT = 6.0  # robust standard deviations of the residual
_MIN_DENT_PIXELS = 20  # chosen: smaller dents are false returns
_MIN_DENT_DEPTH = 1e-2  # of the dome's radius: shallower deviations belong to the dome's shape


def check_dome(
    samples: FrameSamples,
    # cap fitted to their mean, and mesh of the chosen surface, in B
    cap: Ellipsoid,
    mesh: MembraneMesh,
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
    _check_no_dent(samples, cap, camera, membrane, filled)
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
    cap: Ellipsoid,
    camera: DepthCamera,
    membrane: np.ndarray,
    filled: np.ndarray,
) -> None:
    """Refuse a dome that is pressed in, as by a contact in every frame.

    Gas pressure alone makes a membrane bulge everywhere. A patch counts as a contact where it lies
    so deep inside the fitted cap, for its width, that the membrane has lost half of its curvature.
    Its width is that of the region where the deviation from the cap exceeds its own spread, not of
    the part where it is significant: near the border of the view, that can be a small corner.
    """
    ranges, edge_px = samples.statistics.range_m, samples.statistics.correlation_length_px
    points = camera.points_at(ranges, np.arange(ranges.size))
    residual_m = cap.distance(points).reshape(ranges.shape)  # negative inside
    pixel_m = ranges / np.sqrt(camera.intrinsics.fx * camera.intrinsics.fy)  # side on the membrane
    inner = away_from_edges(filled, edge_px + 1.0)
    measured = inner & np.isfinite(residual_m)
    known = measured & membrane
    spread = robust_sigma(residual_m[known])
    radius = float(np.prod(cap.semi_axes_m) ** (1.0 / 3.0))
    significant = np.nan_to_num(residual_m) < -_SIGNIFICANT * spread
    known |= _steep_dents(measured & ~membrane, -residual_m)
    deep = known & (np.nan_to_num(residual_m) < -spread)
    # A majority vote of neighbours removes single outliers and bridges holes in a patch.
    share = ndimage.uniform_filter(deep.astype(float), 5)
    deep = share > 0.5 * np.maximum(ndimage.uniform_filter(known.astype(float), 5), 1e-9)
    labels, count = ndimage.label(deep)
    for k in range(1, count + 1):
        region = labels == k
        patch = region & known
        deepest = patch & significant
        if np.count_nonzero(deepest) < _MIN_DENT_PIXELS:
            continue
        area = (
            float(np.sum(pixel_m[patch] ** 2)) * np.count_nonzero(region) / np.count_nonzero(patch)
        )
        depth = float(np.quantile(-residual_m[deepest], 0.95))
        flattened = area / np.pi / (4.0 * radius)  # r²/(4 R): half of the curvature is lost
        if depth > max(flattened, _MIN_DENT_DEPTH * radius):
            row, column = (round(float(x)) for x in ndimage.center_of_mass(deepest))
            raise InputError(
                f"{samples.source_name}: in the frames taken as contact-free the membrane is "
                f"pressed in by {1e3 * depth:.1f} mm around pixel ({column}, {row}); record the "
                "membrane untouched, or choose other frames"
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


_MAX_FITTED_PIXELS = 5_000  # in each frame: noise of 0.1 mm then moves a sphere by some 4 µm
_NOISE_LIMIT = 4.0  # standard deviations that noise does not exceed in some hundred frames
_MAX_MOTION = 5e-3  # of the dome's radius, which is the relative error that it causes in γ0


def check_motion(samples: FrameSamples) -> float:
    """Largest motion of the dome between frames, beyond noise, m.

    The motion is that of a fitted sphere's centre about its mean. Its noise comes from the
    residuals after the motion, summed over tiles, since neighbouring pixels are correlated.

    Raises InputError: the dome moves by more than 0.5 % of its radius.
    """
    statistics, camera = samples.statistics, samples.camera
    known = np.flatnonzero(statistics.validity >= statistics.regular_validity)
    known = known[:: max(1, len(known) // _MAX_FITTED_PIXELS)]
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
    depth = samples.depth_m.reshape(len(samples.depth_m), -1)[:, known]
    change = np.nan_to_num((depth * to_range - ranges) * facing).astype(np.float32)
    limit = np.float32(_NOISE_LIMIT / MAD) * median(np.abs(change))[:, None]
    moved = np.clip(change, -limit, limit) @ solve.T
    residual = np.clip(change + moved @ J.T, -limit, limit)
    side = tile_side(len(known), statistics.correlation_length_px)
    tile = tile_numbers(known, camera.intrinsics.width, max(side, 8))
    variance = np.zeros((len(residual), 3))
    for k in range(3):
        cells = np.stack([np.bincount(tile, row * solve[k]) for row in residual])
        variance[:, k] = np.sum(cells**2, axis=1)
    noise = np.sqrt(np.median(variance, axis=0))
    motion = np.linalg.norm(np.maximum(np.abs(moved) - _NOISE_LIMIT * noise, 0.0), axis=1)
    worst = int(np.argmax(motion))
    if motion[worst] > _MAX_MOTION * sphere.semi_axes_m[0]:
        raise InputError(
            f"{samples.source_name}: the dome moves by {1e3 * motion[worst]:.2g} mm against the"
            f" camera in the contact-free frames (most in frame {samples.frames[worst]}); fasten "
            "the camera, let the gas settle, or choose frames without contact"
        )
    return float(motion[worst])
