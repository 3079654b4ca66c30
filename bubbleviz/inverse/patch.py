"""The contact patch: which part of the membrane touches something (V-C)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import isnan

import numpy as np
from scipy.spatial import cKDTree

from bubbleviz.inverse.patch_edge import PatchEdge
from bubbleviz.membrane import MembraneMesh, connected_parts, grown, parts_with
from bubbleviz.result import Estimate, FineContact, Patch


def mean_pressure(mesh: MembraneMesh, contact_pressure_pa: np.ndarray) -> float:
    """Mean contact pressure over the membrane, Aᵀp_c / ‖A‖₁, Pa."""
    return float(mesh.areas @ contact_pressure_pa / mesh.areas.sum())


class PatchFinder:
    """Finds the patch in an estimate.

    By default the patch is the part under contact pressure, with the edge by `PatchEdge`. With a
    factor κ it is the paper's: wherever p_c exceeds κ times its mean over the membrane.

    Parameters
    ----------
    mesh : MembraneMesh
    held_pressure_pa : float
        γ0 (κ1 + κ2), the gauge pressure of the reference configuration.
    resolution_m : float
        Resolution of estimates without their own, see `resolution.resolution_m`.
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
        """Patch of an estimate, on its finer mesh if any; or by the paper's threshold κ."""
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
            contact = pressure
            averaged = estimate.averaged_pressure_pa
            drawn = pressure if averaged is None else averaged
            level = self._level(drawn, pressure > 0.0, gas, resolution)
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
        finder = PatchFinder(fine.mesh, self._held, fine.resolution_m, fine.edge_m)
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

    def _level(
        self, contact: np.ndarray, support: np.ndarray, gas_pa: float, resolution_m: float
    ) -> np.ndarray:
        level = self._edge.level_set(contact, gas_pa, resolution_m)
        part = np.full(len(support), -1)
        _, part[support] = connected_parts(self._mesh.rings, support)
        drawn = np.zeros(part.max(initial=-1) + 2, bool)
        drawn[part[level > 0.0]] = True
        # A contact smaller than the resolution has no contour: its nodes are the patch.
        small = np.flatnonzero(support & ~drawn[part])
        if len(small):
            edge = self._mesh.edge_length
            around = self._mesh.rings[:, small]
            level[around] = np.where(level[around] > 0.0, level[around], -edge)
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
    """Areas in m² within the edge, and within the inner and outer line of its band if any."""
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
    above = np.flatnonzero((field > min(levels)).take(mesh.corners).any(axis=0))
    low, middle, high = np.sort(field[mesh.corners.take(above, axis=1)], axis=0)
    level = np.asarray(levels, float)[:, None]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        one = (high - level) ** 2 / ((high - low) * (high - middle))
        two = 1.0 - (level - low) ** 2 / ((high - low) * (middle - low))
    part = np.where(middle > level, two, np.where(high > level, one, 0.0))
    areas = np.where(low > level, 1.0, part) @ mesh.facet_areas[above]
    return tuple(areas.tolist())


# The connected parts of a contact patch, and the patch without small ones.


@dataclass(frozen=True)
class Component:
    """A connected part of a patch.

    Attributes
    ----------
    nodes : (k,) int array
        Its nodes, of the finest mesh that the patch is known on.
    area_m2 : float
    force_n : (3,) array
        Force on it in B; those of all parts add up to the patch's.
    peak_pa : float
        Highest contact pressure.
    center_m : (3,) array
        Pressure-weighted centre in B, on the deformed membrane.
    """

    nodes: np.ndarray
    area_m2: float
    force_n: np.ndarray
    peak_pa: float
    center_m: np.ndarray

    @property
    def force_magnitude_n(self) -> float:
        """Length of the force, N."""
        return float(np.linalg.norm(self.force_n))


def components(mesh: MembraneMesh, estimate: Estimate, patch: Patch) -> tuple[Component, ...]:
    """Parts of a patch, the largest first; areas and forces add up to the patch's."""
    whole, force = mesh, nodal_force(mesh, estimate)
    mesh, estimate, level = patch.finest(mesh, estimate)
    above = level > 0.0
    if not above.any():
        return ()
    inside = np.flatnonzero(above)
    count, label = connected_parts(mesh.rings, above)
    nodes = mesh.deformed(estimate.motion_m)
    forces = np.zeros((count, 3))
    loaded = np.flatnonzero(force.any(axis=1))
    _, nearest = cKDTree(mesh.nodes[inside]).query(whole.nodes[loaded])
    np.add.at(forces, label[nearest], force[loaded])
    parts = [
        _component(mesh, estimate, level, nodes, inside[label == k], forces[k])
        for k in range(count)
    ]
    return tuple(sorted(parts, key=lambda part: -part.area_m2))


