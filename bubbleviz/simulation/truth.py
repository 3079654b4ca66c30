"""What is true of a simulated frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from bubbleviz.camera.membrane_view import MembraneView
from bubbleviz.patch.patch_finder import area_above
from bubbleviz.patch.touching_share import touching_share

if TYPE_CHECKING:
    from bubbleviz.membrane.forward_model import Contact

SLIP_M = 1e-6  # way over the object from one frame to the next beyond which a node slips


@dataclass(frozen=True)
class Truth:
    """Ground truth of one frame; names and units as in TRUTH.npz.

    Attributes
    ----------
    displacement_m, contact_pressure_pa : (n,) array
        On the nodes of the simulation's own mesh; the displacement along the rest normals.
    displacement_3d_m : (n, 3) array
        The whole displacement.
    gas_pressure_change_pa : float
    force_n : (3,) array
        Resultant of the contact on the membrane in B.
    center_of_pressure_m : (3,) array
        In B; NaN without contact.
    patch_area_m2 : float
        Where the linear interpolation of `touching_share` is at least one half.
    patch_mask : (H, W) bool array
        Pixels that see such a place.
    traction_pa : (n, 3) array, optional
        Of the object on the membrane, force over present area, Pa; None from a TRUTH.npz without.
    torque_nm : (3,) array, optional
        Of the same about the centre of pressure, N·m; 0 without contact.
    slip_m : (n,) array, optional
        Way of each node over the object since the frame before, m; NaN without friction.
    slip_share : float, optional
        Share of the touching area that slipped by more than 1 µm; NaN without friction or contact.
    """

    displacement_m: np.ndarray
    displacement_3d_m: np.ndarray
    contact_pressure_pa: np.ndarray
    gas_pressure_change_pa: float
    force_n: np.ndarray
    center_of_pressure_m: np.ndarray
    patch_area_m2: float
    patch_mask: np.ndarray
    traction_pa: np.ndarray | None = None
    torque_nm: np.ndarray | None = None
    slip_m: np.ndarray | None = None
    slip_share: float | None = None

    @classmethod
    def of(cls, contact: Contact, view: MembraneView) -> Truth:
        """What is true of a contact on the mesh of a view."""
        # the window, which only reads truths, starts without a simulator
        from bubbleviz.membrane.rubber_model.friction_forward import FrictionContact

        touching = touching_share(view.mesh, contact.contact_pressure_pa)
        moved = contact.displacement_3d_m
        x = view.mesh.deformed(moved)
        areas = replace(view.mesh, nodes=x).areas
        load = np.linalg.norm(contact.nodal_force_n, axis=1)
        slip = np.full(len(load), np.nan)
        if isinstance(contact, FrictionContact):
            load, slip = contact.contact_pressure_pa * areas, contact.slip_m
        center, torque = np.full(3, np.nan), np.zeros(3)
        if load.sum() > 0.0:
            center = load @ x / load.sum()
            torque = np.cross(x - center, contact.nodal_force_n).sum(axis=0)
        half = 0.5 - 1e-9  # a place at exactly one half counts
        return cls(
            displacement_m=contact.displacement_m,
            displacement_3d_m=moved,
            contact_pressure_pa=contact.contact_pressure_pa,
            gas_pressure_change_pa=contact.gas_pressure_change_pa,
            force_n=contact.nodal_force_n.sum(axis=0),
            center_of_pressure_m=center,
            patch_area_m2=area_above(view.mesh, touching, half),
            patch_mask=view.above(moved, touching, half),
            traction_pa=contact.nodal_force_n / areas[:, None],
            torque_nm=torque,
            slip_m=slip,
            slip_share=_slip_share(slip, np.where(load > 0.0, areas, 0.0)),
        )

    def force_error(self, force_n: np.ndarray) -> float:
        """Distance of a force (3,) from the true one over its length; NaN where that is 0."""
        size = float(np.linalg.norm(self.force_n))
        return float(np.linalg.norm(force_n - self.force_n)) / size if size > 0.0 else float("nan")


def _slip_share(slip_m: np.ndarray, touching_m2: np.ndarray) -> float:
    """Share of the touching area (n,) that slips; NaN where that is not known."""
    if not touching_m2.any() or np.isnan(slip_m).any():
        return float("nan")
    return float(touching_m2[slip_m > SLIP_M].sum() / touching_m2.sum())


@runtime_checkable
class KnowsTruth(Protocol):
    """A source that may have ground truth."""

    def truth(self, index: int) -> Truth | None:
        """Ground truth of a frame; None when it is not known."""


def truth_of(source: object, index: int) -> Truth | None:
    """Ground truth of a frame of any source; None for all but simulations."""
    return source.truth(index) if isinstance(source, KnowsTruth) else None
