"""Where an object has slid to on a face that lies flat: what the whole depth image says.

Contact normals do not see a flat face slide or turn in its plane, but the membrane around it moves
along. So the depth image is compared with the membrane that the object would make, for motions in
those directions only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.camera.observer import RangeObserver
from bubbleviz.camera.raycast import RayCaster
from bubbleviz.pose.contact_points import ContactPoints
from bubbleviz.pose.observability import Directions
from bubbleviz.pose.pressed_membrane import AROUND_M, PressedMembrane
from bubbleviz.pose.rigid_motion import about, motion_between

_TRUST = 0.3
"""Share of the pixels' information that is left: what the facets of the model get wrong lasts until
the object's edge is on others, and has twice the variance of the noise averaged over that time."""

_OUTLYING = 4.0
"""Residual in σ from which a pixel is no witness."""

_MOST = 10_000
"""Pixels beyond which more of them say too little for their time."""

_LEAST_SIGMA_M = 5e-4
"""Noise below which it is the model that is wrong."""

_MAD = 0.6745
"""Median of |z| of a standard normal z."""

_WIDE = 0.6
"""Width of the steps of derivatives to both sides, at the patch's edge, in edges of the mesh: both
together go over a whole facet, so that it does not matter where on it the edge is."""

_VALID, _FAR = 0.3, 0.6
"""Way of the patch's edge, in edges of the mesh, over which derivatives hold, and that one step may
go: derivatives are found anew at its end."""

_MODEL_DEVIATION_M = 5e-4
"""How far the model may be off in the determined directions."""


@dataclass(frozen=True)
class Slide:
    """A step in the open directions, and the information about them.

    Attributes
    ----------
    motion : (6,) array
        In B about the patch's centre.
    information : (6, 6) array
    ended : bool
        It was so short that derivatives hold to its end.
    """

    motion: np.ndarray
    information: np.ndarray
    ended: bool


@dataclass(frozen=True)
class PredictedImage:
    """The depth image that the object would make, linear around a pose.

    Attributes
    ----------
    T_B_O : (4, 4) array
    center : (3,) array
    pixel : (b,) int array
        Which of the observer's pixels are looked at.
    every : int
        How many of those that could be each stands for.
    expected_m : (b,) array
        Residuals of these pixels, as the observer has them, at the pose.
    jacobian : (b, 6) array
        Their derivatives by small motions in B about the centre.
    """

    T_B_O: np.ndarray
    center: np.ndarray
    pixel: np.ndarray
    every: int
    expected_m: np.ndarray
    jacobian: np.ndarray

    def residual_m(self, change_m: np.ndarray, T_B_O: np.ndarray) -> np.ndarray:
        """Measured minus modelled (b,) at a pose close by; NaN where there is no return."""
        way = motion_between(self.T_B_O, T_B_O, self.center)
        residual: np.ndarray = change_m[self.pixel] - self.expected_m - self.jacobian @ way
        return residual


