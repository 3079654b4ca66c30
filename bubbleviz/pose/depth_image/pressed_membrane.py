"""The exact membrane that an object at a pose would make, and how it changes with the pose.

Points of the object that are inside the membrane push it outward (`object_contact`):

    ∂W/∂x − p(V) ∂V/∂x − f_rest = Σ f_j b_j n_j,   f_j = k_j × depth of point j.

Newton's method from the membrane of the last pose, in a `window` around the contact; the last
tangent also gives how the membrane moves with the object. An edge that moves over the membrane
takes its load along, which is what shows that a flat face slides in its own plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.rubber_model.rubber_membrane import RubberMembrane
from bubbleviz.pose.contact_points import ContactPoints
from bubbleviz.pose.depth_image.object_contact import ObjectContact, Touching
from bubbleviz.pose.depth_image.window import Tangent, Window
from bubbleviz.pose.object_model import ObjectModel
from bubbleviz.pose.pose_options import PressOptions
from bubbleviz.pose.rigid_motion import motion_between


@dataclass(frozen=True)
class Press:
    """An object pressed into the membrane."""

    T_B_O: np.ndarray  # (4, 4)
    center: np.ndarray  # (3,), that motions are about
    window: Window  # part of the membrane that all else is about
    nodes: np.ndarray  # (k, 3), of it
    # (6, k, 3), their derivatives by small motions of the object in B about the centre
    slopes: np.ndarray
    rounding: np.ndarray  # (k, 3), their derivative by the radius of the object's edges
    push_n: np.ndarray  # (k, 3), force of the object on each node
    held: np.ndarray  # (m,) bool, triangles that lie on a face of the object

    @property
    def force_n(self) -> np.ndarray:
        """Of the object on the membrane, (3,)."""
        total: np.ndarray = self.push_n.sum(axis=0)
        return total


class PressedMembrane:
    """Presses one object into a membrane, pose after pose."""

    def __init__(
        self, membrane: RubberMembrane, gas: Gas, model: ObjectModel, options: PressOptions
    ) -> None:
        self.mesh = membrane.mesh
        self._membrane, self._gas, self._options = membrane, gas, options
        self._object = ObjectContact(
            model,
            options.spacing_edges * self.mesh.edge_length,
            2.0 * membrane.gauge_pressure_pa,
            membrane.mean_tension,
            options,
        )
        self._window: Window | None = None
        self.forget()

    def forget(self) -> None:
        """Begin the next press from the estimated membrane."""
        self._last: Press | None = None
        self._object.forget()

    def press(
        self,
        T_B_O: np.ndarray,  # (4, 4)
        contact: ContactPoints,  # where to look for contact, and the membrane to begin with
        gas_pressure_pa: float | None = None,  # absolute; by the gas law where it is not measured
    ) -> Press | None:
        """Press the object at a pose (4, 4); None where no equilibrium is found."""
        window = self._around(contact)
        if self._last is not None:
            start = _followed(self._last, T_B_O, self._options.longest_step_m)
            self._last = self._solve(window, start, T_B_O, contact.center, gas_pressure_pa)
        if self._last is None:
            self._object.forget()
            mesh, estimated = window.mesh, contact.membrane[window.nodes]
            start = np.where(mesh.rim[:, None], mesh.nodes, estimated)
            self._last = self._solve(window, start, T_B_O, contact.center, gas_pressure_pa)
        return self._last

    def _around(self, contact: ContactPoints) -> Window:
        """The window that the contact is in; another one where it has moved on."""
        reach_m = contact.extent_m + self._options.reach_m
        if self._window is None or not self._window.covers(contact.rest_center, reach_m):
            reach_m += self._options.margin_m
            self._window = Window(self._membrane, self._gas, contact.rest_center, reach_m)
            self.forget()
        return self._window

    def _solve(
        self,
        window: Window,
        x: np.ndarray,
        T_B_O: np.ndarray,
        center: np.ndarray,
        measured: float | None,
    ) -> Press | None:
        """Newton's method from nodes x (k, 3)."""
        triangles = window.mesh.triangles
        for _ in range(self._options.newton_steps):
            if not np.isfinite(x).all():
                return None
            touching = self._object.touching(x, triangles, T_B_O)
            push = touching.on_nodes(touching.force_n[:, None] * touching.normals, len(x))
            try:
                tangent, missed = window.linearised(
                    x, push, touching.blocks(len(triangles)), measured
                )
            except RuntimeError:  # singular
                return None
            step = tangent.moved(missed[None])[0]
            longest = float(np.abs(step).max())
            x = x + min(1.0, self._options.longest_step_m / max(longest, 1e-300)) * step
            if longest < self._options.settled_m:
                return _pressed(window, x, T_B_O, center, touching, tangent)
        return None


def _pressed(
    window: Window,
    x: np.ndarray,
    T_B_O: np.ndarray,
    center: np.ndarray,
    touching: Touching,
    tangent: Tangent,
) -> Press:
    n, triangles = len(x), window.mesh.triangles
    unit, arms = np.eye(3), touching.points - center
    motions = [np.broadcast_to(axis, arms.shape) for axis in unit]
    motions += [np.cross(axis, arms) for axis in unit]
    motions.append(touching.rounding)
    pulls = np.stack([touching.pulled_along(motion, n) for motion in motions])
    loaded = np.zeros(n, bool)
    loaded[touching.corners[touching.weights > 0.0]] = True
    held = loaded[triangles].all(axis=1)
    held[touching.triangle[touching.edge]] = False
    push = touching.on_nodes(touching.force_n[:, None] * touching.normals, n)
    slopes = tangent.moved(pulls)
    return Press(T_B_O, center, window, x, slopes[:6], slopes[6], push, held)


def _followed(press: Press, T_B_O: np.ndarray, longest_m: float) -> np.ndarray:
    """Nodes (k, 3) of a membrane after its object moved to another pose, to first order."""
    motion = motion_between(press.T_B_O, T_B_O, press.center)
    step = np.einsum("q,qni->ni", motion, press.slopes)
    share = min(1.0, longest_m / max(float(np.abs(step).max()), 1e-300))
    nodes: np.ndarray = press.nodes + share * step
    return nodes
