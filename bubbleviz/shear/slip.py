"""Slip: parts of a contact patch that move against the rest of it.

Optical flow follows some points of the membrane inside each patch, far more than it has nodes.
Each has an anchor, where it was when it came into contact. The object's motion since then is the
rigid motion that most of those that stick agree on; what a point moved besides, along the membrane,
is its slip. When all of a patch slides at once the membrane tells of no motion at all: only against
a part that sticks can slip be seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import ndtr

from bubbleviz.inverse import PatchEdge
from bubbleviz.membrane import MembraneMesh
from bubbleviz.result import Slip, Traction
from bubbleviz.shear.flow_observer import FlowObserver, PinnedPoints

if TYPE_CHECKING:
    from bubbleviz.shear.optical_flow import FlowField


_FALSE_ALARMS = 0.01  # share of frames without slip in which noise may look like it
_LEAST_STUCK = 4  # points that a rigid motion is fitted to; three would fit any
_ROUNDS = 20  # of weighing points anew, which settles in some ten


@dataclass(frozen=True)
class SlipStart:
    """What `SlipFinder.find` hands from one frame to the next."""

    point: np.ndarray  # (k,) int, of the flow's observer, ascending: those inside the patch
    # (k, 3), where each was on the object when it came into contact, in B at the moment of the
    # first of them, m
    anchor_m: np.ndarray
    covariance: np.ndarray  # (k, 3, 3), of the anchors, m²
    stuck: np.ndarray  # (k,) bool, those that have not slipped since


class SlipFinder:
    """Finds slip in the tractions and flows of successive frames."""

    def __init__(
        self,
        observer: FlowObserver,
        mesh: MembraneMesh,  # reference surface
        # gauge pressure that a contact carries which flattens the membrane
        held_pressure_pa: float,
        resolution_m: float,  # width of the estimate's response to a point load, m
    ) -> None:
        self._observer, self._edge = observer, PatchEdge(mesh)
        self._held_pa, self._resolution_m = held_pressure_pa, resolution_m

    def find(
        self,
        traction: Traction,
        flow: FlowField | None,  # that it was found by
        start: SlipStart | None = None,  # of the frame before
    ) -> tuple[Slip | None, SlipStart | None]:
        """Slip of one frame, None where too little sticks to tell; also what the next needs."""
        if traction.status != "ok" or flow is None:
            return None, None
        point, seen = self._inside(traction, flow)
        if start is None:
            start = SlipStart(point[:0], seen.position[:0], seen.covariance[:0], np.zeros(0, bool))
        _, known, before = np.intersect1d(point, start.point, return_indices=True)
        stuck = start.stuck[before]
        if np.count_nonzero(stuck) < _LEAST_STUCK:
            everything = np.ones(len(point), bool)
            return None, SlipStart(point, seen.position, seen.covariance, everything)
        moved = _Moved.of(seen, known, start.anchor_m[before], start.covariance[before])
        way = moved.against_the_rest(stuck)
        area = seen.area[known]
        likely = ndtr(way.sigmas - moved.limit)
        slip = Slip(
            seen.position[known],
            np.einsum("ki,kix->kx", way.slip_m, moved.tangents),
            way.sigmas > moved.limit,
            float(area @ (way.sigmas > moved.limit) / area.sum()),
            float(np.sqrt(area**2 @ (likely * (1.0 - likely))) / area.sum()),
        )
        back, anchors = way.turn.inv(), np.empty_like(seen.position)
        anchors[:] = back.apply(seen.position - way.shift_m)
        anchors[known] = start.anchor_m[before]
        covariance = seen.covariance.copy()
        covariance[known] = start.covariance[before]
        sticks = np.ones(len(point), bool)
        sticks[known] = stuck & ~slip.slipping
        return slip, SlipStart(point, anchors, covariance, sticks)

    def _inside(self, traction: Traction, flow: FlowField) -> tuple[np.ndarray, PinnedPoints]:
        """Points further inside the patch than its edge is uncertain, and where they are.

        Beside the edge it is not known what touches, and what does not moves against the object.
        """
        measured = self._observer.measure(flow)
        level = self._edge.level_set(
            traction.contact_pressure_pa, self._held_pa, self._resolution_m
        )
        depth = self._observer.interpolated(level, measured.point)
        inside = np.flatnonzero(depth > self._edge.blur_m(self._resolution_m))
        point = measured.point[inside]
        return point, self._observer.pinned(
            traction.positions_m, point, measured.moved_px[inside], measured.sigma_px[inside]
        )


class _Way(NamedTuple):
    """Motion of points over the object, and of the object since the anchors."""

    slip_m: np.ndarray  # (k, 2), along their tangents
    sigmas: np.ndarray  # (k,), its length in standard deviations
    turn: Rotation
    shift_m: np.ndarray  # (3,)


class _Moved(NamedTuple):
    """Points from their anchors to where they are, (k, 3) each; covariances of both (k, 3, 3)."""

    anchors: np.ndarray
    positions: np.ndarray
    tangents: np.ndarray
    before: np.ndarray
    now: np.ndarray

    @classmethod
    def of(
        cls, seen: PinnedPoints, known: np.ndarray, anchors: np.ndarray, covariance: np.ndarray
    ) -> _Moved:
        position, tangents = seen.position[known], seen.tangents[known]
        return cls(anchors, position, tangents, covariance, seen.covariance[known])

    @property
    def limit(self) -> float:
        """Standard deviations that the longest of so many vectors of noise rarely exceeds."""
        return float(np.sqrt(2.0 * np.log(len(self.anchors) / _FALSE_ALARMS)))

    def against_the_rest(self, stuck: np.ndarray) -> _Way:
        """Motion beside the rigid one that most of the points that stuck so far agree on.

        By least absolute deviations, so that it is not between the motions of two parts.
        """
        weight = stuck / np.trace(self.now + self.before, axis1=1, axis2=2)
        way = self._against(weight)
        if (way.sigmas[stuck] <= self.limit).all():
            return way
        for _ in range(_ROUNDS):
            way = self._against(weight / np.maximum(way.sigmas, 1.0))
        still = stuck & (way.sigmas <= self.limit)
        return self._against(weight * still) if still.sum() >= _LEAST_STUCK else way

    def _against(self, weight: np.ndarray) -> _Way:
        share = weight / weight.sum()
        before, now = share @ self.anchors, share @ self.positions
        turn, _ = Rotation.align_vectors(self.positions - now, self.anchors - before, weights=share)
        shift = now - turn.apply(before)
        away = self.positions - turn.apply(self.anchors) - shift
        slip = np.einsum("kix,kx->ki", self.tangents, away)
        R = turn.as_matrix()
        both = self.now + R @ self.before @ R.T
        noise = self.tangents @ both @ self.tangents.swapaxes(1, 2)
        squares = np.einsum("ki,ki->k", slip, np.linalg.solve(noise, slip[:, :, None])[:, :, 0])
        return _Way(slip, np.sqrt(squares), turn, shift)
