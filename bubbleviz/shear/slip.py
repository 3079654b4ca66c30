"""Slip: parts of a contact patch that move against the rest of it.

Every node of the patch has an anchor, where it was when it came into contact. The object's motion
since then is the best rigid motion of the nodes that stick; what a node moved besides, along the
membrane, is its slip. When all of a patch slides at once the membrane tells of no motion at all:
only against a part that sticks can slip be seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import ndtr

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.result import Slip, Traction

_FALSE_ALARMS = 0.01
"""Share of frames without slip in which noise may look like it."""
_LEAST_STUCK = 4
"""Nodes that a rigid motion is fitted to; three would fit any."""
_ROUNDS = 10
"""Of leaving out nodes that slip, which settle in two or three."""


@dataclass(frozen=True)
class SlipStart:
    """What `SlipFinder.find` hands from one frame to the next.

    Attributes
    ----------
    anchors_m : (n, 3) array
        Where each node was on the object when it came into contact, in B at the moment of the
        first of them, m; NaN for nodes that do not touch.
    stuck : (n,) bool array
        Nodes that have not slipped since.
    """

    anchors_m: np.ndarray
    stuck: np.ndarray


class SlipFinder:
    """Finds slip in the tractions of successive frames.

    Parameters
    ----------
    mesh : MembraneMesh
        Reference surface.
    """

    def __init__(self, mesh: MembraneMesh) -> None:
        self._mesh = mesh

    def find(
        self, traction: Traction, start: SlipStart | None = None
    ) -> tuple[Slip | None, SlipStart | None]:
        """Slip of one frame, None where too little sticks to tell; also what the next needs."""
        if traction.status != "ok":
            return None, None
        x, inside = traction.positions_m, self._inside(traction)
        if start is None:
            start = SlipStart(np.full(x.shape, np.nan), np.zeros(len(x), bool))
        known = inside & np.isfinite(start.anchors_m[:, 0])
        if np.count_nonzero(known & start.stuck) < _LEAST_STUCK:
            return None, SlipStart(np.where(inside[:, None], x, np.nan), inside)
        now = MembraneMesh(x, self._mesh.triangles, self._mesh.rim)
        nodes = np.flatnonzero(known)
        seen = _Nodes(start.anchors_m[nodes], x[nodes], now.normals[nodes], start.stuck[nodes])
        way = seen.against_the_rest(traction.displacement_sigma_m)
        size, area = np.linalg.norm(way.slip_m, axis=1), now.areas[nodes]
        slipped = size > way.limit_m
        likely = ndtr((size - way.limit_m) / way.sigma_m)
        slip_m, slipping = np.full(x.shape, np.nan), np.zeros(len(x), bool)
        slip_m[nodes], slipping[nodes] = way.slip_m, slipped
        slip = Slip(
            slipping,
            slip_m,
            float(area @ slipped / area.sum()),
            float(np.sqrt(area**2 @ (likely * (1.0 - likely))) / area.sum()),
            way.limit_m,
        )
        new = inside & ~known
        anchors = np.where(inside[:, None], start.anchors_m, np.nan)
        anchors[new] = way.turn.inv().apply(x[new] - way.shift_m)
        return slip, SlipStart(anchors, (known & start.stuck & ~slipping) | new)

    def _inside(self, traction: Traction) -> np.ndarray:
        """Nodes (n,) bool in contact with all their neighbours.

        Beside its edge a coarse mesh mixes what touches with what does not.
        """
        touching, triangles = traction.contact_pressure_pa > 0.0, self._mesh.triangles
        inside = touching.copy()
        inside[triangles[~touching[triangles].all(axis=1)]] = False
        return inside


class _Way(NamedTuple):
    """Motion of nodes over the object, and of the object since the anchors."""

    slip_m: np.ndarray
    sigma_m: float
    limit_m: float
    turn: Rotation
    shift_m: np.ndarray


class _Nodes(NamedTuple):
    """Nodes of the patch: anchors, positions and normals (k, 3), and whether they stuck so far."""

    anchors: np.ndarray
    positions: np.ndarray
    normals: np.ndarray
    stuck: np.ndarray

    def against_the_rest(self, displacement_sigma_m: float) -> _Way:
        """Motion beside the best rigid one of those that stick, left out round by round."""
        still = self.stuck
        for _ in range(_ROUNDS):
            way = self._against(still, displacement_sigma_m)
            now = self.stuck & (np.linalg.norm(way.slip_m, axis=1) <= way.limit_m)
            if np.array_equal(now, still) or np.count_nonzero(now) < _LEAST_STUCK:
                break
            still = now
        return way

    def _against(self, still: np.ndarray, displacement_sigma_m: float) -> _Way:
        before, now = self.anchors[still].mean(axis=0), self.positions[still].mean(axis=0)
        turn, _ = Rotation.align_vectors(self.positions[still] - now, self.anchors[still] - before)
        shift = now - turn.apply(before)
        away = self.positions - turn.apply(self.anchors) - shift
        slip = away - np.einsum("ij,ij->i", away, self.normals)[:, None] * self.normals
        sigma = displacement_sigma_m
        # of so many vectors of noise the longest is rarely longer
        limit = sigma * float(np.sqrt(2.0 * np.log(len(self.stuck) / _FALSE_ALARMS)))
        return _Way(slip, sigma, limit, turn, shift)
