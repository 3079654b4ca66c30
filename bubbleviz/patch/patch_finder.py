"""The contact patch: which part of the membrane touches something (V-C)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import isnan

import numpy as np

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.mesh_graph import connected_parts
from bubbleviz.patch.patch_edge import PatchEdge
from bubbleviz.result import Estimate, FineContact, Patch

LINEAR_ERROR = 0.05
"""Share of the load that the linear model misplaces: its error in force on a ball pressed 2 mm into
the bubble, against the exact solution; it grows with depth."""


def mean_pressure(mesh: MembraneMesh, contact_pressure_pa: np.ndarray) -> float:
    """Mean contact pressure over the membrane, Aᵀp_c / ‖A‖₁, Pa."""
    return float(mesh.areas @ contact_pressure_pa / mesh.areas.sum())


class PatchFinder:
    """Finds the patch in an estimate.

    By default the physics of contact draws it: on the linear membrane each part must somewhere
    reach the gas pressure, as what lies on something flat or convex does, and carry more than what
    noise or the model's own error could put there; the exact membrane's estimate has only such
    parts.
    `PatchEdge` finds their edge.
    With a factor κ it is the paper's: wherever p_c exceeds κ times its mean over the membrane.

    Parameters
    ----------
    mesh : MembraneMesh
    held_pressure_pa : float
        γ0 (κ1 + κ2): what the tension holds, the gauge pressure in the reference configuration.
    resolution_m : float
        Width of the response of estimates that do not know their own, see
        `resolution.resolution_m`.
    edge_m : float, optional
        As of `PatchEdge`.
    """

    def __init__(
        self,
        mesh: MembraneMesh,
        held_pressure_pa: float,
        resolution_m: float,
        edge_m: float | None = None,
    ) -> None:
        self._mesh, self._held = mesh, held_pressure_pa
        self._edge, self._resolution_m = PatchEdge(mesh, edge_m), resolution_m

    def find(self, estimate: Estimate, kappa: float | None = None) -> Patch:
        """Patch of an estimate: what carries the gas pressure, or by the paper's threshold κ.

        The former is drawn on the estimate's finer mesh where it has one. The force is that of the
        whole contact pressure; the centre of pressure is that of the parts in contact, so that
        what noise puts elsewhere does not pull it aside.
        """
        if kappa is None and estimate.fine is not None:
            patch = self._on_finer(estimate, estimate.fine)
            if patch.area_m2 > 0.0:
                return self._with_wrench(patch, estimate)
        return self._with_wrench(self._drawn(estimate, kappa), estimate)

    def _drawn(self, estimate: Estimate, kappa: float | None) -> Patch:
        """The patch without its force."""
        mesh, pressure = self._mesh, estimate.contact_pressure_pa
        change = estimate.gas_pressure_change_pa
        gas = self._held + (0.0 if isnan(change) else change)
        if kappa is None:
            threshold = 0.5 * gas
            resolution = estimate.resolution_m or self._resolution_m
            band = self._edge.blur_m(resolution)
            contact, part = self._contacts(estimate, gas, band)
            level = self._level(contact, part, gas, resolution)
        else:
            threshold = kappa * mean_pressure(mesh, pressure)
            contact = np.where(pressure > threshold, pressure, 0.0)
            level, band = (pressure - threshold) / gas, np.nan
        center = np.full(3, np.nan)
        if contact.any():
            load = mesh.areas * contact
            center = load @ mesh.deformed(estimate.motion_m) / load.sum()
        area_m2, area_interval_m2 = area_and_interval(mesh, level, band)
        return Patch(
            threshold_pa=threshold,
            level=level,
            force_n=np.full(3, np.nan),
            center_of_pressure_m=center,
            area_m2=area_m2,
            edge_half_width_m=band,
            area_interval_m2=area_interval_m2,
            kappa=kappa,
        )

    def _on_finer(self, estimate: Estimate, fine: FineContact) -> Patch:
        finder = PatchFinder(
            fine.mesh, self._held, fine.resolution_m, 0.5 * self._edge.edge_length_m
        )
        patch = finder._drawn(fine.estimate(estimate), None)
        level = fine.on_whole(patch.level, len(self._mesh.nodes))
        return replace(patch, level=level, fine_level=patch.level)

    def _with_wrench(self, patch: Patch, estimate: Estimate) -> Patch:
        force = nodal_force(self._mesh, estimate)
        arm = self._mesh.deformed(estimate.motion_m) - patch.center_of_pressure_m
        friction = np.full((1, 3), np.nan) if estimate.friction_n is None else estimate.friction_n
        return replace(
            patch,
            force_n=force.sum(axis=0),
            tangential_force_n=friction.sum(axis=0),
            torque_nm=np.cross(arm, force).sum(axis=0),
        )

    def _contacts(
        self, estimate: Estimate, gas_pa: float, blur_m: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Contact pressure (n,) of the connected parts that are contact, and part of each node.

        Elsewhere the pressure is 0 Pa; what is too low to be in one has part −1: on the linear
        membrane, where noise leaves some pressure everywhere, below half the gas pressure. The
        estimate of the exact membrane has found its contacts itself.
        """
        pressure, linear = estimate.contact_pressure_pa, estimate.force_n is None
        above = pressure > (0.5 * gas_pa if linear else 0.0)
        part = np.full(len(pressure), -1)
        if not above.any():
            return np.zeros(len(pressure)), part
        parts, part[above] = connected_parts(self._mesh.rings, above)
        if not linear:
            return pressure, part
        highest = np.zeros(parts)
        np.maximum.at(highest, part[above], pressure[above])
        touches = highest >= gas_pa
        load = self._mesh.areas * pressure
        loads = np.bincount(part[above], load[above], minlength=parts)
        least = LINEAR_ERROR * float(load.sum())
        touches &= loads >= max(gas_pa * np.pi * blur_m**2, least)
        contact = np.zeros(len(pressure))
        contact[above] = np.where(touches[part[above]], pressure[above], 0.0)
        return contact, part

    def _level(
        self, contact: np.ndarray, part: np.ndarray, gas_pa: float, resolution_m: float
    ) -> np.ndarray:
        level = self._edge.level_set(contact, gas_pa, resolution_m)
        drawn = np.zeros(part.max(initial=-1) + 2, bool)
        drawn[part[level > 0.0]] = True
        # A contact smaller than the resolution has no edge to draw: its nodes are the patch.
        small = np.flatnonzero((contact > 0.0) & ~drawn[part])
        if len(small):
            edge = self._mesh.edge_length
            beside = self._mesh.rings[:, small]
            level[beside] = np.where(level[beside] > 0.0, level[beside], -edge)
            inside = (contact[small] / gas_pa - 0.5) * edge
            level[small] = np.minimum(inside, self._edge.blur_m(resolution_m))
        return level


