"""Stress at rest from shape and pressure: against the meridian's equations and by balance."""

from dataclasses import replace

import numpy as np
import pytest
from domes import GAUGE, A, H, force, gas_of, plate, pose

from bubbleviz.errors import InputError
from bubbleviz.membrane import (
    EllipsoidalCap,
    Inflation,
    MembraneMesh,
    Prestress,
    RubberForward,
    RubberMembrane,
    balance_tension,
    build_mesh,
    build_rubber,
    inverse_metric,
    mesh_cap,
    prestressed,
    reference_tension,
    refinement,
    rubber_and_variants,
    spherical_cap,
    zernike,
)
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor import Calibration, load_sensor
from tests.oracles.axial_mesh import swept_mesh
from tests.oracles.rubber_oracle import AxialRubber
from tests.small_press import changed

BALL = 0.015  # of the preset
TRUTHS = {
    "dome": AxialRubber.dome(A, H, 1.2, GAUGE),
    "flat, little stretched": AxialRubber(A, 60.0, 1.1, GAUGE),
    "flat, stretched": AxialRubber(A, 60.0, 1.3, GAUGE),
}


def tensions(membrane):
    """Principal tensions along and around, and the radius, of every triangle."""
    mesh = membrane.mesh
    stress, centre = membrane.stress(mesh.nodes), mesh.nodes[mesh.triangles].mean(axis=1)
    radius = np.hypot(centre[:, 0], centre[:, 1])
    around = np.column_stack([-centre[:, 1], centre[:, 0], 0.0 * radius]) / radius[:, None]
    t2 = np.einsum("ti,tij,tj->t", around, stress, around)
    return np.trace(stress, axis1=1, axis2=2) - t2, t2, radius


@pytest.mark.parametrize("name", TRUTHS)
def test_tensions_and_stretches_along_the_meridian(name):
    """The stress-free triangles are those of the sheet, given the right μh."""
    truth = TRUTHS[name]
    mesh = swept_mesh(truth.rest, 1200)
    membrane = prestressed(mesh, GAUGE, truth.mu_h_n_per_m)
    *found, radius = tensions(membrane)
    for k, most in ((0, 0.006), (1, 0.015)):
        exact = np.interp(radius, truth.rest.r_m, truth.rest.tensions_n_per_m[:, k])
        assert np.sqrt(np.mean((found[k] / exact - 1.0) ** 2)) < most
    stretched = np.interp(radius, truth.rest.r_m, truth.rest.stretches.prod(axis=1))
    error = mesh.facet_areas / membrane.stress_free_area / stretched - 1.0
    assert np.sqrt(np.mean(error**2)) < 0.025


@pytest.mark.parametrize("name", TRUTHS)
@pytest.mark.parametrize("ball", [np.inf, BALL])
def test_force_of_a_press(name, ball):
    """To 35 % of the height; uniform tension is 2 to 7 % short on sheets that were flat."""
    truth = TRUTHS[name]
    depth = 0.35 * truth.height_m
    mesh = swept_mesh(truth.rest, 1200)
    membrane = prestressed(mesh, GAUGE, truth.mu_h_n_per_m)
    obj = load_object("sphere") if np.isfinite(ball) else plate()
    contact = RubberForward(membrane, gas_of(mesh)).press(obj, pose(z=truth.height_m - depth))
    assert contact.converged
    assert force(contact) == pytest.approx(truth.press(depth, ball).force_n, rel=0.01)


@pytest.fixture(scope="module")
def punyo():
    """The preset, its mesh and γ0."""
    sensor = load_sensor("punyo_oval_d405")
    mesh = build_mesh(sensor)
    return sensor, mesh, reference_tension(sensor, mesh)


def oval(nodes):
    return mesh_cap(EllipsoidalCap.of((0.0557, 0.0396), 0.0305, 0.0437), nodes)


def test_oval_is_in_equilibrium_with_varying_tension():
    """Residual of smoothed nodal forces relative to the load, against uniform tension."""
    mesh = oval(1500)
    field = prestressed(mesh, 5000.0, 400.0)
    uniform = RubberMembrane.uniform(mesh, 5000.0, field.mean_tension, 1.2)
    x, y, z = mesh.nodes.T
    smooth = [z * (z / z.max()) ** k * np.cos(a * x / 0.04) * np.cos(b * y / 0.04)
              for k in (0, 1) for a in (0, 2) for b in (0, 2)]  # fmt: skip
    load = 5000.0 * mesh.areas
    left = [
        max(np.linalg.norm(s @ m.rest_force) / (np.abs(s) @ load) for s in smooth)
        for m in (field, uniform)
    ]
    assert left[0] < 0.002 < 0.02 < left[1]


