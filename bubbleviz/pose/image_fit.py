"""Pose fit to the whole depth image, compared with the membrane predicted for the object.

Contact normals do not change when a flat face slides or turns in its plane, but the membrane around
it does. The contact follows from the model of the membrane, not from a threshold.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bubbleviz.camera import (
    MAD,
    RangeObserver,
    RayCaster,
    camera_shift,
    range_errors,
    range_shifts,
    sparse_rows,
    vector_columns,
)
from bubbleviz.pose.motion import SEARCH_INFORMATION, about, motion_between, turning, way_at
from bubbleviz.pose.pressed_membrane import ROUNDING_M, Press, PressedMembrane
from bubbleviz.pose.registration import MODEL_ERROR_M, ContactPoints, Directions

_AROUND_M = 8e-3  # around the patch pixels are compared; further away the membrane hardly moves
_OUTLIER_SIGMAS = 4.0  # residual in standard deviations that reduces a pixel to a quarter
_MODEL_DEVIATION_M = 5e-4
"""Model error of the membrane around the contact, due to stiffness and gas, expressed as motions of
the object."""


@dataclass(frozen=True)
class ImageStep:
    """A step of the pose."""

    information: np.ndarray  # (6, 6), about small motions in B about the patch's centre
    gradient: np.ndarray  # (6,), of the log-likelihood
    # (6, 6), covariance of the pose by model errors, which are correlated from frame to frame
    persistent: np.ndarray


@dataclass(frozen=True)
class PredictedImage:
    """Predicted depth image, linear around a pose."""

    pixel: np.ndarray  # (b, e) int, the compared groups of e pixels among the observer's
    expected_m: np.ndarray  # (b,), their mean residuals at the pose, as of `RangeObserver`
    jacobian: np.ndarray  # (b, 6), their derivatives by small motions in B about the press's centre
    on_face: np.ndarray  # (b,) bool, groups on membrane that lies on a face
    rounding: np.ndarray  # (b,), derivatives of their residuals by the radius of the object's edges
    by_image: np.ndarray  # (b, e), under a unit of each of `IMAGE_ERRORS`
    square: np.ndarray  # (b,) int, their square of the image, as wide as an edge of the mesh
    triangles: int  # of the membrane in these pixels
    press: Press
    by_loads_m: float = 0.0  # largest motion of a node by changes of friction and gas pressure

    def at(self, T_B_O: np.ndarray) -> np.ndarray:
        """Expected residuals at a nearby pose, (b,)."""
        return self.expected_m + self.jacobian @ self._motion_to(T_B_O)

    def slopes_at(self, T_B_O: np.ndarray, center: np.ndarray) -> np.ndarray:
        """Derivatives (b, 6) at a nearby pose by small motions about a centre (3,).

        They move along with the object, as does the axis about which a round object can spin
        without effect.
        """
        motion = self._motion_to(T_B_O)
        there = turning(motion).T @ about(center, self.press.center + motion[:3])
        return self.jacobian @ there

    def way_m(self, T_B_O: np.ndarray, radius_m: float) -> float:
        """Upper bound of the patch edge's motion since the press, m, without spins in itself."""
        return way_at(radius_m, self.press.seen @ self._motion_to(T_B_O)) + self.by_loads_m

    def _motion_to(self, T_B_O: np.ndarray) -> np.ndarray:
        return motion_between(self.press.T_B_O, T_B_O, self.press.center)


