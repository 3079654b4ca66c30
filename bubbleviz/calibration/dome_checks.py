"""What would make contact-free frames worthless; each error says what is wrong and what to do."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from bubbleviz.calibration.ellipsoid import Ellipsoid, fit_sphere
from bubbleviz.calibration.errors import tile_numbers, tile_side
from bubbleviz.calibration.rest_frames import Samples
from bubbleviz.calibration.segmentation import away_from_edges
from bubbleviz.camera import MAD, DepthCamera, median
from bubbleviz.errors import InputError
from bubbleviz.membrane import MembraneMesh
from bubbleviz.recordings import robust_sigma

_LEAST_SEEN = 0.5  # of the dome's area; chosen: the rest is the fit's continuation
_SIGNIFICANT = 6.0  # standard deviations of a tile
_LEAST_PIXELS = 20  # in a dent that counts; chosen: smaller ones are false returns
_DEEP = 1e-2  # of the dome's radius: what is shallower is the dome's own shape


def check_dome(
    samples: Samples,
    cap: Ellipsoid,  # fitted to their mean, in B
    camera: DepthCamera,
    membrane: np.ndarray,  # (H, W) bool, pixels that see the membrane
) -> float:
    """Refuse a dome pressed in or half unseen; share of it that is seen."""
    name, ranges = samples.source_name, samples.statistics.range_m
    seen = _seen_share(cap.fine, camera, membrane)
    if seen < _LEAST_SEEN:
        raise InputError(
            f"{name}: only {100 * seen:.0f} % of the dome is visible: its shape at rest, its "
            "volume and γ0 cannot be determined; uncover the camera, or give a sensor file with "
            "this camera's pose"
        )
    points = camera.points_at(ranges, np.arange(ranges.size))
    residual = cap.distance(points).reshape(ranges.shape)
    pixel_m = ranges / np.sqrt(camera.intrinsics.fx * camera.intrinsics.fy)
    reach = samples.statistics.correlation_length_px
    _check_no_dent(name, residual, membrane, reach, pixel_m, cap)
    return seen


def _seen_share(
    mesh: MembraneMesh,  # the fitted dome over the rim plane, in B
    camera: DepthCamera,
    membrane: np.ndarray,  # (H, W) bool, pixels that see the membrane; holes in it count as seen
) -> float:
    """Share of a dome's area that the camera sees."""
    centres = mesh.nodes[mesh.triangles].mean(axis=1)
    T = camera.T_B_C
    uv = np.rint(camera.intrinsics.project((centres - T[:3, 3]) @ T[:3, :3])).astype(int)
    height, width = membrane.shape
    inside = ((uv >= 0) & (uv < (width, height))).all(axis=1)
    filled = ndimage.binary_fill_holes(_closed(membrane))
    seen = np.zeros(len(uv), bool)
    seen[inside] = filled[uv[inside, 1], uv[inside, 0]]
    return float(mesh.facet_areas[seen].sum() / mesh.facet_areas.sum())


def _check_no_dent(
    name: str,
    # (H, W), distance of the measured from the fitted surface, m, negative inside; NaN: none
    residual_m: np.ndarray,
    membrane: np.ndarray,  # (H, W) bool
    # how far from the membrane's outer edge, in pixels, a measurement can be trusted
    edge_px: float,
    pixel_m: np.ndarray,  # (H, W), side of a pixel on the membrane, m
    dome: Ellipsoid,
) -> None:
    """Refuse a dome that is pressed in: contact in every frame, as far as it can be told.

    A patch of the surface that lies deep inside the cap that fits the rest, so deep for its
    width that the membrane has lost half of its curvature there, is a contact: gas pressure
    alone makes a membrane bulge everywhere.
    """
    inner = away_from_edges(ndimage.binary_fill_holes(_closed(membrane)), edge_px + 1.0)
    seen = inner & np.isfinite(residual_m)
    known = seen & membrane
    spread = robust_sigma(residual_m[known])
    radius = float(np.prod(dome.semi_axes_m) ** (1.0 / 3.0))
    below = np.nan_to_num(residual_m) < -_SIGNIFICANT * spread
    known |= _dents_apart(seen & ~membrane, -residual_m)
    deep = known & below
    # Most of a pixel's neighbours: single pixels err, and holes must not tear a patch apart.
    share = ndimage.uniform_filter(deep.astype(float), 5)
    deep = share > 0.5 * np.maximum(ndimage.uniform_filter(known.astype(float), 5), 1e-9)
    labels, count = ndimage.label(deep)
    for k in range(1, count + 1):
        whole = labels == k
        patch = whole & known
        if np.count_nonzero(patch) < _LEAST_PIXELS:
            continue
        area = (
            float(np.sum(pixel_m[patch] ** 2)) * np.count_nonzero(whole) / np.count_nonzero(patch)
        )
        depth = float(np.quantile(-residual_m[patch], 0.95))
        flattened = area / np.pi / (4.0 * radius)  # r²/(4 R): half of the curvature is gone
        if depth > max(flattened, _DEEP * radius):
            row, column = (round(float(x)) for x in ndimage.center_of_mass(patch))
            raise InputError(
                f"{name}: the membrane is pressed in by {1e3 * depth:.1f} mm around pixel"
                f" ({column}, {row}) in all frames; remove the object, or choose contact-free "
                "frames"
            )


