"""How far points are from the surface of an object at a pose, and which way that changes."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from bubbleviz.pose.object_model import ObjectModel

_OVER = np.cos(np.radians(30.0))
"""Cosine between the way to the closest place and the normal there, for a point over a face and
not beside it."""

_NEAR_M = 1e-3
"""Distance below which noise decides on the direction of the way to the closest place."""


@dataclass(frozen=True)
class ObjectDistance:
    """Points in B against an object at a pose."""

    signed_m: np.ndarray  # (k,), positive outside
    # gradient, normal, place: (k, 3), of the distance, of the surface at the closest place, and
    # that place, in B
    gradient: np.ndarray
    normal: np.ndarray
    place: np.ndarray
    over: np.ndarray  # (k,) bool, over a face, not beside it

    def of(self, some: slice) -> ObjectDistance:
        """Of some of the points."""
        return ObjectDistance(*(getattr(self, field.name)[some] for field in fields(self)))


def object_distance(model: ObjectModel, points: np.ndarray, T_B_O: np.ndarray) -> ObjectDistance:
    """Distances of points (k, 3) in B from an object at a pose (4, 4)."""
    R = T_B_O[:3, :3]
    found = model.closest((points - T_B_O[:3, 3]) @ R)
    place, normal = found.place @ R.T + T_B_O[:3, 3], found.normal @ R.T
    way = points - place
    length = np.linalg.norm(way, axis=1)
    along = np.einsum("ij,ij->i", way, normal)
    outside = along > -0.5 * length  # at an edge the normal is that of one of its faces
    over = (length < _NEAR_M) | (np.abs(along) > _OVER * length)
    sign = np.where(outside, 1.0, -1.0)
    straight = way * (sign / np.maximum(length, 1e-12))[:, None]
    return ObjectDistance(
        signed_m=np.where(over, along, sign * length),
        gradient=np.where(over[:, None], normal, straight),
        normal=normal,
        place=place,
        over=over,
    )
