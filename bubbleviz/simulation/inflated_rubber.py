"""Simulated sensors of known rubber at several inflation levels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from bubbleviz.camera import DepthCamera, MembraneView
from bubbleviz.membrane import (
    EllipsoidalCap,
    Inflation,
    MembraneMesh,
    RubberMembrane,
    balance_tension,
    inverse_metric,
    mesh_cap,
)
from bubbleviz.recordings import Frame, HeldFrames
from bubbleviz.sensor import Camera, Membrane, Pneumatics, Sensor
from bubbleviz.simulation.depth_noise import DepthNoise

PRESSURE_NOISE_PA = 5.0  # σ of the measured pressure of a frame


def still_frames(
    camera: DepthCamera,
    membrane: MembraneMesh,  # deformed by the gas pressure
    gas_pressure_pa: float,  # absolute
    noise: DepthNoise,
    frames: int,
    seed: int,
) -> list[Frame]:
    """Frames of a membrane that does not move, with its measured gas pressure."""
    range_m = MembraneView(camera, membrane).rest_range
    draws = np.random.default_rng([seed, 3]).standard_normal(frames)
    return [
        Frame(
            index=index,
            time_s=index / 30.0,
            depth_m=noise.depth_image(camera, range_m, seed, index),
            intrinsics=camera.intrinsics,
            gas_pressure_pa=float(gas_pressure_pa + PRESSURE_NOISE_PA * draw),
        )
        for index, draw in enumerate(draws)
    ]


ATMOSPHERE_PA = 98_700.0  # at 225 m above sea level, unlike the default of sensor files
CHAMBER_M3 = 3e-4
_NODES = 3_000
CAMERA_NOISE = DepthNoise(absolute_m=5e-5, correlation_px=2.0, correlation_frames=0.5)
"""σ and correlation in space and time of a RealSense D405 in a soft bubble."""


@dataclass(frozen=True)
class InflatedRubber:
    """A membrane of known rubber."""

    name: str
    rim_semi_axes_m: tuple[float, float]  # (ax, ay)
    gauge_pressure_pa: float  # G at rest
    mu_h_n_per_m: float
    # γ0: uniform tension that balances the gauge pressure over the surface at rest, as in
    # identification and sensor files. The mean tension over an oval rim differs by 2 %, as shape
    # and pressure do not determine it.
    tension_n_per_m: float
    shape: Callable[[float], MembraneMesh]  # membrane under a gauge pressure in Pa
    sheet: MembraneMesh  # the same triangles, stretched over the rim without pressure
    sheet_stretch: float  # λ of that

    @cached_property
    def rest(self) -> MembraneMesh:
        """Membrane under the gauge pressure at rest."""
        return self.shape(self.gauge_pressure_pa)

    @property
    def pneumatics(self) -> Pneumatics:
        """True values."""
        return Pneumatics(
            gauge_pressure_pa=self.gauge_pressure_pa,
            atmospheric_pressure_pa=ATMOSPHERE_PA,
            chamber_volume_m3=CHAMBER_M3,
            tension_n_per_m=self.tension_n_per_m,
        )

    @property
    def prestretch(self) -> float:
        """λ of γ0, μh = γ0 / (1 − λ⁻⁶)."""
        return float((1.0 - self.tension_n_per_m / self.mu_h_n_per_m) ** (-1.0 / 6.0))

    @classmethod
    def oval_sheet(
        cls,
        rim_semi_axes_m: tuple[float, float],
        mu_h_n_per_m: float,
        prestretch: float,
        gauge_pressure_pa: float,
    ) -> InflatedRubber:
        """A flat sheet, stretched by λ over a rim and inflated, on a fine mesh."""
        cap = mesh_cap(EllipsoidalCap.of(rim_semi_axes_m, 0.3 * min(rim_semi_axes_m)), _NODES)
        flat = replace(cap, nodes=cap.nodes * [1.0, 1.0, 0.0])
        stretched = flat, mu_h_n_per_m, prestretch, gauge_pressure_pa
        return cls._on_mesh("oval sheet", rim_semi_axes_m, *stretched)

    @classmethod
    def moulded_dome(
        cls,
        rim_semi_axes_m: tuple[float, float],
        height_m: float,
        mu_h_n_per_m: float,
        prestretch: float,
        gauge_pressure_pa: float,
    ) -> InflatedRubber:
        """A dome, uniformly stretched by λ and inflated to equilibrium."""
        cap = mesh_cap(EllipsoidalCap.of(rim_semi_axes_m, height_m), _NODES)
        stretched = cap, mu_h_n_per_m, prestretch, gauge_pressure_pa
        return cls._on_mesh("dome", rim_semi_axes_m, *stretched)

    @classmethod
    def _on_mesh(
        cls,
        name: str,
        rim: tuple[float, float],
        mesh: MembraneMesh,
        mu_h_n_per_m: float,
        prestretch: float,
        gauge_pressure_pa: float,
    ) -> InflatedRubber:
        rubber = RubberMembrane(mesh, 0.0, prestretch**2 * inverse_metric(mesh), mu_h_n_per_m)
        rest = _inflated(rubber, None, gauge_pressure_pa)
        tension = balance_tension(rest, gauge_pressure_pa)
        shape = partial(_inflated, rubber, rest.nodes)
        return cls(name, rim, gauge_pressure_pa, mu_h_n_per_m, tension, shape, mesh, prestretch)

    def sensor(self, width: int = 160) -> Sensor:
        """Sensor file before identification: rounded height, standard atmospheric pressure."""
        height = float(self.rest.nodes[:, 2].max())
        focal, rows = 0.55 * width, 3 * width // 4
        return Sensor(
            name=self.name,
            membrane=Membrane(
                shape="ellipsoidal_cap",
                rim_semi_axes_m=self.rim_semi_axes_m,
                height_m=round(height, 3),
            ),
            pneumatics=Pneumatics(gauge_pressure_pa=2500.0, chamber_volume_m3=CHAMBER_M3),
            camera=Camera(
                width=width,
                height=rows,
                fx=focal,
                fy=focal,
                cx=0.5 * (width - 1),
                cy=0.5 * (rows - 1),
                position_m=(0.0, 0.0, -1.4 * max(self.rim_semi_axes_m)),
            ),
        )

    def recording(
        self,
        level: float,
        seed: int,
        noise: DepthNoise = CAMERA_NOISE,
        frames: int = 30,
        width: int = 160,
        gas_error_pa: float = 0.0,  # of the instrument
    ) -> HeldFrames:
        """Frames at the gauge pressure at rest times `level`."""
        gauge = level * self.gauge_pressure_pa
        camera = DepthCamera.of(self.sensor(width).camera)
        name, gas = f"{self.name} at {level:g}", ATMOSPHERE_PA + gauge + gas_error_pa
        return HeldFrames(still_frames(camera, self.shape(gauge), gas, noise, frames, seed), name)


def _inflated(rubber: RubberMembrane, near: np.ndarray | None, pressure_pa: float) -> MembraneMesh:
    inflation = Inflation(rubber, np.zeros_like(rubber.mesh.nodes))
    return replace(rubber.mesh, nodes=inflation.at(pressure_pa, near))
