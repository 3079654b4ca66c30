"""Which parts of a pressure field are contact: by share of the load and by noise."""

from types import SimpleNamespace

import numpy as np
import pytest

from bubbleviz.inverse import ContactPressure, significant_contact
from bubbleviz.membrane import mesh_cap, spherical_cap
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import Recording
from bubbleviz.sensor import load_sensor

MESH = mesh_cap(spherical_cap(0.045, 0.02), 800)
OUT = np.hypot(MESH.nodes[:, 0], MESH.nodes[:, 1])


def contact_of(pressure, variances):
    """A solution with these pressures (n,) and variances (k,) of the nonzero ones."""
    return ContactPressure(
        pressure > 0.0, pressure, np.zeros_like(MESH.nodes), 0, True, True, np.zeros(0),
        SimpleNamespace(covariance=lambda _: np.diag(variances)),
    )  # fmt: skip


def two_parts(share, sigma):
    """A contact in the middle and another node with a share of the load; σ relative to its load."""
    pressure = np.where(OUT < 0.008, 5e3, 0.0)
    beside = np.argmin(np.hypot(MESH.nodes[:, 0] - 0.03, MESH.nodes[:, 1]))
    load = MESH.areas @ pressure
    pressure[beside] = share / (1.0 - share) * load / MESH.areas[beside]
    return contact_of(pressure, (sigma * pressure[pressure > 0.0]) ** 2), beside


@pytest.mark.parametrize(
    ("share", "sigma", "kept"),
    [(0.08, 0.01, False), (0.12, 0.01, False), (0.2, 0.01, True), (0.2, 0.5, False)],
)
def test_a_part_needs_significant_load_to_be_contact(share, sigma, kept):
    contact, beside = two_parts(share, sigma)
    found = significant_contact(MESH, contact)
    assert found[beside] == kept
    assert found[OUT < 0.008].all()
    assert found.sum() == np.count_nonzero(contact.pressure) - (not kept)


def test_a_single_part_is_always_contact():
    contact, beside = two_parts(1e-6, 10.0)
    weak = np.zeros_like(contact.pressure)
    weak[beside] = 1.0
    np.testing.assert_array_equal(significant_contact(MESH, contact_of(weak, [1e6])), weak > 0.0)


@pytest.mark.parametrize(
    "frame", [64, *(pytest.param(k, marks=pytest.mark.long) for k in (65, 66, 67))]
)
def test_real_press_is_one_contact_in_every_frame(punyo_press, frame):
    """While it is loaded; its gas pressure needs no zero."""
    source = Recording(punyo_press)
    pipeline = Pipeline.of(load_sensor("punyo_oval_d405"), source.intrinsics)
    estimate = pipeline.process(source[frame], frozenset({"estimate"})).estimate
    source.close()
    pressed = estimate.contact_pressure_pa > 0.0
    nodes, load = pipeline.mesh.nodes[pressed], estimate.contact_pressure_pa[pressed]
    middle = nodes[np.argmax(load)]
    assert estimate.status == "ok" and np.linalg.norm(nodes - middle, axis=1).max() < 0.014


def test_many_equal_contacts_are_all_contacts():
    """Each of eight carries a small but equal share of the load."""
    around = 0.03 * np.exp(1j * np.arange(8) * np.pi / 4)
    there = MESH.nodes[:, 0] + 1j * MESH.nodes[:, 1]
    pressure = np.zeros(len(MESH.nodes))
    for place in around:
        node = np.argmin(np.abs(there - place))
        pressure[node] = 1e-2 / MESH.areas[node]
    contact = contact_of(pressure, (0.01 * pressure[pressure > 0.0]) ** 2)
    np.testing.assert_array_equal(significant_contact(MESH, contact), pressure > 0.0)
