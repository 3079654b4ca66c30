"""Properties of tracked objects: size check and rotational symmetries."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation

from bubbleviz.errors import InputError
from bubbleviz.membrane import MembraneMesh, ObjectSurface
from bubbleviz.rigid_object import RigidObject

_LARGEST = 20.0
"""Size of an object relative to the bubble beyond which the units differ."""


def check_size(obj: RigidObject, mesh: MembraneMesh) -> None:
    """Refuse an object that is in other units than the bubble.

    Raises InputError.
    """
    size = float(np.ptp(obj.vertices, axis=0).max())
    bubble = float(np.ptp(mesh.nodes, axis=0).max())
    if size > _LARGEST * bubble:
        raise InputError(
            f"object {obj.name}: {size:.4g} m long, {size / bubble:.0f} times the bubble; "
            "scale it or, if the file is in millimetres, choose millimetres next to it in the "
            "window, give pose --unit mm, or end its name in _mm"
        )


# Rotational symmetries of an object: poses that differ by one are equivalent.


_TOLERANCE = 2e-3  # distance relative to the object's size below which surfaces are the same

_FOLDS = (2, 3, 4, 5, 6, 8)  # of common prisms
_CIRCLE = 360  # rotations of a round object: a degree apart
_MAX_MOTIONS = 4 * _CIRCLE  # motions: a round object upside down and mirrored


def symmetries(model: ObjectSurface) -> np.ndarray:
    """Transforms (s, 4, 4) of O that take the object onto itself, the identity first.

    A round object has one for each degree; a ball, whose rotation is never determined, only the
    identity.
    """
    center, axes = _axes(model)
    round_axes = [a for a in axes if _same(model, center, Rotation.from_rotvec(a).as_matrix())]
    if len(round_axes) > 1:
        return _transforms(np.eye(3)[None], center)
    turns = [np.eye(3)]
    for axis in axes:
        if any(abs(axis @ other) > 1.0 - 1e-6 for other in round_axes):
            continue
        turns += [
            R
            for fold in _FOLDS
            if _same(
                model,
                center,
                R := Rotation.from_rotvec(2.0 * np.pi / fold * axis).as_matrix(),
            )
        ]
    if not round_axes:
        return _transforms(_closed(np.array(turns)), center)
    angles = np.arange(_CIRCLE) * 2.0 * np.pi / _CIRCLE
    circle = Rotation.from_rotvec(angles[:, None] * round_axes[0]).as_matrix()
    flips = [R for R in turns if round_axes[0] @ R @ round_axes[0] < -0.5][:1]
    return _transforms(np.concatenate([circle, *(flip @ circle for flip in flips)]), center)


def _axes(model: ObjectSurface) -> tuple[np.ndarray, np.ndarray]:
    """Centre of the surface, and unit axes (a, 3) about which the object may be symmetric."""
    corners = model.obj.vertices[model.triangles]
    middles = corners.mean(axis=1)
    weight = model.facet_areas / model.facet_areas.sum()
    center = weight @ middles
    arms = np.concatenate([middles, *(0.5 * (corners[:, k] + middles) for k in range(3))])
    arms = arms - center
    shares = np.tile(weight, 4)
    _, vectors = np.linalg.eigh((arms.T * shares) @ arms)
    _, different = np.unique(np.round(model.facet_normals, 3), axis=0, return_index=True)
    normals = model.facet_normals[different]  # as they are: rounded axes close no group
    largest = normals[np.argsort(-np.abs(normals).max(axis=1))][:40]
    between = [a + b for a, b in combinations(largest[:14], 2)]
    candidates = np.concatenate([vectors.T, np.eye(3), largest, np.reshape(between, (-1, 3))])
    chosen: list[np.ndarray] = []
    for candidate in candidates:
        length = np.linalg.norm(candidate)
        if length > 1e-6 and all(abs(candidate @ c) < (1.0 - 1e-5) * length for c in chosen):
            chosen.append(candidate / length)
    return center, np.array(chosen)


def _same(model: ObjectSurface, center: np.ndarray, R: np.ndarray) -> bool:
    """Whether the turned vertices lie on the surface."""
    turned = (model.obj.vertices - center) @ R.T + center
    way = turned - model.closest(turned).place
    return bool(np.linalg.norm(way, axis=1).max() < _TOLERANCE * model.size_m)


def _closed(turns: np.ndarray) -> np.ndarray:
    """All products of some rotations."""
    group = [np.eye(3)]
    new = list(turns)
    while new and len(group) < _MAX_MOTIONS:
        R = new.pop()
        if any(np.abs(R - known).max() < 1e-3 for known in group):
            continue
        group.append(R)
        new += [R @ other for other in turns]
    return np.array(group)


def _transforms(rotations: np.ndarray, center: np.ndarray) -> np.ndarray:
    result = np.tile(np.eye(4), (len(rotations), 1, 1))
    result[:, :3, :3] = rotations
    result[:, :3, 3] = center - rotations @ center
    return result
