"""What is kept of frames, and what is let go."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bubbleviz.diagnostics.frame_numbers import Numbers
from bubbleviz.membrane.cap_mesh import mesh_cap, spherical_cap
from bubbleviz.result import Estimate, FineContact
from bubbleviz_ui.engine.kept_estimates import KeptEstimates

NODES = 1000


def estimate() -> Estimate:
    nothing = np.zeros(NODES)
    return Estimate("no_contact", nothing, nothing.copy(), 0.0, 0.0, 0.0)


def test_the_oldest_is_let_go_first() -> None:
    kept = KeptEstimates(3 * 2 * 8 * NODES)  # three of them
    for frame in (0, 1, 2, 0, 3):  # frame 0 is computed again
        kept.keep(frame, Numbers(area_m2=frame), estimate())
    assert kept.get(1) is None
    known = [kept.get(frame) for frame in (0, 2, 3)]
    assert [each[0].area_m2 for each in known if each] == [0, 2, 3]


def test_what_a_finer_mesh_takes_counts_too() -> None:
    mesh = mesh_cap(spherical_cap(0.045, 0.02), NODES)
    nothing = np.zeros(len(mesh.nodes))
    fine = FineContact(mesh, np.zeros((len(nothing), 2), int), nothing, mesh.nodes, 1e-3)
    kept = KeptEstimates(5 * 2 * 8 * NODES)
    for frame in range(3):
        kept.keep(frame, Numbers(), replace(estimate(), fine=fine))
    _ = mesh.rings  # found later, and kept by the mesh
    kept.keep(3, Numbers(), estimate())
    assert [frame for frame in range(4) if kept.get(frame)] == [3]
