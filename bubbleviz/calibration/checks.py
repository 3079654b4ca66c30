"""What an identification refuses: each check says what is wrong and what to do."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from bubbleviz.calibration.robust import robust_sigma
from bubbleviz.calibration.surface_fit import Ellipsoid
from bubbleviz.camera.depth_camera import DepthCamera
from bubbleviz.errors import InputError
from bubbleviz.membrane.mesh import MembraneMesh

_LEAST_SEEN = 0.5
_SIGNIFICANT = 6.0  # standard deviations of a tile
_LOUD = 4.0  # standard deviations that noise does not reach in some hundred frames
_WANDER = 5e-3  # of the dome's radius: the error it would put on γ0


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
    filled = ndimage.binary_fill_holes(ndimage.binary_closing(membrane, iterations=2))
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


def check_still(
    name: str,
    frames: tuple[int, ...],
    centres_m: np.ndarray,
    noise_m: np.ndarray,
    radius_m: float,
) -> float:
    """Refuse frames between which the dome moves as a whole; return how far it does, m.

    Parameters
    ----------
    frames : tuple of int
    centres_m : (F, 3) array
        Centre of the dome in every frame, about the mean, m.
    noise_m : (3,) array
        Standard deviation of each coordinate that the depth noise alone makes, m.
    radius_m : float
    """
    beyond = np.maximum(np.abs(centres_m) - _LOUD * noise_m, 0.0)
    wander = np.linalg.norm(beyond, axis=1)
    worst = int(np.argmax(wander))
    if wander[worst] > _WANDER * radius_m:
        raise InputError(
            f"{name}: the dome moves by {1e3 * wander[worst]:.2g} mm against the camera in the"
            f" contact-free frames (most in frame {frames[worst]}): fix the camera, let the gas"
            " settle, or name frames without contact"
        )
    return float(wander[worst])


def check_no_dent(
    name: str, residual_m: np.ndarray, use: np.ndarray, pixel_m: np.ndarray, dome: Ellipsoid
) -> None:
    """Refuse a dome that is pressed in: contact in every frame, as far as it can be told.

    A patch of the surface that lies deep inside the cap that fits the rest, so deep for its
    width that the membrane has lost half of its curvature there, is a contact: gas pressure
    alone makes a membrane bulge everywhere.

    Parameters
    ----------
    residual_m : (H, W) array
        Measured minus fitted range, m, negative inside; NaN: none.
    use : (H, W) bool array
    pixel_m : (H, W) array
        Side of a pixel on the membrane, m.
    dome : Ellipsoid
    """
    known = use & np.isfinite(residual_m)
    spread = robust_sigma(residual_m[known])
    radius = float(np.prod(dome.semi_axes_m) ** (1.0 / 3.0))
    deep = known & (np.nan_to_num(residual_m) < -_SIGNIFICANT * spread)
    deep = ndimage.binary_opening(deep, iterations=1)
    labels, count = ndimage.label(deep)
    for k in range(1, count + 1):
        patch = labels == k
        area = float(np.sum(pixel_m[patch] ** 2))
        depth = float(np.quantile(-residual_m[patch], 0.95))
        flattened = area / np.pi / (4.0 * radius)  # r²/(4 R): half of the curvature is gone
        if depth > flattened and np.count_nonzero(patch) > 20 and depth > 1e-2 * radius:
            row, column = (round(float(x)) for x in ndimage.center_of_mass(patch))
            raise InputError(
                f"{name}: the membrane is pressed in by {1e3 * depth:.1f} mm around pixel"
                f" ({column}, {row}) in all of the frames; take the object away, or name"
                " contact-free frames"
            )
