"""The contact patch by the object: where its surface, at the pose found, carries the membrane.

The exact membrane is pressed by the object at its pose, on a mesh twice as fine around the contact,
and the patch is what touches in that press. Noise comes in by the pose alone, and nothing is
blurred by the estimate's resolution. No distance from the object is the edge: membrane leaves a
round object so slowly that a tenth of a millimetre more or less moves the edge by one and a half.
Where it leaves the object over a sharp edge, that edge is where the patch ends.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from bubbleviz.inverse import area_above, touching_share
from bubbleviz.membrane import (
    Gas,
    MembraneMesh,
    ObjectSurface,
    build_rubber,
    level_line,
    refinement,
)
from bubbleviz.pose.pose_options import PressOptions
from bubbleviz.pose.pressed_membrane import Press, PressedMembrane
from bubbleviz.pose.registration import ContactPoints, contact_points, object_distance
from bubbleviz.result import Estimate, ObjectPatch, Patch, Pose
from bubbleviz.sensor_model import SensorModel

_LIFTED_M = 1e-4
"""Distance from the object at which the membrane has left it: some times what faces sink in."""
_AROUND_M, _MARGIN_M = 4e-3, 8e-3
"""Way around the patch in which the mesh is finer, and by how much more at first, so that the
contact may move that far before another part is."""
_NEWTON_STEPS = 40
"""Most of them: from the estimate, which is blurred over edges of the coarse mesh, some eleven."""


class ObjectPatchFinder:
    """Finds the patch of one object, each frame's from the press of the one before."""

    def __init__(self, sensor: SensorModel, obj: ObjectSurface) -> None:
        self._sensor, self._object = sensor, obj
        self._press: _FinePress | None = None

    def find(
        self,
        estimate: Estimate,
        patch: Patch,  # by the contact pressure: where to look
        pose: Pose,
        gas_pressure_pa: float | None = None,  # measured, absolute
    ) -> ObjectPatch | None:
        """Patch in a frame; None where the pose is lost, or no press is found."""
        mesh = self._sensor.mesh
        contact = contact_points(mesh, estimate, patch)
        if pose.status != "ok" or contact is None:
            return None
        if self._press is None or not self._press.covers(contact):
            self._press = _FinePress(self._sensor, self._object, contact)
        press = self._press.press(pose.T_B_O, contact, gas_pressure_pa)
        if press is None:
            return None
        level = self._level(self._press.mesh, press)[: len(mesh.nodes)]
        return ObjectPatch(level, area_above(mesh, level, 0.0))

    def _level(self, mesh: MembraneMesh, press: Press) -> np.ndarray:
        """Signed distance to the edge at the nodes of the finer mesh, m, positive inside."""
        inside = press.window.nodes
        pressure = np.zeros(len(mesh.nodes))
        pressure[inside] = np.linalg.norm(press.push_n, axis=1) / mesh.areas[inside]
        touching = touching_share(mesh, pressure) - 0.5
        pieces = level_line(mesh.nodes, mesh.corners, touching)
        if not len(pieces):
            return np.full(len(mesh.nodes), -mesh.edge_length)
        edge = cKDTree(np.concatenate([pieces[:, 0], pieces.mean(axis=1)]))
        level = np.copysign(edge.query(mesh.nodes)[0], touching)
        level[inside] = np.minimum(level[inside], self._before_edges(press))
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


class _FinePress:
    """An object pressed into a membrane whose mesh is finer around a contact."""

    def __init__(self, sensor: SensorModel, obj: ObjectSurface, contact: ContactPoints) -> None:
        coarse = sensor.mesh
        self._center, self._reach_m = contact.rest_center, contact.extent_m + _AROUND_M + _MARGIN_M
        close = np.linalg.norm(coarse.nodes - self._center, axis=1) < self._reach_m
        self._finer = refinement(coarse, close[coarse.triangles].any(axis=1))
        rubber = build_rubber(sensor.sensor, self._finer.mesh, sensor.tension_n_per_m)
        gas, usual = Gas.of(sensor.sensor.pneumatics, rubber.mesh), PressOptions()
        spacing = 0.5 * usual.spacing_edges * coarse.edge_length / rubber.mesh.edge_length
        options = replace(usual, spacing_edges=spacing, newton_steps=_NEWTON_STEPS)
        self._pressed = PressedMembrane(rubber, gas, obj, options)
        self.mesh = rubber.mesh

    def covers(self, contact: ContactPoints) -> bool:
        """Whether the mesh is finer all around a contact."""
        way = float(np.linalg.norm(contact.rest_center - self._center))
        return way + contact.extent_m + _AROUND_M <= self._reach_m

    def press(
        self, T_B_O: np.ndarray, contact: ContactPoints, gas_pressure_pa: float | None
    ) -> Press | None:
        """Press the object at a pose (4, 4); None where no equilibrium is found."""
        nodes = self._finer.values(contact.membrane)
        return self._pressed.press(T_B_O, replace(contact, membrane=nodes), gas_pressure_pa)
