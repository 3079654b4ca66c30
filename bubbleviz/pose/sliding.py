"""Where an object has slid to on a face that lies flat: what the whole depth image says.

Contact normals do not see a flat face slide or turn in its plane, but the membrane around it moves
along. So the depth image is compared with the membrane that the object would make, for motions in
those directions only. Steps are as wide as the mesh: below that, the membrane's facets decide.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.camera.observer import RangeObserver
from bubbleviz.camera.raycast import RayCaster
from bubbleviz.camera.view import MembraneView
from bubbleviz.pose.contact import ContactPoints
from bubbleviz.pose.motion import moved
from bubbleviz.pose.pressed import PressedMembrane
from bubbleviz.pose.uncertainty import Directions
from bubbleviz.result import Estimate

_TRUST = 0.05
"""Share of the pixels' information that the facets of the model leave, whose errors last as long as
the object is on the same facets."""

_OUTLYING = 4.0
"""Residual in σ from which a pixel is no witness."""

_MOST = 1_800
"""Pixels beyond which more of them say too little for their time."""

_LEAST_SIGMA_M = 5e-4
"""Noise below which it is the model that is wrong."""

_MAD = 0.6745
"""Median of |z| of a standard normal z."""

_WIDE = 0.6
_NARROW_M = 3e-4
"""Width of the steps at the patch's edge, in open directions in edges of the mesh."""

_MODEL_DEVIATION_M = 5e-4
"""How far the model may be off in the determined directions."""

_AROUND_M = 0.020
"""How far around the patch pixels are looked at."""


@dataclass(frozen=True)
class Slide:
    """A step in the open directions, and the information about them.

    Attributes
    ----------
    motion : (6,) array
        In B about the patch's centre.
    information : (6, 6) array
    """

    motion: np.ndarray
    information: np.ndarray


@dataclass(frozen=True)
class Sight:
    """The depth image around the patch.

    Attributes
    ----------
    corners : (b, 3) int array
        Nodes of the triangle that each pixel sees.
    sensitivity : (b, 3) array
        Derivative of its range by their displacement.
    residual_m : (b,) array
        Its range, such that sensitivity · displacement models it.
    weight : float
        1/σ² of each and of those left out for it.
    """

    corners: np.ndarray
    sensitivity: np.ndarray
    residual_m: np.ndarray
    weight: float

    def model(self, displacements_m: np.ndarray) -> np.ndarray:
        """Ranges (s, b) of displacements (s, n)."""
        return np.einsum("bi,sbi->sb", self.sensitivity, displacements_m[:, self.corners])


class Viewer:
    """Looks at depth images around the contact.

    Parameters
    ----------
    observer : RangeObserver
    """

    def __init__(self, observer: RangeObserver) -> None:
        self._observer, self._mesh = observer, observer.mesh
        camera = observer.camera
        view = MembraneView(camera, observer.mesh)
        at_rest = view.hits(np.zeros(len(observer.mesh.nodes)), np.sort(observer.pixel))
        rest = np.full(view.shape[0] * view.shape[1], np.nan)
        rest[at_rest.ray] = at_rest.range_m
        self._rest_m = rest[observer.pixel]
        self._directions = camera.directions[observer.pixel]
        self._places = camera.center + self._rest_m[:, None] * self._directions

    def look(self, depth_m: np.ndarray, estimate: Estimate, contact: ContactPoints) -> Sight:
        """What a depth image (H, W) shows around the contact."""
        mesh = self._mesh
        reach = 2.0 * contact.radius_m + _AROUND_M
        change = self._observer.pixel_residuals(depth_m)
        near = np.linalg.norm(self._places - contact.center, axis=1) < reach
        pixel = np.flatnonzero(near & np.isfinite(change))
        every = max(1, -(-len(pixel) // _MOST))
        pixel = pixel[::every]
        nodes = mesh.deformed(estimate.displacement_m)
        close = np.linalg.norm(nodes - contact.center, axis=1) < reach + 2.0 * mesh.edge_length
        triangles = mesh.triangles[close[mesh.triangles].any(axis=1)]
        caster = RayCaster(self._observer.camera.center, self._directions[pixel], triangles)
        hits = caster.cast(nodes, mesh.normals)
        corners = triangles[hits.triangle]
        seen = pixel[hits.ray]
        missed = change[seen] + self._rest_m[seen] - hits.range_m
        along = np.einsum("bi,bi->b", hits.sensitivity, estimate.displacement_m[corners])
        sigma = np.median(np.abs(missed)) / _MAD if len(missed) else np.inf
        weight = every / max(sigma, _LEAST_SIGMA_M) ** 2
        return Sight(corners, hits.sensitivity, missed + along, weight)


def slide(
    pressed: PressedMembrane,
    sight: Sight,
    contact: ContactPoints,
    T_B_O: np.ndarray,
    directions: Directions,
    known: np.ndarray,
) -> Slide:
    """One Gauss–Newton step in the open directions, with derivatives over wide steps.

    The other directions are solved for too, and left: the model's own error, which is mostly along
    the membrane's normal, is theirs to take up.

    Parameters
    ----------
    pressed : PressedMembrane
    sight : Sight
    contact : ContactPoints
    T_B_O : (4, 4) array
        Pose that is best in the determined directions.
    directions : Directions
    known : (6, 6) array
        Information there is already, with its best at `T_B_O`.
    """
    wide = _WIDE * pressed.mesh.edge_length
    width = np.where(directions.determined, _NARROW_M, wide)
    motions = directions.motions
    forth = (width * motions).T
    back = -forth[~directions.determined]
    poses = [moved(T_B_O, step, contact.center) for step in (*forth, *back)]
    ranges = sight.model(pressed.press(np.stack([T_B_O, *poses]), contact))
    behind = np.repeat(ranges[:1], 6, axis=0)
    behind[~directions.determined] = ranges[7:]
    J = (behind - ranges[1:7]).T / (width * (1.0 + ~directions.determined))
    residual = sight.residual_m - ranges[0]
    # Over wide steps the misfit falls by the mean of the residuals at both ends.
    ends = sight.residual_m - 0.5 * (ranges[1:7] + behind)
    outlying = residual**2 * sight.weight / _OUTLYING**2
    weight = _TRUST * sight.weight / (1.0 + outlying) ** 2
    free = ~directions.determined
    H = (J.T * weight) @ J
    g = np.where(free, np.einsum("bk,b,kb->k", J, weight, ends), J.T @ (weight * residual))
    H[np.diag_indices(6)] += 1.0 / _MODEL_DEVIATION_M**2 * directions.determined
    # Schur complement of the determined directions.
    gain = np.linalg.solve(H[~free][:, ~free], H[~free][:, free]).T
    H, g = H[free][:, free] - gain @ H[~free][:, free], g[free] - gain @ g[~free]
    open_motions = motions[:, free]
    step = -np.linalg.solve(H + open_motions.T @ known @ open_motions, g)
    step = np.clip(step, -wide, wide)  # beyond, the derivative is another one
    inverse = np.linalg.pinv(open_motions)
    return Slide(open_motions @ step, inverse.T @ H @ inverse)
