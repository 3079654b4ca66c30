"""Where an object may be when nobody says: on one of its faces, turned any way, at the patch."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from bubbleviz.membrane.mesh import area_vectors
from bubbleviz.pose.contact_points import ContactPoints
from bubbleviz.pose.object_model import ObjectModel

TURNS = 12  # turns about the patch's normal: 30° apart, which registration bridges

_FACES = 8  # of the convex hull, the largest: an object seldom rests on others
_ALIKE = np.cos(np.radians(20.0))  # faces that registration turns into each other
_POINTS = 40  # of contact and as many free ones: enough to rank starts
_FAR_M = 5e-3  # m, distance beyond which a point is simply not on the object


def touching_directions(model: ObjectModel) -> np.ndarray:
    """Directions (d, 3) in O in which the object may lie on the membrane.

    The largest faces of its convex hull, on which it rests stably, and its axes both ways where
    no such face looks there.
    """
    hull = _hull(model.obj.vertices)
    candidates = list(np.concatenate([np.eye(3), -np.eye(3)]))
    if hull is not None:
        areas = np.linalg.norm(area_vectors(model.obj.vertices, hull.simplices), axis=1)
        normals = hull.equations[:, :3]
        faces, which = np.unique(np.round(normals, 3), axis=0, return_inverse=True)
        total = np.bincount(which.ravel(), areas)
        candidates = list(faces[np.argsort(-total, kind="stable")[:_FACES]]) + candidates
    chosen: list[np.ndarray] = []
    for direction in candidates:
        unit = direction / np.linalg.norm(direction)
        if all(unit @ other < _ALIKE for other in chosen):
            chosen.append(unit)
    return np.array(chosen)


def _hull(vertices: np.ndarray) -> ConvexHull | None:
    try:
        return ConvexHull(vertices)
    except (QhullError, ValueError):  # flat
        return None


class StartFinder:
    """Lists coarse starts of one object, the most promising first."""

    def __init__(self, model: ObjectModel) -> None:
        self._model = model
        self._directions = touching_directions(model)
        heights = model.obj.vertices @ self._directions.T
        top = heights > heights.max(axis=0) - 0.02 * model.size_m
        middle = [
            0.5 * (own.min(axis=0) + own.max(axis=0))
            for own in (model.obj.vertices[mask] for mask in top.T)
        ]
        self._supports = np.array(middle)

    def starts(self, contact: ContactPoints) -> np.ndarray:
        """Poses T_B_O (s, 4, 4) with the object on the patch, best first.

        Their number is fixed by the object, and so is the time this takes.
        """
        normal = contact.areas_m2 @ contact.normals
        normal /= np.linalg.norm(normal)
        poses = np.concatenate(
            [
                _on_patch(direction, support, contact.center, normal)
                for direction, support in zip(self._directions, self._supports, strict=True)
            ]
        )
        return poses[np.argsort(self._scores(poses, contact), kind="stable")]

    def _scores(self, poses: np.ndarray, contact: ContactPoints) -> np.ndarray:
        """Mean squared misfit of each pose on some of the points; distances count up to 5 mm."""
        on = contact.points[:: -(-len(contact.points) // _POINTS)]
        free = contact.free[:: max(1, -(-len(contact.free) // _POINTS))]
        points = np.concatenate([on, free])
        local = np.einsum("spj,sjk->spk", points - poses[:, None, :3, 3], poses[:, :3, :3])
        found = self._model.closest(local.reshape(-1, 3))
        way = local.reshape(-1, 3) - found.place
        length = np.minimum(np.linalg.norm(way, axis=1), _FAR_M)
        inside = np.einsum("ij,ij->i", way, found.normal) < -0.5 * np.linalg.norm(way, axis=1)
        squares = (length**2).reshape(len(poses), -1)
        penetrating = squares[:, len(on) :] * inside.reshape(len(poses), -1)[:, len(on) :]
        return squares[:, : len(on)].mean(axis=1) + penetrating.sum(axis=1) / max(len(free), 1)


def _on_patch(
    direction: np.ndarray, support: np.ndarray, center: np.ndarray, normal: np.ndarray
) -> np.ndarray:
    """Poses (t, 4, 4) that lay a direction of O against the membrane, support on the centre."""
    turned, _ = Rotation.align_vectors(-normal[None], direction[None])
    angles = np.arange(TURNS) * 2.0 * np.pi / TURNS
    rotations = (Rotation.from_rotvec(angles[:, None] * normal) * turned).as_matrix()
    poses = np.tile(np.eye(4), (TURNS, 1, 1))
    poses[:, :3, :3] = rotations
    poses[:, :3, 3] = center - rotations @ support
    return poses
