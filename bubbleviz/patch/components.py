"""The separate parts of a contact patch, and the patch without those too small to be contact."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.mesh_graph import connected_parts
from bubbleviz.patch.patch_finder import area_above, area_and_interval, nodal_force
from bubbleviz.result import Estimate, Patch


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

    The force stays: it is that of the whole contact pressure.
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
        _leave_out(mesh, level, band)
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


def _leave_out(mesh: MembraneMesh, level: np.ndarray, band: float) -> None:
    """Remove the bands of edges from a level where no patch is left."""
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
    alone = np.minimum(level, 0.0)
    alone[here] = level[here]
    load = mesh.areas[here] * pressure[here]
    total = float(load.sum())
    return Component(
        nodes=here,
        area_m2=area_above(mesh, alone, 0.0),
        force_n=force,
        peak_pa=float(pressure[here].max()),
        center_m=load @ nodes[here] / total if total > 0.0 else nodes[here].mean(axis=0),
    )
