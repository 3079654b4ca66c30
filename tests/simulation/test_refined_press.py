"""Objects with edges pressed in: a rod against the meridian's equations, fillets, sharp edges."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bubbleviz.membrane import RubberForward, RubberMembrane, mesh_cap
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor import load_sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation import (
    EDGE_RADIUS_M,
    RubberPresses,
    presses as presses_of,
    refined_press,
    rubber_sensor,
    study_object,
)
from tests.membrane.domes import CAP, GAUGE, TENSION, A, H, force, gas_of, pose
from tests.oracles.rubber_oracle import AxialRubber

ROD = 0.012  # radius of the preset cylinder
ELL = str(Path(__file__).parents[2] / "benchmarks/objects/ell.ply")


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


@pytest.mark.long
@pytest.mark.parametrize("name", ["frustum", ELL])
def test_edges_on_a_mesh_for_simulation_have_an_equilibrium(name):
    """Nodes 3.4 mm apart at first; a coarse fillet, and sharp edges at a thin far end."""
    model = SensorModel.of(rubber_sensor(load_sensor("pico_flexx_75mm")))
    presses, obj = RubberPresses.of(model), study_object(name)
    (press,) = presses_of((name,), (0.010,))
    _, contact = presses.solved(obj, press.pose(presses.mesh, 7))
    assert contact.converged
    assert contact.balance_residual < 1e-4
    assert contact.iterations < 60