class ImageFit:
    """Fits the pose of one object to depth images."""

    def __init__(
        self,
        observer: RangeObserver,
        pressed: PressedMembrane,  # of that object, on the observer's mesh
        max_pixels: int = 6_000,  # beyond, as many groups of neighbours are averaged
    ) -> None:
        self._observer, self._pressed, self._max_pixels = observer, pressed, max_pixels
        camera = observer.camera
        self._directions = camera.directions[observer.pixel]
        mesh = pressed.mesh
        caster = RayCaster(camera.center, self._directions, mesh.triangles)
        at_rest = caster.cast(mesh.nodes)
        self._rest_m = np.full(len(observer.pixel), np.nan)
        self._rest_m[at_rest.ray] = at_rest.range_m
        self._places = camera.center + self._rest_m[:, None] * self._directions
        self._places2 = np.einsum("ij,ij->i", self._places, self._places)
        self.reset()

    def reset(self) -> None:
        """Drop the linear model of the previous frame."""
        self._predicted: PredictedImage | None = None
        self._pressed_at: np.ndarray | None = None  # pose of the last press, failed or not
        self._pressed.reset()

    def load(self, contact: ContactPoints, gas_pressure_pa: float | None) -> None:
        """Update friction and gas pressure of the linear model of the previous frame."""
        if self._predicted is not None:
            motion = self._predicted.press.motion_by(contact, gas_pressure_pa)
            self._predicted = replace(self._predicted, by_loads_m=float(np.abs(motion).max()))

    def step(
        self,
        change_m: np.ndarray,  # (k,), `RangeObserver.pixel_residuals` of the depth image
        contact: ContactPoints,
        T_B_O: np.ndarray,  # (4, 4)
        directions: Directions,  # motions, and which of them the contact determines
        *,
        # motion of the patch's edge up to which the last linear model is reused
        valid_m: float,
        gas_pressure_pa: float | None = None,  # measured, absolute
    ) -> ImageStep | None:
        """One Gauss–Newton step; None if the model finds no equilibrium.

        The membrane on a face is at the object's surface; the membrane around it also depends on
        stiffness and gas. Its model error, modelled as a motion in the directions that the contact
        determines, is marginalised. So the faces determine these directions, and the surrounding
        membrane the others.
        """
        predicted = self.predicted(T_B_O, contact, gas_pressure_pa, valid_m=valid_m)
        if predicted is None:
            return None
        change = change_m[predicted.pixel]
        count = np.isfinite(change).sum(axis=1)
        residual = np.nansum(change, axis=1) / np.maximum(count, 1) - predicted.at(T_B_O)
        valid = count > 0
        if contact.image_errors is not None:
            residual -= predicted.by_image @ contact.image_errors.mean
        residual = residual[valid]
        J = predicted.slopes_at(T_B_O, contact.center)[valid]
        around = _MODEL_DEVIATION_M * J @ directions.motions[:, directions.determined]
        around[predicted.on_face[valid]] = 0.0
        rounding = ROUNDING_M * predicted.rounding[valid]
        J = np.column_stack([J, around, rounding])
        weight = _weights(residual, count[valid])
        H, g = (J.T * weight) @ J, J.T @ (weight * residual)
        # Schur complement: eliminates the model error of the membrane around the contact.
        gain = np.linalg.solve(H[6:, 6:] + np.eye(len(H) - 6), H[6:, :6]).T
        information, g = H[:6, :6] - gain @ H[6:, :6], g[:6] - gain @ g[6:]
        # Model errors are the same from frame to frame: motions of the surrounding membrane, as far
        # as the image does not show them, and entirely in directions that only the image
        # determines; the membrane's position, independent between triangles; the radius at which it
        # leaves the object's edges, independent between squares as wide as a triangle.
        pulling = J[:, :6] - J[:, 6:] @ gain.T
        pulls = pulling.T * weight
        each, square = pulls * rounding, predicted.square[valid]
        by_radius = np.stack([np.bincount(square, pull) for pull in each])
        by_motion = information @ directions.motions[:, ~directions.determined]
        pulled = MODEL_ERROR_M**2 / predicted.triangles * weight.sum() * pulls @ pulling
        pulled += by_radius @ by_radius.T + _MODEL_DEVIATION_M**2 * by_motion @ by_motion.T
        pulled += gain @ gain.T
        covariance = np.linalg.inv(information + SEARCH_INFORMATION)
        return ImageStep(information, g, covariance @ pulled @ covariance)

    def predicted(
        self,
        T_B_O: np.ndarray,
        contact: ContactPoints,
        gas_pressure_pa: float | None = None,
        *,
        valid_m: float = 0.0,
    ) -> PredictedImage | None:
        """The linear model around a pose, or the last one if still valid; see `step`.

        None if the press fails, or has just failed nearby.
        """
        if self.covers(T_B_O, contact, valid_m):
            return self._predicted
        press = self._pressed.press(T_B_O, contact, gas_pressure_pa)
        self._predicted = None if press is None else self._rendered(press, contact)
        self._pressed_at = T_B_O
        return self._predicted

    def covers(self, T_B_O: np.ndarray, contact: ContactPoints, valid_m: float) -> bool:
        """Whether the patch's edge has moved less than `valid_m` since the last press."""
        if self._predicted is not None:
            return self._predicted.way_m(T_B_O, contact.radius_m) < valid_m
        if self._pressed_at is None:
            return False
        way = motion_between(self._pressed_at, T_B_O, contact.center)
        return way_at(contact.radius_m, way) < valid_m

    def _rendered(self, press: Press, contact: ContactPoints) -> PredictedImage:
        """The membrane and its derivatives in the camera image."""
        mesh = press.part.mesh
        middle = contact.rest_center
        away2 = self._places2 - 2.0 * (self._places @ middle) + middle @ middle
        close = np.flatnonzero(away2 < (contact.extent_m + _AROUND_M) ** 2)
        each = max(1, -(-len(close) // self._max_pixels))
        pixel = close[: len(close) // each * each].reshape(-1, each)
        rays = self._directions[pixel].sum(axis=1)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        camera, known = self._observer.camera, contact.image_errors
        shift_m = np.zeros(2) if known is None else camera_shift(known.mean)
        nodes = press.released - camera.T_B_C[:3, :2] @ shift_m  # relative to a moved camera
        caster = RayCaster(camera.center, rays, mesh.triangles)
        hits = caster.cast(nodes)
        pixel = pixel[hits.ray]
        by_motion, seen = caster.slopes(nodes, hits), rays[hits.ray]
        by_range = range_errors(camera.T_B_C, seen, hits.range_m)
        by_shift = range_shifts(camera.T_B_C, seen, by_motion)
        values = hits.barycentric[:, :, None] * by_motion[:, None]
        slopes = np.concatenate([press.slopes, press.rounding[None]]).reshape(7, -1)
        columns = vector_columns(mesh.triangles)[hits.triangle]
        J = sparse_rows(values.reshape(-1, 9), columns, slopes.shape[1]) @ slopes.T
        square = np.floor(self._places[pixel[:, 0], :2] / mesh.edge_length).astype(int)
        square -= square.min(axis=0, initial=0)
        return PredictedImage(
            pixel=pixel,
            # the first order of the shift is in `by_image`
            expected_m=hits.range_m - self._rest_m[pixel].mean(axis=1) - by_shift @ shift_m,
            jacobian=J[:, :6],
            on_face=press.on_face[hits.triangle],
            rounding=J[:, 6],
            by_image=np.hstack([by_range, by_shift]),
            square=np.ravel_multi_index(square.T, square.max(axis=0, initial=0) + 1),
            triangles=len(np.unique(hits.triangle)),
            press=press,
        )


def _weights(residual_m: np.ndarray, count: np.ndarray) -> np.ndarray:
    """1/σ² of groups of some pixels (b,) from their mean residuals, smaller for outliers."""
    if not len(residual_m):
        return residual_m
    of_pixels = residual_m * np.sqrt(count)  # in which noise is that of one pixel
    sigma = max(float(np.median(np.abs(of_pixels))) / MAD, MODEL_ERROR_M)
    return count / (sigma * (1.0 + (of_pixels / (_OUTLIER_SIGMAS * sigma)) ** 2)) ** 2
