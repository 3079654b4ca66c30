"""The contact patch: which part of the membrane touches something (V-C)."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.patch.patch_edge import PatchEdge
from bubbleviz.result import Estimate, Patch

MODEL_ERROR = 0.05
"""Share of the load that the linear model misplaces: its error in force on a ball pressed 2 mm into
the bubble, against the exact solution (`study.oracles`); it grows with depth."""


def mean_pressure(mesh: MembraneMesh, contact_pressure_pa: np.ndarray) -> float:
    """Mean contact pressure over the membrane, Aᵀp_c / ‖A‖₁, Pa."""
    return float(mesh.areas @ contact_pressure_pa / mesh.areas.sum())


class PatchFinder:
    """Finds the patch in an estimate.

    By default the physics of contact draws it. On the exact membrane its edge lies midway between
    nodes that carry at least the gas pressure, as all do that lie on something flat or convex, and
    free ones. On the linear one each part must somewhere reach the gas
    pressure and carry more than what noise or the linear model's own error could put there; its
    edge is that of `PatchEdge`. With a factor κ it is the paper's: wherever p_c exceeds κ times its
    mean over the membrane.

    Parameters
    ----------
    mesh : MembraneMesh
    held_pressure_pa : float
        γ0 (κ1 + κ2): what the tension holds, the gauge pressure in the reference configuration.
    resolution_m : float
        Width of the estimate's response, see `resolution.resolution_m`.
    """

    def __init__(self, mesh: MembraneMesh, held_pressure_pa: float, resolution_m: float) -> None:
        self._mesh, self._held = mesh, held_pressure_pa
        self._edge = PatchEdge(mesh, resolution_m)
        self._cell_m2 = np.pi * self._edge.resolution**2
        a, b = mesh.triangles.ravel(), np.roll(mesh.triangles, -1, axis=1).ravel()
        count = len(mesh.nodes)
        self._pairs = sparse.csr_array((np.ones(len(a)), (a, b)), shape=(count, count))

    def find(self, estimate: Estimate, kappa: float | None = None) -> Patch:
        """Patch of an estimate: above half the held pressure, or at the paper's threshold κ.

        The force is that of the whole contact pressure; the centre of pressure is that of the
        parts in contact, so that what noise puts elsewhere does not pull it aside.
        """
        mesh, pressure = self._mesh, estimate.contact_pressure_pa
        if kappa is None and estimate.force_n is not None:
            gas = self._held + np.nan_to_num(estimate.gas_pressure_change_pa)
            threshold = 0.5 * gas
            contact = np.where(pressure > threshold, pressure, 0.0)
            # The line load at an edge makes its nodes no more touching than others.
            level = (np.minimum(pressure, gas) - threshold) / self._held
        elif kappa is None:
            threshold = 0.5 * self._held
            contact, part = self._contacts(estimate, threshold)
            level = self._level(contact, part, threshold)
        else:
            threshold = kappa * mean_pressure(mesh, pressure)
            contact = np.where(pressure > threshold, pressure, 0.0)
            level = (pressure - threshold) / self._held
        force, center = estimate.force_n, np.full(3, np.nan)
        if force is None:
            force = -(mesh.areas * pressure) @ mesh.normals
        if contact.any():
            load = mesh.areas * contact
            center = load @ mesh.deformed(estimate.motion_m) / load.sum()
        return Patch(
            threshold_pa=threshold,
            level=level,
            force_n=force,
            center_of_pressure_m=center,
            area_m2=area_above(mesh, level, 0.0),
        )

    def _contacts(self, estimate: Estimate, floor_pa: float) -> tuple[np.ndarray, np.ndarray]:
        """Contact pressure (n,) of the connected parts that are contact, and part of each node.

        Elsewhere the pressure is 0 Pa, and below the floor the part is −1.
        """
        pressure = estimate.contact_pressure_pa
        least_peak = self._held + np.nan_to_num(estimate.gas_pressure_change_pa)
        above = np.flatnonzero(pressure > floor_pa)
        part = np.full(len(pressure), -1)
        if not above.size:
            return np.zeros(len(pressure)), part
        parts, part[above] = connected_components(self._pairs[above][:, above], directed=False)
        highest = np.zeros(parts)
        np.maximum.at(highest, part[above], pressure[above])
        load = self._mesh.areas * pressure
        loads = np.bincount(part[above], load[above], minlength=parts)
        least_load = max(least_peak * self._cell_m2, MODEL_ERROR * float(load.sum()))
        touches = (highest >= least_peak) & (loads >= least_load)
        contact = np.zeros(len(pressure))
        contact[above] = np.where(touches[part[above]], pressure[above], 0.0)
        return contact, part

    def _level(self, contact: np.ndarray, part: np.ndarray, floor_pa: float) -> np.ndarray:
        level = self._edge.level_set(contact, self._held) / self._mesh.edge_length
        drawn = np.zeros(part.max(initial=-1) + 2, bool)
        drawn[part[level > 0.0]] = True
        # A contact smaller than the resolution has no edge to draw: its nodes are the patch.
        small = np.flatnonzero((contact > 0.0) & ~drawn[part])
        level[small] = (contact[small] - floor_pa) / self._held
        return level


def area_above(mesh: MembraneMesh, field: np.ndarray, level: float) -> float:
    """Area in m² of the reference surface where a nodal field exceeds a level.

    Exact for the piecewise linear field: of a triangle with one corner above the level, the part
    beyond the level line is the product of the two cut edge fractions.
    """
    corners = field[mesh.triangles]
    reaching = np.any(corners > level, axis=1)
    low, middle, high = np.sort(corners[reaching], axis=1).T
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        one = (high - level) ** 2 / ((high - low) * (high - middle))
        two = 1.0 - (level - low) ** 2 / ((high - low) * (middle - low))
    fraction = np.select([low > level, middle > level, high > level], [1.0, two, one], 0.0)
    return float(fraction @ mesh.facet_areas[reaching])