def _dents_apart(apart: np.ndarray, depth_m: np.ndarray) -> np.ndarray:
    """Pixels (H, W) of dents whose flanks are so steep that a step separates them.

    A dent gets deeper from its edge to its middle, and most of its variance is told by that;
    a false return is as far off at its edge.
    """
    pieces, count = ndimage.label(_closed(apart))
    dents = np.zeros_like(apart)
    for k in range(1, count + 1):
        whole = pieces == k
        piece = whole & apart
        if np.count_nonzero(piece) < _LEAST_PIXELS:
            continue
        inwards, depth = ndimage.distance_transform_edt(whole)[piece], depth_m[piece]
        if np.corrcoef(inwards, depth)[0, 1] > np.sqrt(0.5):
            dents |= piece
    return dents


def _closed(region: np.ndarray) -> np.ndarray:
    """Morphological closing of a region; pixels beyond the image border repeat its edge."""
    padded = np.pad(region, 3, mode="edge")
    closed: np.ndarray = ndimage.binary_closing(padded, iterations=2)[3:-3, 3:-3]
    return closed


# The dome does not move relative to the camera while frames are collected.


_PIXELS = 20_000  # fitted in each frame; chosen for run time
_ROUNDS, _STILL_M = 5, 1e-9  # outliers give way to the motion, until it changes by less
_LOUD = 4.0  # standard deviations that noise does not reach in some hundred frames
_WANDER = 5e-3  # of the dome's radius: the error it would put on γ0


def check_still(samples: Samples) -> float:
    """Refuse frames between which the dome moves as a whole; how far it does beyond noise, m.

    The motion is that of a sphere's centre about its mean, its noise that of the residuals after
    the motion, over tiles, since neighbours share it.
    """
    statistics, camera = samples.statistics, samples.camera
    known = np.flatnonzero(statistics.validity >= statistics.regular_validity)
    known = known[:: max(1, len(known) // _PIXELS)]
    ranges = statistics.range_m.ravel()[known]
    points = camera.points_at(statistics.range_m, known)
    sphere = fit_sphere(points)
    near = np.abs(sphere.distance(points)) < 0.1 * sphere.semi_axes_m[0]
    known, points, ranges = known[near], points[near], ranges[near]
    # of one size, wherever it is; single precision, as the images have
    J = sphere.derivatives(points, sphere=True)[:, :3].astype(np.float32)
    facing = np.einsum("ij,ij->i", sphere.normals(points), camera.directions[known])
    to_range = camera.range_per_depth.ravel()[known]
    # Derivatives are of the distance for motion of the sphere, so that −distance moves it there.
    solve = -np.linalg.pinv(J)
    depth = samples.depth_m.reshape(len(samples.depth_m), -1)[:, known]
    change = np.nan_to_num((depth * to_range - ranges) * facing).astype(np.float32)
    moved = np.zeros((len(change), 3), np.float32)
    for _ in range(_ROUNDS):
        left = change + moved @ J.T
        limit = np.float32(_LOUD / MAD) * median(np.abs(left))[:, None]
        step = np.clip(left, -limit, limit) @ solve.T
        moved = moved + step
        if np.abs(step).max() < _STILL_M:
            break
    left = np.clip(change + moved @ J.T, -limit, limit)
    side = tile_side(len(known), statistics.correlation_length_px)
    tile = tile_numbers(known, camera.intrinsics.width, max(side, 8))
    variance = np.zeros((len(left), 3))
    for k in range(3):
        cells = np.stack([np.bincount(tile, row * solve[k]) for row in left])
        variance[:, k] = np.sum(cells**2, axis=1)
    noise = np.sqrt(np.median(variance, axis=0))
    wander = np.linalg.norm(np.maximum(np.abs(moved) - _LOUD * noise, 0.0), axis=1)
    worst = int(np.argmax(wander))
    if wander[worst] > _WANDER * sphere.semi_axes_m[0]:
        raise InputError(
            f"{samples.source_name}: the dome moves by {1e3 * wander[worst]:.2g} mm against the"
            f" camera in the contact-free frames (most in frame {samples.frames[worst]}): fix the"
            " camera, let the gas settle, or choose frames without contact"
        )
    return float(wander[worst])
