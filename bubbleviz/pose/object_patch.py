"""Contact patch from the object's surface at its estimated pose.

The exact membrane is pressed by the object at its pose, on a mesh twice as fine around the contact,
and the patch is the contact area of that press. Noise enters only through the pose, and the
estimate's resolution does not blur the patch. A threshold on the distance to the object would not
do: the membrane leaves a round object so gradually that 0.1 mm more moves the edge by 1.5 mm. Where
the membrane leaves the object at a sharp edge, the patch ends at that edge.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from bubbleviz.inverse import area_above, touching_share
from bubbleviz.membrane import ObjectSurface, level_line
from bubbleviz.pose.pressed_membrane import Press, PressedMembrane, PressOptions
from bubbleviz.pose.registration import contact_points, object_distance
from bubbleviz.result import Estimate, ObjectPatch, Patch, Pose
from bubbleviz.sensor_model import SensorModel

_LIFTED_M = 1e-4
"""Distance from the object beyond which there is no contact: several times the softness."""
_OPTIONS = PressOptions(finer_m=4e-3, max_steps=40)
"""A mesh twice as fine. Starting from the blurred estimate needs some eleven steps."""


class ObjectPatchFinder:
    """Finds the patch of one object; each frame's press starts from that of the previous one."""

    def __init__(self, sensor: SensorModel, obj: ObjectSurface) -> None:
        self._mesh, self._object = sensor.mesh, obj
        self._pressed = PressedMembrane(sensor.rubber, sensor.gas, obj, _OPTIONS)

    def find(
        self,
        estimate: Estimate,
        patch: Patch,  # by the contact pressure: where to look
        pose: Pose,
        gas_pressure_pa: float | None = None,  # measured, absolute
    ) -> ObjectPatch | None:
        """Patch in a frame; None if the pose is lost, or no press is found."""
        contact = contact_points(self._mesh, estimate, patch)
        if pose.status != "ok" or contact is None:
            return None
        press = self._pressed.press(pose.T_B_O, contact, gas_pressure_pa)
        if press is None:
            return None
        level = self._level(press)
        return ObjectPatch(level, area_above(self._mesh, level, 0.0))

    def _level(self, press: Press) -> np.ndarray:
        """Signed distance to the edge at the nodes of the whole mesh, m, positive inside."""
        mesh, ends = press.part.mesh, press.part.ends
        pressure = np.linalg.norm(press.push_n, axis=1) / mesh.areas
        touching = touching_share(mesh, pressure) - 0.5
        pieces = level_line(mesh.nodes, mesh.corners, touching)
        if not len(pieces):
            return np.full(len(self._mesh.nodes), -self._mesh.edge_length)
        edge = cKDTree(np.concatenate([pieces[:, 0], pieces.mean(axis=1)]))
        level = -np.asarray(edge.query(self._mesh.nodes)[0])
        own = np.flatnonzero(ends[:, 0] == ends[:, 1])
        here = np.copysign(level[ends[own, 0]], touching[own])
        level[ends[own, 0]] = np.minimum(here, self._before_edges(press)[own])
        return level

    def _before_edges(self, press: Press) -> np.ndarray:
        """Signed distance (k,) to where the membrane leaves the object over one of its edges, m."""
        creases, T = self._object.creases, press.T_B_O
        if creases is None:
            return np.full(len(press.nodes), np.inf)
        found = object_distance(self._object, press.nodes, T)
        to_edge, nearest = creases.tree.query((found.place - T[:3, 3]) @ T[:3, :3])
        beyond = found.signed_m > np.maximum(_LIFTED_M, to_edge)
        if not beyond.any():
            return np.full(len(press.nodes), np.inf)
        edge = creases.tree.data[nearest[beyond]] @ T[:3, :3].T + T[:3, 3]
        before = np.asarray(cKDTree(edge).query(press.nodes)[0])
        before[beyond] = -np.linalg.norm(press.nodes[beyond] - edge, axis=1)
        return before
