"""Validity checks of an identification; each error says what is wrong and what to do."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from scipy import ndimage

from bubbleviz.calibration.robust_statistics import robust_sigma
from bubbleviz.calibration.surface.cap_fit import Ellipsoid
from bubbleviz.calibration.surface.segmentation import away_from_edges
from bubbleviz.camera.depth_camera import DepthCamera
from bubbleviz.errors import InputError
from bubbleviz.frames.frame_source import FrameSource
from bubbleviz.membrane.mesh import MembraneMesh

_LEAST_SEEN = 0.5  # of the dome's area; chosen: the rest is the fit's continuation
_SIGNIFICANT = 6.0  # standard deviations of a tile
_LEAST_PIXELS = 20  # in a dent that counts; chosen: smaller ones are false returns
_DEEP = 1e-2  # of the dome's radius: what is shallower is the dome's own shape


@contextmanager
def errors_name(source: FrameSource) -> Iterator[None]:
    """Put the name of a source before errors of steps that do not know it."""
    try:
        yield
    except InputError as error:
        if source.name in str(error):
            raise
        raise InputError(f"{source.name}: {error}") from error


def seen_share(mesh: MembraneMesh, camera: DepthCamera, membrane: np.ndarray) -> float:
    """Share of a dome's area that the camera sees.

    Parameters
    ----------
    mesh : MembraneMesh
        The fitted dome over the rim plane, in B.
    camera : DepthCamera
    membrane : (H, W) bool array
        Pixels that see the membrane; holes in it count as seen.
    """
    centres = mesh.nodes[mesh.triangles].mean(axis=1)
    T = camera.T_B_C
    uv = np.rint(camera.intrinsics.project((centres - T[:3, 3]) @ T[:3, :3])).astype(int)
    height, width = membrane.shape
    inside = ((uv >= 0) & (uv < (width, height))).all(axis=1)
    filled = ndimage.binary_fill_holes(_closed(membrane))
    seen = np.zeros(len(uv), bool)
    seen[inside] = filled[uv[inside, 1], uv[inside, 0]]
    return float(mesh.facet_areas[seen].sum() / mesh.facet_areas.sum())


def check_seen(name: str, share: float) -> None:
    """Refuse a dome of which less than half is seen."""
    if share < _LEAST_SEEN:
        raise InputError(
            f"{name}: only {100 * share:.0f} % of the dome is seen: the shape of the rest, the"
            " volume under it and so γ0 cannot be known; uncover the camera, or give the sensor"
            " file of this camera's pose"
        )


def check_no_dent(
    name: str,
    residual_m: np.ndarray,
    membrane: np.ndarray,
    edge_px: float,
    pixel_m: np.ndarray,
    dome: Ellipsoid,
) -> None:
    """Refuse a dome that is pressed in: contact in every frame, as far as it can be told.

    A patch of the surface that lies deep inside the cap that fits the rest, so deep for its
    width that the membrane has lost half of its curvature there, is a contact: gas pressure
    alone makes a membrane bulge everywhere.

    Parameters
    ----------
    residual_m : (H, W) array
        Distance of the measured from the fitted surface, m, negative inside; NaN: none.
    membrane : (H, W) bool array
    edge_px : float
        How far from the membrane's outer edge, in pixels, a measurement can be trusted.
    pixel_m : (H, W) array
        Side of a pixel on the membrane, m.
    dome : Ellipsoid
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
                f" ({column}, {row}) in all of the frames; take the object away, or name"
                " contact-free frames"
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
