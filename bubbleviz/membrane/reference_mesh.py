"""Meshing the reference surface of a sensor file."""

from __future__ import annotations

from collections.abc import Collection
from functools import lru_cache

import numpy as np

from bubbleviz.errors import InputError
from bubbleviz.membrane.flat_sheet import as_flat_sheet
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.meshing import EllipsoidalCap, load_membrane, mesh_cap
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
    axes = membrane.rim_semi_axes_m
    if membrane.shape == "mesh":
        assert membrane.mesh_file is not None  # `Membrane` checks that a shape has its numbers
        return load_membrane(sensor.resolve(membrane.mesh_file))
    if membrane.shape == "spherical_cap":
        assert membrane.rim_radius_m is not None
        axes = membrane.rim_radius_m, membrane.rim_radius_m
    assert axes is not None and membrane.height_m is not None
    cap = EllipsoidalCap.of(axes, membrane.height_m)
    return _meshed(cap, membrane.nodes if nodes is None else nodes)


_meshed = lru_cache(maxsize=8)(mesh_cap)  # meshes are never modified


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


def build_rubber(
    sensor: Sensor,
    mesh: MembraneMesh,
    tension_n_per_m: float,  # γ0, the mean tension, N/m
    rim_slack_m: float | None = None,  # as of `RubberMembrane`
) -> RubberMembrane:
    """Exact membrane of a sensor on a mesh of its reference surface.

    Its stiffness is μh = γ0 / (1 − λ⁻⁶) on average, its stress at rest balances the gauge
    pressure. A sensor without pre-stretch has constant tension.
    """
    stress, _ = _rest_stress(sensor, mesh, _stress_parameters(sensor))
    return _rubber(sensor, mesh, tension_n_per_m, rim_slack_m, stress)


def rubber_and_variants(
    sensor: Sensor,
    mesh: MembraneMesh,
    tension_n_per_m: float,
    rim_slack_m: float | None = None,
) -> tuple[RubberMembrane, list[RubberMembrane]]:
    """The membrane of `build_rubber`, and copies each with one of its parameters raised by its σ.

    Only those have a σ whose 95 % interval is in the sensor's calibration, and the gauge pressure
    also by its standard deviation in the sensor file.
    Stress at rest follows from shape, gauge pressure, share and unequal tension, whatever the
    material. γ0 is proportional to the gauge pressure (Young–Laplace), so its own copy is raised
    only by the part of its σ that the gauge pressure does not explain.
    """
    sigmas = {
        name: _deviation(
            getattr(sensor.calibration, f"{name}_interval", None),
            getattr(sensor.membrane, name),
            *limits,
        )
        for name, limits in RUBBER_PARAMETERS.items()
    }
    names = _stress_parameters(sensor) | {name for name in _OF_STRESS if sigmas[name]}
    stress, changes = _rest_stress(sensor, mesh, names)

    def rubber(
        own: Sensor, stress: np.ndarray | None, tension: float = tension_n_per_m
    ) -> RubberMembrane:
        return _rubber(own, mesh, tension, rim_slack_m, stress)

    varied, (tension, gauge) = [], _deviations(sensor, tension_n_per_m)
    if tension:
        varied.append(rubber(sensor, stress, tension_n_per_m + tension))
    if gauge:
        higher = sensor.pneumatics.gauge_pressure_pa + gauge
        factor = higher / sensor.pneumatics.gauge_pressure_pa
        own = changed(sensor, pneumatics={"gauge_pressure_pa": higher})
        raised = None if stress is None else factor * stress
        varied.append(rubber(own, raised, factor * tension_n_per_m))
    for name, sigma in sigmas.items():
        if sigma and name in changes:
            assert stress is not None  # it changes
            varied.append(rubber(sensor, stress + sigma * changes[name]))
        elif sigma and name not in _OF_STRESS:
            value = getattr(sensor.membrane, name) + sigma
            varied.append(rubber(changed(sensor, membrane={name: value}), stress))
    return rubber(sensor, stress), varied


def _rubber(
    sensor: Sensor,
    mesh: MembraneMesh,
    tension_n_per_m: float,
    rim_slack_m: float | None,
    stress: np.ndarray | None,
) -> RubberMembrane:
    """Membrane with a stress (m, 2, 2) at rest, see `_rest_stress`."""
    gauge, prestretch = sensor.pneumatics.gauge_pressure_pa, sensor.membrane.prestretch
    if prestretch is None:
        return RubberMembrane.uniform(mesh, gauge, tension_n_per_m, None, rim_slack_m)
    mu_h: float | np.ndarray = shear_stiffness(tension_n_per_m, prestretch)
    gradient = [getattr(sensor.membrane, f"stiffness_gradient_{axis}") or 0.0 for axis in "xyr"]
    if any(gradient):
        mu_h = mu_h * (1.0 + stiffness_changes(mesh) @ gradient)
    return prestressed(mesh, gauge, mu_h, stress, rim_slack_m)


def _stress_parameters(sensor: Sensor) -> set[str]:
    """Names of the parameters of the stress at rest that are not 0."""
    return {name for name in _OF_STRESS if getattr(sensor.membrane, name)}


def _rest_stress(
    sensor: Sensor, mesh: MembraneMesh, names: Collection[str]
) -> tuple[np.ndarray | None, dict[str, np.ndarray]]:
    """Stress of the reference surface under the gauge pressure, as of `Prestress.on`.

    And its changes by a unit of the named parameters: it is linear in these. None and no changes
    for constant tension.
    """
    if sensor.membrane.prestretch is None:
        return None, {}
    gauge = sensor.pneumatics.gauge_pressure_pa
    film, changes = Prestress.of(mesh, gauge), {}
    if "sheet_share" in names and (sheet := as_flat_sheet(mesh)):
        changes["sheet_share"] = sheet[0].times(gauge).minus(film)
    if unequal := set(_OF_STRESS[1:]) & set(names):
        fields = film.unequal(mesh, gauge)
        changes |= {name: fields[name] for name in sorted(unequal)}
    values = [getattr(sensor.membrane, name) or 0.0 for name in changes]
    stress = film.plus(changes.values(), values).on(mesh)
    return stress, {name: each.on(mesh) for name, each in changes.items()}


def stiffness_changes(mesh: MembraneMesh) -> np.ndarray:
    """Relative change of stiffness of the triangles by unit gradients in x, y and r, (m, 3).

    1 at the rim; in the middle 0, but −1 for that in r, so that the mean over the disc is 0.
    """
    extent = np.abs(mesh.nodes[mesh.rim, :2]).max(axis=0)
    centres = mesh.nodes[mesh.triangles, :2].mean(axis=1) / extent
    return np.column_stack([centres, 2.0 * (centres**2).sum(axis=1) - 1.0])


def constant_tension_deviation(sensor: Sensor, tension_n_per_m: float) -> float:
    """Relative standard deviation of forces by constant tension, of a sensor that is rubber.

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