def test_all_meshes_of_a_surface_have_the_same_stress():
    coarse, fine = oval(800), oval(2400)
    field = Prestress.of(coarse, 5000.0)
    assert field.weights == pytest.approx(
        Prestress.of(fine, 5000.0).weights, abs=0.02 * field.weights[0, 0]
    )
    tension = prestressed(coarse, 5000.0, 400.0).mean_tension
    cut = refinement(coarse, np.arange(len(coarse.triangles)) % 7 == 0).mesh
    for mesh in (cut, fine):
        assert prestressed(mesh, 5000.0, 400.0, field).mean_tension == pytest.approx(
            tension, rel=2e-3
        )


def test_stress_that_balance_leaves_open_follows_a_given_field():
    """An inflated oval sheet, flat at rest, against the stress of its own equilibrium."""
    flat = oval(1500)
    flat = replace(flat, nodes=flat.nodes * [1.0, 1.0, 0.0])
    rubber = RubberMembrane(flat, 0.0, 1.05**2 * inverse_metric(flat), 140.0)
    sheet = replace(flat, nodes=Inflation(rubber, np.zeros_like(flat.nodes)).at(2500.0))
    exact = Prestress.fitted(sheet, rubber.stress(sheet.nodes))
    alone, near = Prestress.of(sheet, 2500.0), Prestress.of(sheet, 2500.0, near=exact)
    errors = [np.linalg.norm(each.weights - exact.weights) for each in (alone, near)]
    assert errors[1] < 0.1 * errors[0]
    assert errors[0] > 0.05 * exact.weights[0, 0]
    tau, corners = exact.on(sheet), sheet.nodes[sheet.triangles]
    edges = corners[:, 1:] - corners[:, :1]
    stress = edges.swapaxes(1, 2) @ tau @ edges
    assert stress == pytest.approx(rubber.stress(sheet.nodes), abs=0.1 * exact.weights[0, 0])


def test_membrane_of_a_sensor():
    """μh = γ0/(1 − λ⁻⁶); without λ the tension is constant."""
    sensor = load_sensor("pico_flexx_75mm")
    mesh = build_mesh(sensor, 600)
    tension = reference_tension(sensor, mesh)
    constant = build_rubber(sensor, mesh, tension).stress(mesh.nodes)
    assert np.trace(constant, axis1=1, axis2=2) == pytest.approx(2.0 * tension, rel=1e-9)
    rubber = build_rubber(changed(sensor, membrane={"prestretch": 1.2}), mesh, tension)
    assert rubber.mu_h == pytest.approx(tension / (1.0 - 1.2**-6))
    assert rubber.mean_tension == pytest.approx(tension, rel=5e-3)
    stretch = np.sqrt(mesh.facet_areas.sum() / rubber.stress_free_area.sum())
    assert stretch == pytest.approx(1.2, abs=5e-3)


def test_stiffness_gradient_of_a_sensor_changes_the_rubber_not_its_stress_at_rest(punyo):
    sensor, mesh, tension = punyo
    even = build_rubber(sensor, mesh, tension)
    along_x = changed(sensor, membrane={"stiffness_gradient_x": 0.2})
    rubber = build_rubber(along_x, mesh, tension)
    assert rubber.force(mesh.nodes) == pytest.approx(even.force(mesh.nodes), abs=1e-12)
    share = rubber.mu_h / even.mu_h
    x, y = (mesh.nodes[mesh.triangles, k].mean(axis=1) for k in (0, 1))
    left, right = x < 0.9 * x.min(), x > 0.9 * x.max()
    assert share[left].max() < 0.85 and share[right].min() > 1.15
    assert share[np.abs(x) < 1e-3] == pytest.approx(1.0, abs=5e-3)
    assert np.corrcoef(share, y)[0, 1] == pytest.approx(0.0, abs=0.05)


