"""A sharp-edged object pressed in, against the meridian's equations."""

from dataclasses import replace

import numpy as np
import pytest

from bubbleviz.membrane import RubberForward, RubberMembrane, mesh_cap
from bubbleviz.rigid_object import load_object
from bubbleviz.simulation import EDGE_RADIUS_M, refined_press
from tests.membrane.domes import CAP, GAUGE, TENSION, A, H, force, gas_of, pose
from tests.oracles.rubber_oracle import AxialRubber

ROD = 0.012  # radius of the preset cylinder


def rubber(mesh):
    nodes = np.where(mesh.rim[:, None], mesh.nodes, CAP.project(mesh.nodes))
    return RubberMembrane.uniform(replace(mesh, nodes=nodes), GAUGE, TENSION, 1.2)


@pytest.mark.long
def test_sharp_end_of_a_rod_on_the_axis():
    """Between rods as wide as its face and as its flat part; the even mesh falls short of both."""
    dome = AxialRubber.dome(A, H, 1.2, GAUGE)
    wide, narrow = (dome.press(0.005, face_radius_m=ROD - cut) for cut in (0.0, EDGE_RADIUS_M))
    assert wide.contact_radius_m == pytest.approx(ROD, rel=1e-6)
    mesh, obj, there = mesh_cap(CAP, 1000), load_object("cylinder"), pose(z=H - 0.005)
    _, fine = refined_press(rubber, gas_of, mesh, obj, there)
    assert fine.converged
    assert fine.balance_residual < 1e-6
    assert narrow.force_n < force(fine) < wide.force_n
    gas = (press.gas_pressure_change_pa for press in (narrow, wide))
    assert next(gas) < fine.gas_pressure_change_pa < next(gas)
    even = RubberForward(rubber(mesh), gas_of(mesh)).press(obj, there)
    assert even.converged
    assert force(even) < narrow.force_n
