"""Small rigid motions about a centre: six numbers, translation in m before rotation in rad."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation


def moved(T: np.ndarray, motion: np.ndarray, center: np.ndarray) -> np.ndarray:
    """Pose T (4, 4) after a motion (6,) in B: turned about the centre (3,), then shifted."""
    R = Rotation.from_rotvec(motion[3:]).as_matrix()
    result = np.eye(4)
    result[:3, :3] = R @ T[:3, :3]
    result[:3, 3] = center + motion[:3] + R @ (T[:3, 3] - center)
    return result


def motion_between(start: np.ndarray, end: np.ndarray, center: np.ndarray) -> np.ndarray:
    """Motion (6,) in B about the centre that takes pose `start` to pose `end`, both (4, 4)."""
    R = end[:3, :3] @ start[:3, :3].T
    shift = end[:3, 3] - center - R @ (start[:3, 3] - center)
    return np.concatenate([shift, Rotation.from_matrix(R, assume_valid=True).as_rotvec()])


def about(center: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Matrix (6, 6) that turns a small motion about `center` into the same one about `other`."""
    change = np.eye(6)
    change[:3, 3:] = np.cross(np.eye(3), other - center).T
    return change


def turning(motion: np.ndarray) -> np.ndarray:
    """Matrix (6, 6) that turns small motions as a motion (6,) turns the object."""
    return np.kron(np.eye(2), Rotation.from_rotvec(motion[3:]).as_matrix())


def rows(directions: np.ndarray, points: np.ndarray, center: np.ndarray) -> np.ndarray:
    """Derivative (k, 6) of points' displacements along unit directions (k, 3) by a motion."""
    result = np.empty((len(points), 6))
    result[:, :3] = directions
    x, y, z = (points - center).T
    a, b, c = directions.T
    result[:, 3], result[:, 4], result[:, 5] = y * c - z * b, z * a - x * c, x * b - y * a
    return result


def way_at(radius_m: float, motion: np.ndarray) -> float:
    """Upper bound, m, of the displacement by a motion (6,) at a radius around its centre."""
    return float(np.linalg.norm(motion[:3]) + radius_m * np.linalg.norm(motion[3:]))


# Motion between frames: constant velocity, disturbed by the accelerations of a hand or robot.


START_DEVIATION = np.array([3e-3] * 3 + [np.radians(6.0)] * 3)
"""Standard deviation of a given initial pose: off by up to 5 mm and 10°."""

SEARCH_DEVIATION = np.array([10e-3] * 3 + [np.radians(20.0)] * 3)  # the same of a searched one

SEARCH_INFORMATION = np.diag(SEARCH_DEVIATION**-2.0)
"""Information that bounds the errors which frames have in common. That of the initial pose would
bound them too narrowly: the filter forgets it after some frames."""

_VELOCITY = np.array([0.1] * 3 + [0.5] * 3)
_ACCELERATION = np.array([0.27] * 3 + [5.5] * 3)
"""Standard deviations of the initial velocity (m/s, rad/s) and of acceleration (m/s², rad/s²), the
latter of a robot's wrist. With much less the estimate lags behind a turning object: for a frustum
and a nut that turn by ±12° at 0.7 Hz it lagged with 0.11 rad/s², but not with 1.6. For a bridge and
two spheres that turn by ±8° at 1.1 Hz, not used for this choice, ellipsoids contain the poses."""

_MAX_COAST_S = 0.5  # longest time to coast: motion is not known further ahead


@dataclass(frozen=True)
class Motion:
    """Pose and velocity, with their covariance.

    Centre, velocity and covariance move and turn along with the object, so that an undetermined
    motion, such as a ball's rotation about its centre, stays the same motion of the object.
    """

    T_B_O: np.ndarray  # (4, 4)
    velocity: np.ndarray  # (6,), in B about `center`, m/s and rad/s
    covariance: np.ndarray  # (12, 12), of small motions in B about `center`, and of the velocity
    center: np.ndarray  # (3,)

    @classmethod
    def at_rest(cls, T_B_O: np.ndarray, deviation: np.ndarray, center: np.ndarray) -> Motion:
        """A pose known to a standard deviation (6,), velocity unknown."""
        covariance = np.diag(np.concatenate([deviation, _VELOCITY]) ** 2)
        return cls(T_B_O, np.zeros(6), covariance, center)

    @classmethod
    def known(cls, T_B_O: np.ndarray, information: np.ndarray, center: np.ndarray) -> Motion:
        """A pose known to some information (6, 6), and to the deviation of a searched one."""
        covariance = np.zeros((12, 12))
        covariance[:6, :6] = np.linalg.inv(information + SEARCH_INFORMATION)
        return cls(T_B_O, np.zeros(6), covariance, center)

    @property
    def information(self) -> np.ndarray:
        """Inverse covariance (6, 6) of the pose."""
        return np.linalg.inv(self.covariance[:6, :6])

    def about(self, center: np.ndarray) -> Motion:
        """The same about another centre."""
        A = np.kron(np.eye(2), about(self.center, center))
        covariance = A @ self.covariance @ A.T
        return Motion(self.T_B_O, A[:6, :6] @ self.velocity, covariance, center)

    def after(self, dt_s: float) -> Motion:
        """Predict after some time, or before if it is negative."""
        dt = float(np.clip(dt_s, -_MAX_COAST_S, _MAX_COAST_S))
        F = np.kron([[1.0, dt], [0.0, 1.0]], np.eye(6))
        gain = np.array([0.5 * dt**2, dt])
        noise = np.kron(np.outer(gain, gain), np.diag(_ACCELERATION**2))
        motion = dt * self.velocity
        T, center = moved(self.T_B_O, motion, self.center), self.center + motion[:3]
        return Motion(T, self.velocity, F @ self.covariance @ F.T + noise, center)._turned(motion)

    def corrected(self, T_B_O: np.ndarray, information: np.ndarray) -> Motion:
        """Update by a frame whose information (6, 6) moved the pose estimate to `T_B_O`.

        It is about the centre as it has moved.
        """
        P, motion = self.covariance, motion_between(self.T_B_O, T_B_O, self.center)
        gain = np.concatenate([np.eye(6), np.linalg.solve(P[:6, :6], P[:6, 6:]).T])
        velocity = self.velocity + gain[6:] @ motion
        change = np.linalg.inv(self.information + information) - P[:6, :6]
        covariance = P + gain @ change @ gain.T
        center = self.center + motion[:3]
        return Motion(T_B_O, velocity, 0.5 * (covariance + covariance.T), center)._turned(motion)

    def _turned(self, motion: np.ndarray) -> Motion:
        """Velocity and covariance turned along with the object by a motion (6,)."""
        A = turning(motion)
        both = np.kron(np.eye(2), A)
        return replace(self, velocity=A @ self.velocity, covariance=both @ self.covariance @ both.T)
