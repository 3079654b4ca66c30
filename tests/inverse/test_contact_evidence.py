"""Which parts of a pressure are contact: by their share of the load and by their own noise."""

from __future__ import annotations

import numpy as np
import pytest

from bubbleviz.inverse.contact_evidence import evident
from bubbleviz.inverse.contact_problem import ContactPressure
from bubbleviz.membrane.cap_mesh import mesh_cap, spherical_cap

MESH = mesh_cap(spherical_cap(0.045, 0.02), 800)
OUT = np.hypot(MESH.nodes[:, 0], MESH.nodes[:, 1])


def two_parts(share, sigma):
    """A contact in the middle and a node beside it with a share of the load; σ over its load."""
    pressure = np.where(OUT < 0.008, 5e3, 0.0)
    beside = np.argmin(np.hypot(MESH.nodes[:, 0] - 0.03, MESH.nodes[:, 1]))
    load = MESH.areas @ pressure
    pressure[beside] = share / (1.0 - share) * load / MESH.areas[beside]
    nodes = np.flatnonzero(pressure)
    covariance = np.diag((sigma * pressure[nodes]) ** 2)
    contact = ContactPressure(
        pressure > 0.0,
        pressure,
        np.zeros_like(MESH.nodes),
        pivots=0,
        converged=True,
        complete=True,
        kkt_residual=0.0,
        nodes=nodes,
        amplitudes=np.zeros(0),
        covariance=covariance,
    )
    return contact, beside


@pytest.mark.parametrize(
    ("share", "sigma", "kept"),
    [(0.08, 0.01, False), (0.15, 0.01, True), (0.15, 0.5, False)],
)
def test_a_part_is_contact_by_its_load_and_by_evidence_of_its_own(share, sigma, kept):
    contact, beside = two_parts(share, sigma)
    found = evident(MESH, contact)
    assert found[beside] == kept
    assert found[OUT < 0.008].all()
    assert found.sum() == np.count_nonzero(contact.pressure) - (not kept)


def test_a_single_contact_is_one_however_weak():
    contact, beside = two_parts(1e-6, 10.0)
    weak = np.zeros_like(contact.pressure)
    weak[beside] = 1.0
    alone = ContactPressure(
        weak > 0, weak, contact.motion, 0, True, True, 0.0, np.array([beside]), np.zeros(0),
        np.array([[1e6]]),
    )  # fmt: skip
    np.testing.assert_array_equal(evident(MESH, alone), weak > 0.0)