class Sliding:
    """Follows one object in the directions that its contact leaves open.

    Parameters
    ----------
    observer : RangeObserver
    pressed : PressedMembrane
        Of that object; its facets are those of the observer's mesh.
    """

    def __init__(self, observer: RangeObserver, pressed: PressedMembrane) -> None:
        self._observer, self._pressed, self.mesh = observer, pressed, pressed.mesh
        camera = observer.camera
        self._directions = camera.directions[observer.pixel]
        caster = RayCaster(camera.center, self._directions, self.mesh.triangles)
        at_rest = caster.cast(self.mesh.nodes, self.mesh.normals)
        self._rest_m = np.full(len(observer.pixel), np.nan)
        self._rest_m[at_rest.ray] = at_rest.range_m
        self._places = camera.center + self._rest_m[:, None] * self._directions
        self.forget()

    def forget(self) -> None:
        """Look anew at the next frame."""
        self._predicted: PredictedImage | None = None

    def step(
        self,
        depth_m: np.ndarray,
        contact: ContactPoints,
        T_B_O: np.ndarray,
        directions: Directions,
        known: np.ndarray,
        pull: np.ndarray,
    ) -> Slide:
        """One Gauss–Newton step in the open directions.

        The other directions are solved for too, and left: the model's own error, which is mostly
        along the membrane's normal, is theirs to take up.

        Parameters
        ----------
        depth_m : (H, W) array
        contact : ContactPoints
        T_B_O : (4, 4) array
            Pose that is best in the determined directions.
        directions : Directions
        known : (6, 6) array
            Information there is already.
        pull : (6,) array
            Gradient of what is known at `T_B_O`.
        """
        predicted = self._at(T_B_O, contact, directions)
        residual = predicted.residual_m(self._observer.pixel_residuals(depth_m), T_B_O)
        seen = np.isfinite(residual)
        J = predicted.jacobian[seen] @ about(contact.center, predicted.center) @ directions.motions
        weight = predicted.every * _TRUST * _weights(residual[seen])
        H, g = (J.T * weight) @ J, -J.T @ (weight * residual[seen])
        H[np.diag_indices(6)] += directions.determined / _MODEL_DEVIATION_M**2
        # Schur complement of the determined directions.
        free = ~directions.determined
        gain = np.linalg.solve(H[~free][:, ~free], H[~free][:, free]).T
        H, g = H[free][:, free] - gain @ H[~free][:, free], g[free] - gain @ g[~free]
        motions, edge = directions.motions[:, free], self.mesh.edge_length
        step = -np.linalg.solve(H + motions.T @ known @ motions, g + motions.T @ pull)
        step = np.clip(step, -_FAR * edge, _FAR * edge)
        inverse = np.linalg.pinv(motions)
        ended = bool(np.abs(step).max() < _VALID * edge)
        return Slide(motions @ step, inverse.T @ H @ inverse, ended)

    def _at(
        self, T_B_O: np.ndarray, contact: ContactPoints, directions: Directions
    ) -> PredictedImage:
        """The linear model around a pose, or the last one where it still holds."""
        known = self._predicted
        if known is not None:
            way = motion_between(known.T_B_O, T_B_O, contact.center)
            ways = np.linalg.solve(directions.motions, way)
            if np.abs(ways).max() < _VALID * self.mesh.edge_length:
                return known
        self._predicted = self._looked(T_B_O, contact, directions)
        return self._predicted

    def _looked(
        self, T_B_O: np.ndarray, contact: ContactPoints, directions: Directions
    ) -> PredictedImage:
        """Derivatives over wide steps in the open directions."""
        mesh, motions, free = self.mesh, directions.motions, ~directions.determined
        press = self._pressed.press(T_B_O, contact)
        width = _WIDE * mesh.edge_length
        slopes = np.empty((len(mesh.nodes), 6))
        slopes[:, ~free] = self._pressed.lifted(press, motions[:, ~free], contact.center)
        steps = width * motions[:, free].T
        forth, back = np.split(
            self._pressed.slid(press, np.concatenate([steps, -steps]), contact.center), 2, axis=1
        )
        slopes[:, free] = (forth - back) / (2.0 * width)
        reach = contact.extent_m + AROUND_M
        pixel = np.flatnonzero(_near(self._places, contact.rest_center, reach))
        every = max(1, -(-len(pixel) // _MOST))
        pixel = pixel[::every]
        close = _near(mesh.nodes, contact.rest_center, reach + 2.0 * mesh.edge_length)
        triangles = mesh.triangles[close[mesh.triangles].any(axis=1)]
        caster = RayCaster(self._observer.camera.center, self._directions[pixel], triangles)
        hits = caster.cast(mesh.deformed(press.displacement_m), mesh.normals)
        pixel = pixel[hits.ray]
        J = np.einsum("bi,bik->bk", hits.sensitivity, slopes[triangles[hits.triangle]])
        return PredictedImage(
            T_B_O=T_B_O,
            center=contact.center,
            pixel=pixel,
            every=every,
            expected_m=hits.range_m - self._rest_m[pixel],
            jacobian=np.linalg.solve(motions.T, J.T).T,
        )


def _weights(residual_m: np.ndarray) -> np.ndarray:
    """1/σ² of pixels by their residuals (b,), less where they are outliers."""
    if not len(residual_m):
        return residual_m
    sigma = max(float(np.median(np.abs(residual_m))) / _MAD, _LEAST_SIGMA_M)
    outlying = (residual_m / (_OUTLYING * sigma)) ** 2
    weights: np.ndarray = 1.0 / (sigma * (1.0 + outlying)) ** 2
    return weights


def _near(points: np.ndarray, center: np.ndarray, reach_m: float) -> np.ndarray:
    return np.asarray(np.linalg.norm(points - center, axis=1) < reach_m)
