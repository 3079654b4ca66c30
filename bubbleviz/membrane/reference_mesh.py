"""Meshing the reference surface of a sensor file."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from bubbleviz.errors import InputError
from bubbleviz.membrane.flat_sheet import as_flat_sheet
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.meshing import EllipsoidalCap, load_membrane, mesh_cap, spherical_cap
from bubbleviz.membrane.prestress import Prestress, prestressed
from bubbleviz.membrane.rubber import RubberMembrane, shear_stiffness
from bubbleviz.membrane.stiffness import balance_tension
from bubbleviz.sensor import LARGEST_GRADIENT, Sensor, changed

RUBBER_PARAMETERS = {
    "prestretch": (1.0, np.inf),
    "sheet_share": (0.0, 1.0),
    "unequal_tension_x": (-1.0, 1.0),
    "unequal_tension_xy": (-1.0, 1.0),
    "stiffness_gradient_x": (-LARGEST_GRADIENT, LARGEST_GRADIENT),
    "stiffness_gradient_y": (-LARGEST_GRADIENT, LARGEST_GRADIENT),
    "stiffness_gradient_r": (-LARGEST_GRADIENT, LARGEST_GRADIENT),
}
"""Limits of the parameters of the rubber in the sensor file."""
_OF_STRESS = ("sheet_share", "unequal_tension_x", "unequal_tension_xy")
_CONSTANT_TENSION_ERROR = 0.13
"""Relative standard deviation of the stiffness of constant tension, as a model of rubber of unknown
λ. For the true force of a ball and a cylinder pressed 10 to 45 % of the height into a dome of 29 mm
on a rim of 45 mm, the stiffness has to change by 13 % rms (45 presses, exact γ0; 22 % at λ 1.03,
12, 8, 8, 11 and 12 % at 1.05, 1.08, 1.15, 1.3 and 1.6), on a sheet of 12 mm by 4 %: constant
tension is too soft at small λ and light touches, and too stiff in deep presses."""


def build_mesh(
    sensor: Sensor,
    # target number of nodes in place of the file's; a mesh from file keeps its own
    nodes: int | None = None,
) -> MembraneMesh:
    """Mesh of the sensor's reference surface S0.

    Raises InputError: the surface cannot be built; names the file and the place.
    """
    membrane = sensor.membrane
    cap = cap_of(sensor)
    if cap is not None:
        return _meshed(cap, membrane.nodes if nodes is None else nodes)
    assert membrane.mesh_file is not None  # checked by `Membrane`
    return load_membrane(sensor.resolve(membrane.mesh_file))


@lru_cache(maxsize=8)
def _meshed(cap: EllipsoidalCap, nodes: int) -> MembraneMesh:
    """Mesh of a sensor, cached, as meshes are never modified."""
    return mesh_cap(cap, nodes)


def cap_of(sensor: Sensor) -> EllipsoidalCap | None:
    """Analytic reference surface of a sensor; None where a mesh file gives it."""
    membrane = sensor.membrane
    if membrane.shape == "mesh":
        return None
    radius, axes, height = membrane.rim_radius_m, membrane.rim_semi_axes_m, membrane.height_m
    assert height is not None  # `Membrane` checks that a shape has its numbers
    if membrane.shape == "spherical_cap":
        assert radius is not None
        return spherical_cap(radius, height)
    assert axes is not None
    return EllipsoidalCap.of(axes, height)


def reference_tension(sensor: Sensor, mesh: MembraneMesh) -> float:
    """Tension γ0, N/m: the sensor file's, or else the one that balances the gauge pressure (Eq. 2).

    Raises InputError: the surface is flat or concave, so that no tension holds it.
    """
    given = sensor.pneumatics.tension_n_per_m
    if given is not None:
        return given
    try:
        return balance_tension(mesh, sensor.pneumatics.gauge_pressure_pa)
    except InputError as error:
        raise InputError(f"{sensor.name}: {error}, or give pneumatics.tension_n_per_m") from error


def rest_stress(sensor: Sensor, mesh: MembraneMesh) -> Prestress | None:
    """Stress of the reference surface under the gauge pressure; None for constant tension."""
    if sensor.membrane.prestretch is None:
        return None
    gauge, membrane = sensor.pneumatics.gauge_pressure_pa, sensor.membrane
    film = stress = Prestress.of(mesh, gauge)
    if membrane.sheet_share and (sheet := as_flat_sheet(mesh)):
        stress = film.towards(sheet[0].times(gauge), membrane.sheet_share)
    unequal = [membrane.unequal_tension_x or 0.0, membrane.unequal_tension_xy or 0.0]
    return stress.plus(film.unequal(mesh, gauge).values(), unequal) if any(unequal) else stress


def build_rubber(
    sensor: Sensor,
    mesh: MembraneMesh,
    tension_n_per_m: float,  # γ0, the mean tension, N/m
    rim_slack_m: float | None = None,  # as of `RubberMembrane`
    # as of `rest_stress`, found from the mesh where not given; that of a coarser mesh of the
    # surface saves time
    stress: Prestress | None = None,
) -> RubberMembrane:
    """Exact membrane of a sensor on a mesh of its reference surface.

    Its stiffness is μh = γ0 / (1 − λ⁻⁶) on average, its stress at rest balances the gauge
    pressure. A sensor without pre-stretch has constant tension.
    """
    gauge, prestretch = sensor.pneumatics.gauge_pressure_pa, sensor.membrane.prestretch
    if prestretch is None:
        return RubberMembrane.uniform(mesh, gauge, tension_n_per_m, None, rim_slack_m)
    mu_h: float | np.ndarray = shear_stiffness(tension_n_per_m, prestretch)
    gradient = [getattr(sensor.membrane, f"stiffness_gradient_{axis}") or 0.0 for axis in "xyr"]
    if any(gradient):
        mu_h = mu_h * (1.0 + stiffness_changes(mesh) @ gradient)
    stress = rest_stress(sensor, mesh) if stress is None else stress
    return prestressed(mesh, gauge, mu_h, stress, rim_slack_m)


def stiffness_changes(mesh: MembraneMesh) -> np.ndarray:
    """Relative change of stiffness of the triangles by unit gradients in x, y and r, (m, 3).

    1 at the rim; in the middle 0, but −1 for that in r, so that the mean over the disc is 0.
    """
    extent = np.abs(mesh.nodes[mesh.rim, :2]).max(axis=0)
    centres = mesh.nodes[mesh.triangles, :2].mean(axis=1) / extent
    return np.column_stack([centres, 2.0 * (centres**2).sum(axis=1) - 1.0])


def varied_rubber(
    sensor: Sensor,
    mesh: MembraneMesh,
    tension_n_per_m: float,
    rim_slack_m: float | None = None,
    stress: Prestress | None = None,
) -> list[RubberMembrane]:
    """Copies of the membrane, each with one of its parameters raised by its σ.

    Only those have a σ whose 95 % interval is in the sensor's calibration, and the gauge pressure
    also by its standard deviation in the sensor file. Parameters as of `build_rubber`.
    Stress at rest follows from shape, gauge pressure, share and unequal tension, whatever the
    material. γ0 is proportional to the gauge pressure (Young–Laplace), so its own copy is raised
    only by the part of its σ that the gauge pressure does not explain.
    """
    pneumatics, varied = sensor.pneumatics, []
    tension, gauge = _deviations(sensor, tension_n_per_m)
    if tension:
        varied.append(build_rubber(sensor, mesh, tension_n_per_m + tension, rim_slack_m, stress))
    if gauge:
        higher = pneumatics.gauge_pressure_pa + gauge
        other = changed(sensor, pneumatics={"gauge_pressure_pa": higher})
        factor = higher / pneumatics.gauge_pressure_pa
        raised = None if stress is None else stress.times(factor)
        varied.append(build_rubber(other, mesh, factor * tension_n_per_m, rim_slack_m, raised))
    for name, limits in RUBBER_PARAMETERS.items():
        value = getattr(sensor.membrane, name)
        interval = getattr(sensor.calibration, f"{name}_interval", None)
        if sigma := _deviation(interval, value, *limits):
            other = changed(sensor, membrane={name: value + sigma})
            own = None if name in _OF_STRESS else stress
            varied.append(build_rubber(other, mesh, tension_n_per_m, rim_slack_m, own))
    return varied


def constant_tension_deviation(sensor: Sensor, tension_n_per_m: float) -> float:
    """Relative standard deviation of the stiffness of a sensor as a membrane of constant tension.

    From the errors of γ0 and of the gauge pressure, and the difference between rubber and constant
    tension.
    """
    tension, gauge = _deviations(sensor, tension_n_per_m)
    by_gauge = gauge / sensor.pneumatics.gauge_pressure_pa
    return float(np.linalg.norm([tension / tension_n_per_m, by_gauge, _CONSTANT_TENSION_ERROR]))


def _deviations(sensor: Sensor, tension_n_per_m: float) -> tuple[float, float]:
    """Of γ0 at a known gauge pressure, and of that; 0: not given."""
    known, pneumatics = sensor.calibration, sensor.pneumatics
    gauge = tension = 0.0
    if known is not None:
        gauge = _deviation(known.gauge_interval_pa, pneumatics.gauge_pressure_pa)
        by_gauge = tension_n_per_m * gauge / pneumatics.gauge_pressure_pa
        whole = _deviation(known.tension_interval_n_per_m, tension_n_per_m)
        tension = float(np.sqrt(max(whole**2 - by_gauge**2, 0.0)))
    if pneumatics.gauge_sigma_pa is not None:
        gauge = pneumatics.gauge_sigma_pa
    return tension, gauge


def _deviation(
    interval: tuple[float, float] | None,
    value: float | None,
    least: float = 0.0,
    most: float = np.inf,
) -> float:
    """Standard deviation by a value's 95 % interval; 0 where there is none.

    An end at what is possible, `least` or `most`, is cut off, so only the other one counts; of an
    interval between both, the distribution is uniform.
    """
    if interval is None or value is None:
        return 0.0
    low, high = interval
    sides = [value - low] * (low > least) + [high - value] * (high < most)
    return float(np.mean(sides)) / 1.96 if sides else (most - least) / float(np.sqrt(12.0))