def nodal_force(mesh: MembraneMesh, estimate: Estimate) -> np.ndarray:
    """Force of the contact on the nodes, (n, 3), N."""
    if estimate.nodal_force_n is not None:
        return estimate.nodal_force_n
    return -(mesh.areas * estimate.contact_pressure_pa)[:, None] * mesh.normals


def area_and_interval(
    mesh: MembraneMesh, level: np.ndarray, band: float
) -> tuple[float, tuple[float, float]]:
    """Areas in m² within an edge, and within the inner and the outer line of its band if any."""
    if np.isnan(band):
        return area_above(mesh, level, 0.0), (np.nan, np.nan)
    inner, edge, outer = areas_above(mesh, level, (band, 0.0, -band))
    return edge, (inner, outer)


def area_above(mesh: MembraneMesh, field: np.ndarray, level: float) -> float:
    """Area in m² of the reference surface where a nodal field exceeds a level."""
    return areas_above(mesh, field, (level,))[0]


def areas_above(
    mesh: MembraneMesh, field: np.ndarray, levels: Sequence[float] | np.ndarray
) -> tuple[float, ...]:
    """Areas in m² of the reference surface where a nodal field exceeds each level.

    Exact for the piecewise linear field: of a triangle with one corner above the level, the part
    beyond the level line is the product of the two cut edge fractions.
    """
    if field.max() <= min(levels):
        return (0.0,) * len(levels)
    reaching = np.flatnonzero((field > min(levels)).take(mesh.corners).any(axis=0))
    low, middle, high = np.sort(field[mesh.corners.take(reaching, axis=1)], axis=0)
    level = np.asarray(levels, float)[:, None]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        one = (high - level) ** 2 / ((high - low) * (high - middle))
        two = 1.0 - (level - low) ** 2 / ((high - low) * (middle - low))
    part = np.where(middle > level, two, np.where(high > level, one, 0.0))
    areas = np.where(low > level, 1.0, part) @ mesh.facet_areas[reaching]
    return tuple(areas.tolist())