def without_small(
    mesh: MembraneMesh, estimate: Estimate, patch: Patch, least_area_m2: float
) -> Patch:
    """Patch without the parts that are smaller than an area, m².

    The force does not change: it is that of the whole contact pressure.
    """
    parts = components(mesh, estimate, patch)
    kept = [part for part in parts if part.area_m2 >= least_area_m2]
    if len(kept) == len(parts):
        return patch
    whole = len(mesh.nodes)
    fine = estimate.fine if patch.fine_level is not None else None
    mesh, estimate, level = patch.finest(mesh, estimate)
    level = level.copy()
    for part in parts:
        if part.area_m2 < least_area_m2:
            level[part.nodes] = -np.abs(level[part.nodes])
    band = patch.edge_half_width_m
    if band > 0.0:
        _remove_empty_bands(mesh, level, band)
    center = np.full(3, np.nan)
    if kept:
        here = np.concatenate([part.nodes for part in kept])
        load = mesh.areas[here] * estimate.contact_pressure_pa[here]
        center = load @ mesh.deformed(estimate.motion_m)[here] / load.sum()
    area_m2, area_interval_m2 = area_and_interval(mesh, level, band)
    return replace(
        patch,
        level=level if fine is None else fine.on_whole(level, whole),
        fine_level=None if fine is None else level,
        area_m2=area_m2,
        area_interval_m2=area_interval_m2,
        center_of_pressure_m=center,
    )


def _remove_empty_bands(mesh: MembraneMesh, level: np.ndarray, band: float) -> None:
    """Remove the bands around edges of removed parts from a level."""
    near = level > -band
    count, label = connected_parts(mesh.rings, near)
    empty = np.bincount(label, level[near] > 0.0, minlength=count) == 0.0
    level[np.flatnonzero(near)[empty[label]]] = -band


def _component(
    mesh: MembraneMesh,
    estimate: Estimate,
    level: np.ndarray,
    nodes: np.ndarray,
    here: np.ndarray,
    force: np.ndarray,
) -> Component:
    pressure = estimate.contact_pressure_pa
    own_level = np.minimum(level, 0.0)
    own_level[here] = level[here]
    load = mesh.areas[here] * pressure[here]
    total = float(load.sum())
    return Component(
        nodes=here,
        area_m2=area_above(mesh, own_level, 0.0),
        force_n=force,
        peak_pa=float(pressure[here].max()),
        center_m=load @ nodes[here] / total if total > 0.0 else nodes[here].mean(axis=0),
    )


# Share of the cells of nodes that the contact covers.


def touching_share(mesh: MembraneMesh, contact_pressure_pa: np.ndarray) -> np.ndarray:
    """Share (n,) of each node's cell that touches, 0 to 1; the edge is where it is one half.

    A node is in contact as soon as the object touches a part of its cell, and carries the load of
    that part only. The load of its whole cell is taken from neighbours that are not at the edge. On
    a sharp edge it also carries a line load, and its whole cell counts.

    On a flat face the loads of single nodes are arbitrary: where one node is a few µm higher, its
    neighbours carry nothing. So a hole in the contact counts only if one of its nodes has no
    touching neighbour.

    Parameters
    ----------
    mesh : MembraneMesh
    contact_pressure_pa : (n,) array
        Contact pressure at the nodes: load over area.
    """
    touching, rings = contact_pressure_pa > 0.0, mesh.rings
    touching = ~parts_with(rings, ~grown(rings, touching) | mesh.rim, ~touching)
    inner = ~grown(rings, ~touching)
    whole = np.where(inner, contact_pressure_pa, 0.0)[rings].max(axis=0)
    edge = touching & ~inner & (whole > 0.0)
    share = touching.astype(float)
    share[edge] = np.minimum(contact_pressure_pa[edge] / whole[edge], 1.0)
    return share
