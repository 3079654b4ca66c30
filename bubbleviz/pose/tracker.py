"""Tracks one object from frame to frame: predict, fit, detect loss, recover.

The object is lost if too little of the patch lies on it, if it would have moved faster than hands
and robots do, or if there is no contact. Then the last good pose is kept, and every frame tries a
few more initial poses, so that no live frame waits for the search. A recording is searched with all
of them, first where its contact is largest, see `bubbleviz.api.pose_search`.

A light contact fits many poses. A pose found by search is compared with the initial poses not tried
yet, and with those that fit as well, until they are refuted; till then its covariance has them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from bubbleviz.errors import InputError
from bubbleviz.inverse import Estimator
from bubbleviz.membrane import MembraneMesh, ObjectSurface, RubberMembrane
from bubbleviz.pose.dual_stage import (
    FOUND_FITNESS,
    InitialPoseFinder,
    Solution,
    Solver,
    looking_different,
)
from bubbleviz.pose.motion import START_DEVIATION, Motion, motion_between, moved
from bubbleviz.pose.registration import ContactPoints, Precision, Registration, contact_points
from bubbleviz.recordings import Frame
from bubbleviz.result import Estimate, Patch, Pose, PoseStatus
from bubbleviz.rigid_object import RigidObject

_MIN_FITNESS = 0.5  # share of the patch on the object below which the pose is lost
_FASTEST = np.array([1.0, 10.0])  # of an object pressed into a bubble, m/s and rad/s
_JUMP_M = 3.0 * START_DEVIATION[0]
"""Motion of the contact's centre, and median distance of the contact from the object at its last
pose, beyond which the object is taken to have jumped with it. Fits from farther away may end in
another pose, as on its flank. A contact that hops from one foot to another stays on the object."""
MAX_GAP_S = 1.0  # time between frames beyond which motion is not predicted
UNKNOWN_S = float(np.pi / _FASTEST[1])  # time in which a free object may turn to any pose
_STARTS_PER_FRAME, _STARTS_AT_FIRST = 4, 12
"""Initial poses tried in a live frame, few so that none waits for the search; and in the first."""
_LARGEST = 20.0
"""Size of an object relative to the bubble beyond which the units differ."""


class PoseTracker:
    """Pose of one object in each frame.

    Raises InputError: the object has no area, or is in other units than the bubble.
    """

    def __init__(
        self,
        estimator: Estimator,  # the one that makes the estimates
        obj: RigidObject,
        # (4, 4), T_B_O in the first frame, to about 5 mm and 10°; None: search
        start: np.ndarray | None = None,
        *,
        membrane: RubberMembrane,  # that the object presses into, on the estimator's mesh
        thorough: bool = False,  # whether a frame compares all initial poses, not only a few
    ) -> None:
        check_size(obj, estimator.mesh)
        self.model = ObjectSurface(obj)
        registration = Registration(self.model, precision_of(estimator))
        self._solver = Solver(registration, estimator, membrane)
        self._finder = InitialPoseFinder(self.model, only_middles=not thorough)
        self._mesh, self._thorough = estimator.mesh, thorough
        self.reset(start)

    def reset(self, start: np.ndarray | None = None) -> None:
        """Reset; start at T_B_O (4, 4), or search if None."""
        self._solver.reset()
        self._start = start
        self._motion: Motion | None = None  # of the last frame with a fit
        self._good = np.full((4, 4), np.nan)  # pose last reported
        self._good_s, self._good_center, self._tried = 0.0, np.zeros(3), 0
        # poses not tried yet; poses that fit as well
        self._waiting = self._rivals = np.zeros((0, 4, 4))
        self._waiting_at, self._compared_m2 = np.zeros(3), 0.0

    def update(self, frame: Frame, estimate: Estimate, patch: Patch) -> Pose:
        """Pose in the next frame with its estimate and patch."""
        return self.reported(self.find(frame, estimate, patch))

    def reported(self, pose: Pose) -> Pose:
        """A pose that was found in the next frame; without one the last good one is kept."""
        if pose.status == "ok":
            self._good = pose.T_B_O
            return pose
        status = pose.status if np.isnan(self._good).any() else "lost"
        return replace(pose, status=status, T_B_O=self._good)

    def is_unknown(self, time_s: float) -> bool:
        """Whether the object may be in any pose, as for too long none was found, or never."""
        if self._start is not None:
            return False
        known_s = MAX_GAP_S if self._tried == 0 else UNKNOWN_S
        return self._motion is None or not 0.0 <= time_s - self._good_s <= known_s

    def find(self, frame: Frame, estimate: Estimate, patch: Patch, *, search: bool = False) -> Pose:
        """Pose in a frame; `search`: compared with all initial poses even if it was followed."""
        if estimate.status != "ok":
            return self._without("no_contact" if estimate.status == "no_contact" else "no_data")
        contact = contact_points(self._mesh, estimate, patch)
        if contact is None:
            return self._without("few_points" if patch.area_m2 > 0.0 else "no_contact")
        predicted = self._predicted(frame, contact)
        solution = rejected = None
        if predicted is not None:
            settled = not (search or self._is_open(contact))
            tracking = settled and self._tried == 0 and self._motion is not None
            solution = self._solver.solve(frame, contact, predicted, tracking=tracking)
            if not self._plausible(solution, frame, contact):
                solution, rejected = None, solution
            elif self._motion is not None:  # the others move along
                way = motion_between(self._motion.T_B_O, solution.pose.T_B_O, contact.center)
                self._carry(way, contact.center)
            if solution is not None and not settled:
                if search:
                    self._begin_search(contact)
                starts = self._next_starts(contact)
                solution = self._solver.best(frame, contact, starts, solution, refine=search)
        if solution is None and (self._motion is not None or self._start is None):
            solution = self._searched(frame, contact)
            if solution.fit.fitness < FOUND_FITNESS:
                solution, rejected = None, solution
        if solution is None:
            return replace(self._without("lost"), rejected=rejected and rejected.fit)
        return self._accepted(frame, contact, solution)

    def _predicted(self, frame: Frame, contact: ContactPoints) -> Motion | None:
        """Predicted pose of the object; None if unknown."""
        if self._motion is None:
            if self._start is None:
                return None
            return Motion.at_rest(self._start, START_DEVIATION, contact.center)
        if self._has_jumped(contact, self._motion.T_B_O):
            return Motion.at_rest(self._carried(contact), START_DEVIATION, contact.center)
        gap = frame.time_s - self._good_s
        if abs(gap) > MAX_GAP_S:  # or a jump in the recording, or another one
            return Motion.at_rest(self._motion.T_B_O, START_DEVIATION, contact.center)
        return self._motion.after(gap).about(contact.center)

    def _has_jumped(self, contact: ContactPoints, T_B_O: np.ndarray) -> bool:
        """Whether the contact has moved, and off the object at its last pose (4, 4)."""
        if np.linalg.norm(contact.center - self._good_center) <= _JUMP_M:
            return False
        local = (contact.points - T_B_O[:3, 3]) @ T_B_O[:3, :3]
        away_m = np.linalg.norm(local - self.model.closest(local).place, axis=1)
        return bool(np.median(away_m) > _JUMP_M)

    def _carried(self, contact: ContactPoints) -> np.ndarray:
        """The last pose, moved like the contact since then, (4, 4)."""
        assert self._motion is not None
        T_B_O = self._motion.T_B_O.copy()
        T_B_O[:3, 3] += contact.center - self._good_center
        return T_B_O

    def _plausible(self, solution: Solution, frame: Frame, contact: ContactPoints) -> bool:
        if solution.fit.fitness < _MIN_FITNESS:
            return False
        if self._motion is None:
            return True
        motion = motion_between(self._motion.T_B_O, solution.pose.T_B_O, contact.center)
        way = np.array([np.linalg.norm(motion[:3]), np.linalg.norm(motion[3:])])
        slack = 3.0 * START_DEVIATION[[0, 3]]
        return bool(np.all(way < _FASTEST * abs(frame.time_s - self._good_s) + slack))

    def _searched(self, frame: Frame, contact: ContactPoints) -> Solution:
        """The best of a few initial poses; the next frame tries others."""
        last = self._motion if self._tried <= 1 else None
        if last is not None or self._tried == 0:  # the search begins
            self._begin_search(contact)
        chosen = np.zeros((0, 4, 4))
        if last is not None:
            chosen = np.stack([last.T_B_O, self._carried(contact)])
        if self._thorough or last is None:
            chosen = np.concatenate([chosen, self._next_starts(contact)])
        self._tried += 1
        return self._solver.best(frame, contact, chosen)

    def _is_open(self, contact: ContactPoints) -> bool:
        """Whether a frame is compared with other poses."""
        # once all were compared, only a larger patch tells more: model errors repeat in each frame
        larger = not self._thorough or contact.areas_m2.sum() > self._compared_m2
        return larger and bool(len(self._waiting) or len(self._rivals))

    def _carry(self, motion: np.ndarray, center: np.ndarray) -> None:
        """Move the other poses by a motion (6,) about a centre (3,)."""
        self._waiting, self._rivals = (
            np.reshape([moved(T_B_O, motion, center) for T_B_O in poses], (-1, 4, 4))
            for poses in (self._waiting, self._rivals)
        )
        self._waiting_at = center

    def _begin_search(self, contact: ContactPoints) -> None:
        self._waiting, self._waiting_at = self._finder.starts(contact), contact.center
        self._rivals = self._rivals[:0]

    def _next_starts(self, contact: ContactPoints) -> np.ndarray:
        """One or two poses that fit as well, and some not tried yet, more at first; or all."""
        if not len(self._waiting) and not len(self._rivals):
            self._begin_search(contact)
        shift = contact.center - self._waiting_at
        self._carry(np.concatenate([shift, np.zeros(3)]), contact.center)
        self._compared_m2 = float(contact.areas_m2.sum())
        first = self._motion is None and self._tried == 0
        count = _STARTS_AT_FIRST if first else _STARTS_PER_FRAME
        rivals = 2 if len(self._waiting) else 1
        if self._thorough:
            count, rivals = len(self._waiting), len(self._rivals)
        compared, self._rivals = self._rivals[:rivals], self._rivals[rivals:]
        chosen, self._waiting = self._waiting[:count], self._waiting[count:]
        return np.concatenate([compared, chosen])

    def _accepted(self, frame: Frame, contact: ContactPoints, solution: Solution) -> Pose:
        self._motion, self._good_s = solution.motion, frame.time_s
        self._good_center, self._tried = contact.center, 0
        self._rivals = looking_different(self.model, solution.pose.others, self._rivals)
        covariance = solution.pose.covariance + self._spread(solution.pose)
        return replace(solution.pose, others=self._rivals.copy(), covariance=covariance)

    def _spread(self, pose: Pose) -> np.ndarray:
        """Covariance (6, 6) of a pose that any of those not refuted yet may be instead."""
        unrefuted, origin = np.concatenate([self._rivals, self._waiting]), pose.T_B_O[:3, 3]
        motions = [motion_between(pose.T_B_O, other, origin) for other in unrefuted]
        return _covering(np.reshape(motions, (-1, 6)))

    def _without(self, why: PoseStatus) -> Pose:
        """Result of a frame without a pose."""
        if self._motion is not None:
            self._tried = max(self._tried, 1)
        return Pose(why, self._good)


def _covering(ways: np.ndarray) -> np.ndarray:
    """Covariance (6, 6) whose 95 % ellipsoid contains motions (k, 6), beside a pose's own error.

    Of few motions it is the mean square, with no motion as one more. Where many are alike, one that
    differs is outside: then those outside get more weight (Titterington 1978, for the smallest
    ellipsoid around all) until χ² of each is below the 95 % quantile by 6, which the pose's own
    error is expected to add.
    """
    weight, limit = np.full(len(ways), 1.0 / (1 + len(ways))), chdtri(6, 0.05) - 6.0
    while True:
        covariance: np.ndarray = (ways.T * weight) @ ways
        squares = np.einsum("ki,ij,kj->k", ways, np.linalg.pinv(covariance), ways)
        if squares.max(initial=0.0) <= limit:
            return covariance
        weight *= squares / (weight @ squares)


def precision_of(estimator: Estimator) -> Precision:
    """Precision of the membrane's position by a sensor's estimator."""
    return Precision(estimator.information, estimator.resolution_m)


def check_size(obj: RigidObject, mesh: MembraneMesh) -> None:
    """Refuse an object that is in other units than the bubble.

    Raises InputError.
    """
    size = float(np.ptp(obj.vertices, axis=0).max())
    bubble = float(np.ptp(mesh.nodes, axis=0).max())
    if size > _LARGEST * bubble:
        raise InputError(
            f"object {obj.name}: {size:.4g} m long, {size / bubble:.0f} times the bubble; crop or "
            "scale the mesh or, if it is in millimetres, end the file's name in _mm (or set its "
            "unit: Pose panel, pose --unit mm)"
        )