@pytest.fixture(scope="module")
def oval_sheet():
    """A flat sheet that was stretched over an oval rim and inflated, and its sensor file."""
    cap = mesh_cap(EllipsoidalCap.of((0.0557, 0.0396), 0.012), 700)
    flat = replace(cap, nodes=cap.nodes * [1.0, 1.0, 0.0])
    rubber = RubberMembrane(flat, 0.0, 1.05**2 * inverse_metric(flat), 140.0)
    rest = replace(flat, nodes=Inflation(rubber, np.zeros_like(flat.nodes)).at(2500.0, cap.nodes))
    tension = balance_tension(rest, 2500.0)
    stretch = (1.0 - tension / 140.0) ** (-1.0 / 6.0)
    sensor = changed(
        load_sensor("pico_flexx_75mm"),
        membrane={"prestretch": stretch},
        pneumatics={"gauge_pressure_pa": 2500.0},
    )
    return rubber.stress(rest.nodes), rest, sensor, tension


def test_share_of_the_sheet_gives_the_stress_that_an_oval_rim_leaves_open(oval_sheet):
    truth, rest, sensor, tension = oval_sheet

    def error(share):
        own = changed(sensor, membrane={"sheet_share": share})
        return np.sqrt(np.mean((build_rubber(own, rest, tension).stress(rest.nodes) - truth) ** 2))

    assert error(0.7) < 0.4 * error(None)
    assert error(0.0) == error(None)


@pytest.mark.parametrize("turn", [0.0, 0.5, 2.0])
def test_a_sheet_stretched_unequally_over_a_round_rim(turn):
    """By the tensions of flat neo-Hookean rubber, T₁ = μh (λ₁/λ₂ − (λ₁λ₂)⁻³), before inflation."""
    cap = mesh_cap(spherical_cap(0.041, 0.005), 700)
    flat = replace(cap, nodes=cap.nodes * [1.0, 1.0, 0.0])
    most, least = 1.22, 1.10  # along a direction turned from x, and across it
    along = np.array([np.cos(turn), np.sin(turn), 0.0])
    free = flat.nodes / least + np.outer(flat.nodes @ along, along) * (1.0 / most - 1.0 / least)
    rubber = RubberMembrane(flat, 0.0, inverse_metric(replace(flat, nodes=free)), 140.0)
    rest = replace(flat, nodes=Inflation(rubber, np.zeros_like(flat.nodes)).at(1000.0, cap.nodes))
    squeezed = (most * least) ** -3
    high, low = most / least - squeezed, least / most - squeezed
    part = (high - low) / (high + low)
    sensor = changed(
        load_sensor("pico_flexx_75mm"),
        membrane={"prestretch": 1.2},
        pneumatics={"gauge_pressure_pa": 1000.0},
    )

    def error(**unequal):
        own = changed(sensor, membrane=unequal)
        stress = build_rubber(own, rest, balance_tension(rest, 1000.0)).stress(rest.nodes)
        return np.sqrt(np.mean((stress - rubber.stress(rest.nodes)) ** 2))

    x, xy = part * np.cos(2.0 * turn), part * np.sin(2.0 * turn)
    assert error(unequal_tension_x=x, unequal_tension_xy=xy) < 0.15 * error()


@pytest.mark.parametrize("name", ["sheet_share", "unequal_tension_x", "unequal_tension_xy"])
def test_error_of_the_stress_at_rest_varies_the_stress_alone(oval_sheet, name):
    _, rest, sensor, tension = oval_sheet
    calibration = Calibration(pixels_file="none.npz", **{f"{name}_interval": (0.304, 0.696)})
    own = changed(sensor, membrane={name: 0.5}).model_copy(update={"calibration": calibration})
    _, (varied,) = rubber_and_variants(own, rest, tension)
    expected = build_rubber(changed(sensor, membrane={name: 0.6}), rest, tension)
    np.testing.assert_allclose(varied.stress(rest.nodes), expected.stress(rest.nodes), rtol=1e-6)
    np.testing.assert_allclose(varied.mu_h, expected.mu_h)


def test_unphysical_stress_is_carried_by_thicker_rubber():
    mesh = oval(300)
    membrane = prestressed(mesh, 5000.0, 100.0)  # less than the tension
    assert membrane.mu_h.mean() > 105.0 and membrane.mean_tension > 100.0


def test_flat_membrane_is_refused():
    flat = mesh_cap(spherical_cap(A, H), 200)
    flat = MembraneMesh(flat.nodes * [1.0, 1.0, 0.0], flat.triangles, flat.rim)
    with pytest.raises(InputError, match="flat"):
        Prestress.of(flat, GAUGE)


