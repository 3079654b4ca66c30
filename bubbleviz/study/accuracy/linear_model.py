"""Error of the linear membrane against the exact axisymmetric bubble."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from bubbleviz.errors import SolveError
from bubbleviz.files.tables import write_csv
from bubbleviz.membrane.cap_mesh import mesh_cap, spherical_cap
from bubbleviz.membrane.forward_model import ForwardModel
from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.sensor import Sensor
from bubbleviz.study.accuracy.exact_bubble import AxialContact, Bubble, axial_contact
from bubbleviz.study.report_files import save_figure

FILES = ("linear_model.csv", "linear_model.png")
BALLS_M = {"ball of 15 mm": 0.015, "ball of 30 mm": 0.030, "plate": np.inf}


@dataclass(frozen=True)
class Comparison:
    """Linear and exact solution of one press on the axis."""

    object_name: str
    depth_m: float
    force_exact_n: float
    force_linear_n: float
    force_error_relative: float
    gas_pressure_change_exact_pa: float
    gas_pressure_change_linear_pa: float
    gas_error_relative: float
    contact_radius_exact_m: float
    contact_radius_linear_m: float


def bubble_of(sensor: Sensor) -> Bubble | None:
    """The sensor as the oracle knows it; None unless it is a spherical cap below a hemisphere."""
    membrane, gas = sensor.membrane, sensor.pneumatics
    radius, height = membrane.rim_radius_m, membrane.height_m
    if membrane.shape != "spherical_cap" or radius is None or height is None or height > radius:
        return None
    return Bubble(
        radius,
        height,
        gas.gauge_pressure_pa,
        gas.atmospheric_pressure_pa,
        gas.chamber_volume_m3,
    )


def compare(bubble: Bubble, depths_m: np.ndarray, nodes: int = 6_000) -> list[Comparison]:
    """Linear model against the exact bubble for balls and a plate."""
    mesh = mesh_cap(spherical_cap(bubble.rim_radius_m, bubble.height_m), nodes)
    P0 = bubble.atmospheric_pressure_pa + bubble.gauge_pressure_pa
    gas = Gas(P0, bubble.chamber_volume_m3 + mesh.cap_volume(), mesh.areas)
    model = ForwardModel(mesh, bubble.tension_n_per_m, gas)
    found = []
    for name, ball in BALLS_M.items():
        for depth in depths_m:
            try:
                exact = axial_contact(bubble, float(depth), ball)
            except (SolveError, ValueError):  # beyond the ball's equator, or of the bubble
                break
            found.append(_comparison(name, bubble, model, exact, float(depth), ball))
    return found


def _comparison(
    name: str, bubble: Bubble, model: ForwardModel, exact: AxialContact, depth: float, ball: float
) -> Comparison:
    mesh = model.mesh
    contact = model.solve(_exact_gap(mesh, bubble.height_m - depth, ball))
    force = float((mesh.areas * contact.contact_pressure_pa) @ mesh.normals[:, 2])
    touched = mesh.deformed(contact.displacement_m)[contact.contact_pressure_pa > 0.0]
    gas = contact.gas_pressure_change_pa
    return Comparison(
        object_name=name,
        depth_m=depth,
        force_exact_n=exact.force_n,
        force_linear_n=force,
        force_error_relative=force / exact.force_n - 1.0,
        gas_pressure_change_exact_pa=exact.gas_pressure_change_pa,
        gas_pressure_change_linear_pa=gas,
        gas_error_relative=gas / exact.gas_pressure_change_pa - 1.0,
        contact_radius_exact_m=exact.contact_radius_m,
        contact_radius_linear_m=float(np.hypot(*touched[:, :2].T).max(initial=0.0)),
    )


def _exact_gap(mesh: MembraneMesh, tip_m: float, ball: float) -> np.ndarray:
    """Way along the normals to a ball, or a plate, whose lowest point is at height `tip_m`."""
    if not np.isfinite(ball):
        way = (tip_m - mesh.nodes[:, 2]) / mesh.normals[:, 2]
        return np.where(mesh.normals[:, 2] > 0.0, way, np.inf)
    offset = mesh.nodes - [0.0, 0.0, tip_m + ball]
    along = np.einsum("ij,ij->i", offset, mesh.normals)
    inside = along**2 - np.einsum("ij,ij->i", offset, offset) + ball**2
    return np.where(inside > 0.0, -along - np.sqrt(np.maximum(inside, 0.0)), np.inf)


def write(comparisons: list[Comparison], folder: Path) -> list[Path]:
    """Write linear_model.csv and linear_model.png; the paths."""
    paths = [folder / name for name in FILES]
    write_csv(paths[0], comparisons)
    _plot(comparisons, paths[1])
    return paths


def _plot(comparisons: list[Comparison], path: Path) -> None:
    figure = Figure(figsize=(12, 4.5), layout="constrained")
    force, error, gas = figure.subplots(1, 3)
    for k, name in enumerate(dict.fromkeys(c.object_name for c in comparisons)):
        own = [c for c in comparisons if c.object_name == name]
        depth = [1e3 * c.depth_m for c in own]
        color = f"C{k}"
        force.plot(depth, [c.force_exact_n for c in own], color=color, label=f"{name}, exact")
        force.plot(depth, [c.force_linear_n for c in own], "--", color=color, label="linear")
        relative = [100.0 * c.force_error_relative for c in own]
        error.plot(depth, relative, color=color, label=name)
        gas.plot(depth, [100.0 * c.gas_error_relative for c in own], color=color, label=name)
    force.set(ylabel="force, N", title="Pressed on the axis")
    error.set(ylabel="error of the linear model's force, %", title="Force")
    gas.set(ylabel="error of the linear model's p_v, %", title="Gas pressure")
    for axes in (force, error, gas):
        axes.set(xlabel="depth, mm")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    save_figure(figure, path)
