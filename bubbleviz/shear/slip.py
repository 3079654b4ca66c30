"""Slip: parts of a contact patch that move relative to the rest of it.

Optical flow tracks points of the membrane inside each patch. The anchor of a point is its position
when it came into contact. The object's motion since then is the rigid motion of most of the
sticking points; the motion of a point relative to it, along the membrane, is its slip. If a whole
patch slides at once, its points do not move relative to each other: slip can only be detected
relative to a part that sticks. While a part sticks and the object moves on, friction grows; where
all slides, it is Coulomb's, and the membrane stands still as in a hold. So once friction stops
growing after a part has slid, or too few points are left that move like one rigid body, slip is
unknown until the contact ends.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from scipy.special import ndtr
from scipy.stats import chi2

from bubbleviz.camera import FlowObserver, PinnedPoints
from bubbleviz.inverse import PatchEdge
from bubbleviz.membrane import MembraneMesh
from bubbleviz.result import HALF_95, Estimate, Slip

if TYPE_CHECKING:
    from bubbleviz.camera import FlowField
    from bubbleviz.recordings import Frame


_FALSE_ALARMS = 0.01  # share of frames without slip in which noise may be detected as slip
# Growth of a contact's friction from frame to frame that is no noise. Chosen on a puck dragged by
# 0.15 mm a frame: it grows by 5 to 12 % while a part sticks, and then changes by 0.3 %.
_GROWTH = 1.01
_MIN_STUCK = 4  # points for the fit of a rigid motion; three would always fit
_ROUNDS = 20  # of reweighting, which converges in about ten
# Longest time between two frames of one contact, s; an object can be lifted and put down in more.
_MOST_STEP_S = 2.0  # between consecutive frames, as some recordings are slow
_MOST_JUMP_S = 0.3  # where frames between them were left out


@dataclass(frozen=True)
class SlipStart:
    """State of `SlipFinder.find` between frames."""

    point: np.ndarray  # (k,) int, of the flow observer, ascending: points in the patch
    # (k, 3), position of each on the object when it came into contact, in B at the time of the
    # first contact, m
    anchor_m: np.ndarray
    covariance: np.ndarray  # (k, 3, 3), of the anchors, m²
    stuck: np.ndarray  # (k,) bool, points inside that have not slipped since
    compared: bool  # whether enough points stuck in an earlier frame of the contact
    inside: np.ndarray  # (k,) bool, points surely inside the patch
    friction: float  # of the whole contact over its normal force
    frame: int  # index and time of the frame it was found in
    time_s: float

    def leads_to(self, frame: Frame) -> bool:
        """Whether the contact of a later frame is surely the same."""
        elapsed_s, step = frame.time_s - self.time_s, frame.index - self.frame
        return 0.0 <= elapsed_s <= (_MOST_STEP_S if step == 1 else _MOST_JUMP_S) and step > 0


class SlipFinder:
    """Finds slip in the estimates and flows of successive frames."""

    def __init__(
        self,
        observer: FlowObserver,
        mesh: MembraneMesh,  # reference surface
        held_pressure_pa: float,  # gauge pressure of the reference configuration
        resolution_m: float,  # width of the estimate's response to a point load, m
    ) -> None:
        self._observer, self._mesh, self._edge = observer, mesh, PatchEdge(mesh)
        self._held_pa, self._resolution_m = held_pressure_pa, resolution_m

    def find(
        self,
        estimate: Estimate,
        flow: FlowField | None,  # of the frame
        frame: Frame,
        start: SlipStart | None = None,  # of an earlier frame, perhaps in another contact
    ) -> tuple[Slip | None, SlipStart | None]:
        """Slip of one frame, None if too few points stick; and the state for the next frame."""
        if estimate.status != "ok" or estimate.flow is None or flow is None:
            return None, None
        point, pinned, inside = self._touching(estimate, flow)
        friction = self._friction(estimate)
        now = inside, friction, frame.index, frame.time_s
        first = SlipStart(point, pinned.position, pinned.covariance, inside, False, *now)
        if start is None or not start.leads_to(frame):
            return None, first
        _, known, before = np.intersect1d(point, start.point, return_indices=True)
        same = ~inside[known] | start.inside[before]  # others have come in from the edge
        known, before = known[same], before[same]
        stuck, tracked = start.stuck[before] & inside[known], inside[known]
        if np.count_nonzero(stuck) < _MIN_STUCK:
            first = replace(first, stuck=inside & (not start.compared))
            return None, replace(first, compared=start.compared)
        moved = _Motions.of(pinned, known, start.anchor_m[before], start.covariance[before])
        motion = moved.relative_to_stuck(stuck)
        if motion is None:
            return None, replace(first, stuck=np.zeros_like(inside), compared=True)
        beyond = motion.sigmas - moved.limit
        still = stuck & (beyond <= 0.0)
        slid = np.count_nonzero(tracked & ~still) >= _MIN_STUCK
        if slid and friction < _GROWTH * start.friction:  # perhaps all of it slides
            return None, replace(first, stuck=np.zeros_like(inside), compared=True)
        slip = Slip(
            pinned.position[known][tracked],
            np.einsum("ki,kix->kx", motion.slip_m, moved.tangents)[tracked],
            beyond[tracked] > 0.0,
            *_share(pinned, known, tracked, motion.sigmas, moved.limit),
        )
        back, anchors = motion.turn.inv(), np.empty_like(pinned.position)
        anchors[:] = back.apply(pinned.position - motion.shift_m)
        anchors[known] = start.anchor_m[before]
        covariance = pinned.covariance.copy()
        covariance[known] = start.covariance[before]
        sticks = inside.copy()
        sticks[known] = still
        return slip, SlipStart(point, anchors, covariance, sticks, True, *now)

    def _friction(self, estimate: Estimate) -> float:
        """Friction of the whole contact over its normal force.

        By slide and spin together: when all of it slides, that is Coulomb's coefficient.
        """
        force, friction = estimate.nodal_force_n, estimate.friction_n
        assert force is not None and friction is not None  # as flow was used
        x, normal = self._mesh.deformed(estimate.motion_m), force - friction
        load, axis = np.linalg.norm(normal, axis=1), normal.sum(axis=0)
        spin = np.cross(x - load @ x / load.sum(), axis / np.linalg.norm(axis))
        radius = load @ np.linalg.norm(spin, axis=1) / load.sum()  # 0 of a single node
        turning = np.vdot(friction, spin) / max(radius, np.finfo(float).tiny)
        along = np.linalg.norm(friction.sum(axis=0))
        return float(np.hypot(along, turning) / load.sum())

    def _touching(
        self, estimate: Estimate, flow: FlowField
    ) -> tuple[np.ndarray, PinnedPoints, np.ndarray]:
        """Points in the patch, their positions, and which are surely inside.

        Within the uncertainty of the edge, points may not touch, and those move relative to the
        object.
        """
        measured = self._observer.measure(flow)
        pressure = estimate.contact_pressure_pa
        level = self._edge.level_set(pressure, self._held_pa, self._resolution_m)
        depth = self._observer.interpolated(level, measured.point)
        touching = np.flatnonzero(depth > 0.0)
        point = measured.point[touching]
        pinned = self._observer.pinned(
            self._mesh.deformed(estimate.motion_m),
            point,
            measured.moved_px[touching],
            measured.sigma_px[touching],
        )
        return point, pinned, depth[touching] > self._edge.blur_m(self._resolution_m)


def _share(
    pinned: PinnedPoints, known: np.ndarray, tracked: np.ndarray, sigmas: np.ndarray, limit: float
) -> tuple[float, float]:
    """Share of the patch's area that slips, and its σ, by motions of known points in σ.

    The edge slips where the next tracked point does. Other points that move significantly may slip
    by less than the limit, or lie on an edge that does not touch. Once most of the patch slips, the
    rest, which is the reference, may slip, too.
    """
    beyond = sigmas - limit
    tree = cKDTree(pinned.position[known[tracked]])
    nearest = np.asarray(tree.query(pinned.position)[1])
    area = np.bincount(nearest, pinned.area, np.count_nonzero(tracked))
    slips, likely = beyond[tracked] > 0.0, ndtr(beyond[tracked])
    unsure = known[sigmas > HALF_95]
    rest = pinned.area[unsure] @ ~slips[nearest[unsure]]
    if area @ slips > 0.5 * area.sum():
        rest = area @ ~slips
    # all of the rest counts as 2 σ
    variance = area**2 @ (likely * (1.0 - likely)) + (0.5 * rest) ** 2
    return float(area @ slips / area.sum()), float(np.sqrt(variance) / area.sum())


class _RelativeMotion(NamedTuple):
    """Motion of points relative to the object, and of the object since the anchors."""

    slip_m: np.ndarray  # (k, 2), along their tangents
    sigmas: np.ndarray  # (k,), its length in standard deviations
    turn: Rotation
    shift_m: np.ndarray  # (3,)


class _Motions(NamedTuple):
    """Anchors and present positions of points, (k, 3) each, with covariances (k, 3, 3)."""

    anchors: np.ndarray
    positions: np.ndarray
    tangents: np.ndarray
    before: np.ndarray
    now: np.ndarray

    @classmethod
    def of(
        cls, pinned: PinnedPoints, known: np.ndarray, anchors: np.ndarray, covariance: np.ndarray
    ) -> _Motions:
        position, tangents = pinned.position[known], pinned.tangents[known]
        return cls(anchors, position, tangents, covariance, pinned.covariance[known])

    @property
    def limit(self) -> float:
        """Detection threshold in σ, which noise exceeds at any point with rate `_FALSE_ALARMS`."""
        return float(np.sqrt(2.0 * np.log(len(self.anchors) / _FALSE_ALARMS)))

    def relative_to_stuck(self, stuck: np.ndarray) -> _RelativeMotion | None:
        """Motion relative to the rigid motion of most of the points that stuck so far.

        It minimises absolute deviations: it is not a mean of the motions of two parts. None if no
        part of them moves like a rigid body to within noise, as where the whole patch slides.
        """
        weight = stuck / np.trace(self.now + self.before, axis1=1, axis2=2)
        motion = self._relative_to_fit(weight)
        if not (motion.sigmas[stuck] <= self.limit).all():
            for _ in range(_ROUNDS):
                motion = self._relative_to_fit(weight / np.maximum(motion.sigmas, 1.0))
        still = stuck & (motion.sigmas <= self.limit)
        while np.count_nonzero(still) >= _MIN_STUCK:
            motion = self._relative_to_fit(weight * still)
            squares = np.where(still, motion.sigmas, 0.0) ** 2
            if squares.sum() <= chi2.isf(_FALSE_ALARMS, 2 * np.count_nonzero(still) - 3):
                return motion
            still[np.argmax(squares)] = False
        return None

    def _relative_to_fit(self, weight: np.ndarray) -> _RelativeMotion:
        share = weight / weight.sum()
        before, now = share @ self.anchors, share @ self.positions
        turn, _ = Rotation.align_vectors(self.positions - now, self.anchors - before, weights=share)
        shift = now - turn.apply(before)
        relative = self.positions - turn.apply(self.anchors) - shift
        slip = np.einsum("kix,kx->ki", self.tangents, relative)
        R = turn.as_matrix()
        covariance = self.now + R @ self.before @ R.T
        noise = self.tangents @ covariance @ self.tangents.swapaxes(1, 2)
        squares = np.einsum("ki,ki->k", slip, np.linalg.solve(noise, slip[:, :, None])[:, :, 0])
        return _RelativeMotion(slip, np.sqrt(squares), turn, shift)