def test_map_of_a_sphere_is_stereographic():
    """A conformal map, and harmonic ones of a disc to a circle are unique."""
    mesh = mesh_cap(spherical_cap(A, H), 1500)
    disc = mesh.disc
    below = H - (A**2 + H**2) / H  # the pole of the projection
    exact = mesh.nodes[:, :2] / (mesh.nodes[:, 2:] - below)
    exact /= np.linalg.norm(exact[mesh.rim], axis=1).max()
    assert np.abs(disc - exact).max() < 2e-3


def test_zernike_polynomials_are_orthonormal_over_the_disc():
    r, w = np.polynomial.legendre.leggauss(12)
    angle = 2.0 * np.pi * np.arange(24) / 24
    r, w = 0.5 * (r + 1.0), 0.5 * w
    at = (r[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)).reshape(-1, 2)
    weight = np.repeat(2.0 * r * w / 24, 24)
    values = zernike(at, 8)
    assert values.shape[1] == 45
    np.testing.assert_allclose(values.T @ (weight[:, None] * values), np.eye(45), atol=1e-12)


def test_gauge_pressure_uncertainty_is_counted_once(punyo):
    """The interval of γ0 includes the gauge pressure's: the variants together spread as it does."""
    sensor, mesh, tension = punyo
    known = sensor.calibration
    usual, varied = rubber_and_variants(sensor, mesh, tension)
    moved = [each.mean_tension - usual.mean_tension for each in varied[:2]]
    low, high = known.tension_interval_n_per_m
    assert np.hypot(*moved) == pytest.approx((high - low) / (2 * 1.96), rel=0.05)


def test_proportional_errors_of_gauge_pressure_and_tension_keep_the_stretch(punyo):
    """Young–Laplace: the stress-free shape is that of their ratio."""
    sensor, mesh, tension = punyo
    usual, (_, by_gauge, *_) = rubber_and_variants(sensor, mesh, tension)
    low, high = sensor.calibration.gauge_interval_pa
    share = 1.0 + (high - low) / (2 * 1.96) / sensor.pneumatics.gauge_pressure_pa
    assert by_gauge.gauge_pressure_pa / usual.gauge_pressure_pa == pytest.approx(share, rel=1e-3)
    np.testing.assert_allclose(by_gauge.mu_h, share * usual.mu_h, rtol=1e-3)
    np.testing.assert_allclose(by_gauge.stress_free_area, usual.stress_free_area, rtol=1e-3)


def test_a_gauge_pressure_with_its_deviation_is_varied_without_a_calibration(punyo):
    """`gauge_sigma_pa` counts in place of the calibration's interval, too."""
    sensor, mesh, tension = punyo
    told = changed(sensor, pneumatics={"gauge_sigma_pa": 700.0})
    plain = told.model_copy(update={"calibration": None})
    raised = sensor.pneumatics.gauge_pressure_pa + 700.0
    usual, (by_gauge,) = rubber_and_variants(plain, mesh, tension)
    assert by_gauge.gauge_pressure_pa == pytest.approx(raised)
    share = raised / sensor.pneumatics.gauge_pressure_pa
    assert by_gauge.mean_tension == pytest.approx(share * usual.mean_tension)
    assert rubber_and_variants(told, mesh, tension)[1][1].gauge_pressure_pa == pytest.approx(raised)


def test_a_variant_under_a_higher_gauge_pressure_is_the_membrane_of_that_sensor():
    sensor = load_sensor("punyo_oval_d405")
    mesh = build_mesh(sensor, 300)
    tension = reference_tension(sensor, mesh)
    usual, varied = rubber_and_variants(sensor, mesh, tension)
    assert len(varied) == 8  # γ0, gauge pressure, λ, five others of the rubber
    gauge = varied[1].gauge_pressure_pa
    own = changed(sensor, pneumatics={"gauge_pressure_pa": gauge})
    raised = build_rubber(own, mesh, gauge / usual.gauge_pressure_pa * tension)
    for one, other in ((usual, build_rubber(sensor, mesh, tension)), (varied[1], raised)):
        expected = other.stress(mesh.nodes)
        np.testing.assert_allclose(
            one.stress(mesh.nodes), expected, atol=1e-9 * np.abs(expected).max()
        )
