"""The exact membrane that an object at a pose would make, and how it changes with the pose.

Points of the object that are inside the membrane push it outward (`object_contact`):

    ∂W/∂x − p(V) ∂V/∂x − f_rest = Σ f_j b_j n_j,   f_j = k_j × depth of point j.

Newton's method from the membrane of the last pose; the last tangent also gives how the membrane
moves with the object. An edge that moves over the membrane takes its load along, which is what
shows that a flat face slides in its own plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.rubber_model.rubber_membrane import RubberMembrane
from bubbleviz.membrane.rubber_model.sparse_factor import Factor, Factoriser
from bubbleviz.pose.contact_points import ContactPoints
from bubbleviz.pose.depth_image.object_contact import ObjectContact, Touching
from bubbleviz.pose.object_model import ObjectModel
from bubbleviz.pose.pose_options import PressOptions
from bubbleviz.pose.rigid_motion import motion_between


@dataclass(frozen=True)
class Press:
    """An object pressed into the membrane.

    Attributes
    ----------
    T_B_O : (4, 4) array
    center : (3,) array
        That motions are about.
    nodes : (n, 3) array
        Of the membrane.
    slopes : (6, n, 3) array
        Their derivatives by small motions of the object in B about the centre.
    force_n : (3,) array
        Of the object on the membrane.
    held : (m,) bool array
        Triangles that lie on a face of the object.
    """

    T_B_O: np.ndarray
    center: np.ndarray
    nodes: np.ndarray
    slopes: np.ndarray
    force_n: np.ndarray
    held: np.ndarray


@dataclass(frozen=True)
class _Tangent:
    """The factorised tangent at some nodes.

    Attributes
    ----------
    factor : Factor
    gas : (3f,) array
        ∂V/∂x of the moving nodes, m².
    stiffness : float
        −dp/dV, Pa/m³; 0 where the pressure is measured.
    """

    factor: Factor
    gas: np.ndarray
    stiffness: float


class PressedMembrane:
    """Presses one object into a membrane, pose after pose.

    Parameters
    ----------
    membrane : RubberMembrane
    gas : Gas
    model : ObjectModel
    options : PressOptions
    """

    def __init__(
        self, membrane: RubberMembrane, gas: Gas, model: ObjectModel, options: PressOptions
    ) -> None:
        self.mesh = membrane.mesh
        self._membrane, self._gas, self._options = membrane, gas, options
        self._factoriser = Factoriser(membrane.tangent(self.mesh.nodes, 0.0))
        self._rest_volume = membrane.volume(self.mesh.nodes)
        self._object = ObjectContact(
            model,
            self.mesh.triangles,
            options.spacing_edges * self.mesh.edge_length,
            2.0 * membrane.gauge_pressure_pa,
            membrane.mean_tension,
            options,
        )
        self.forget()

    def forget(self) -> None:
        """Begin the next press from the estimated membrane."""
        self._last: Press | None = None
        self._object.forget()

    def press(
        self, T_B_O: np.ndarray, contact: ContactPoints, gas_pressure_pa: float | None = None
    ) -> Press | None:
        """Press the object at a pose (4, 4); None where no equilibrium is found.

        Parameters
        ----------
        T_B_O : (4, 4) array
        contact : ContactPoints
            Where to look for contact, and the membrane to begin with.
        gas_pressure_pa : float, optional
            Absolute; by the gas law where it is not measured.
        """
        if self._last is not None:
            start = _followed(self._last, T_B_O, self._options.longest_step_m)
            self._last = self._solve(start, T_B_O, contact, gas_pressure_pa)
        if self._last is None:
            self._object.forget()
            start = np.where(self.mesh.rim[:, None], self.mesh.nodes, contact.membrane)
            self._last = self._solve(start, T_B_O, contact, gas_pressure_pa)
        return self._last

    def _solve(
        self, x: np.ndarray, T_B_O: np.ndarray, contact: ContactPoints, measured: float | None
    ) -> Press | None:
        """Newton's method from nodes x (n, 3)."""
        near = self._near(contact)
        for _ in range(self._options.newton_steps):
            touching = self._object.touching(x, T_B_O, near)
            try:
                tangent, missed = self._linearised(x, touching, measured)
            except RuntimeError:  # singular, or no longer numbers
                return None
            step = self._moved(tangent, -missed[None])[0]
            longest = float(np.abs(step).max())
            if not np.isfinite(longest):
                return None
            x = x + min(1.0, self._options.longest_step_m / max(longest, 1e-300)) * step
            if longest < self._options.settled_m:
                return self._pressed(x, T_B_O, contact.center, touching, tangent)
        return None

    def _near(self, contact: ContactPoints) -> np.ndarray:
        """Triangles (t,) that the object may touch."""
        away = np.linalg.norm(self.mesh.nodes - contact.rest_center, axis=1)
        close = away < contact.extent_m + self._options.reach_m
        return np.flatnonzero(close[self.mesh.triangles].any(axis=1))

    def _linearised(
        self, x: np.ndarray, touching: Touching, measured: float | None
    ) -> tuple[_Tangent, np.ndarray]:
        """Tangent at nodes x, and the forces (n, 3) that are missing there for equilibrium."""
        membrane = self._membrane
        pressure, stiffness = self._gas_at(x, measured)
        push = touching.force_n[:, None] * touching.normals
        missed = membrane.residual(x, pressure) - touching.on_nodes(push, len(x))
        added = touching.blocks(len(self.mesh.triangles))
        factor = self._factoriser.factor(membrane.tangent(x, pressure, added).data)
        gradient = membrane.volume_gradient(x)[membrane.moving].ravel()
        return _Tangent(factor, gradient, stiffness), missed

    def _gas_at(self, x: np.ndarray, measured: float | None) -> tuple[float, float]:
        """Gauge pressure, Pa, and −dp/dV, Pa/m³."""
        P0, V0, gauge = self._gas.P0, self._gas.V0, self._membrane.gauge_pressure_pa
        if measured is not None and np.isfinite(measured):
            return measured - P0 + gauge, 0.0
        volume = V0 + self._membrane.volume(x) - self._rest_volume
        if not volume > 0.0:
            return np.nan, 0.0
        pressure = P0 * V0 / volume
        return pressure - P0 + gauge, pressure / volume

    def _moved(self, tangent: _Tangent, forces: np.ndarray) -> np.ndarray:
        """Motions (k, n, 3) of the nodes under forces (k, n, 3) on them."""
        moving = self._membrane.moving
        right = np.ascontiguousarray(forces[:, moving].reshape(len(forces), -1).T)
        found = tangent.factor.solve_with(right, tangent.gas, tangent.stiffness)
        motions = np.zeros_like(forces)
        motions[:, moving] = found.T.reshape(len(forces), -1, 3)
        return motions

    def _pressed(
        self,
        x: np.ndarray,
        T_B_O: np.ndarray,
        center: np.ndarray,
        touching: Touching,
        tangent: _Tangent,
    ) -> Press:
        n = len(x)
        unit, arms = np.eye(3), touching.points - center
        motions = [np.broadcast_to(axis, arms.shape) for axis in unit]
        motions += [np.cross(axis, arms) for axis in unit]
        pulls = np.stack([touching.pulled_along(motion, n) for motion in motions])
        loaded = np.zeros(n, bool)
        loaded[touching.corners[touching.weights > 0.0]] = True
        held = loaded[self.mesh.triangles].all(axis=1)
        held[touching.triangle[touching.edge]] = False
        force = touching.force_n @ touching.normals
        return Press(T_B_O, center, x, self._moved(tangent, pulls), force, held)


def _followed(press: Press, T_B_O: np.ndarray, longest_m: float) -> np.ndarray:
    """Nodes (n, 3) of a membrane after its object moved to another pose, to first order."""
    motion = motion_between(press.T_B_O, T_B_O, press.center)
    step = np.einsum("q,qni->ni", motion, press.slopes)
    share = min(1.0, longest_m / max(float(np.abs(step).max()), 1e-300))
    nodes: np.ndarray = press.nodes + share * step
    return nodes
