"""Volume of the chamber from a press: the gas law on measured pressure and measured shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from bubbleviz.calibration.rest.pixel_selection import PixelStatistics
from bubbleviz.calibration.robust_statistics import robust_sigma, tukey_weights
from bubbleviz.camera.depth_camera import DepthCamera
from bubbleviz.camera.operators import range_jacobian
from bubbleviz.camera.raycast import RayCaster
from bubbleviz.frames.frame import Frame
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.stiffness import cotangent_laplacian
from bubbleviz.membrane.symmetric_lu import symmetric_lu
from bubbleviz.progress import Progress, quiet

_RELINEARISATIONS = 4  # Gauss–Newton steps; the last ones change nothing


@dataclass(frozen=True)
class ChamberEstimate:
    """Gas volume from a press.

    Attributes
    ----------
    gas_volume_m3 : float
        V0, chamber and cap, m³: median over the frames.
    spread_m3 : float
        Largest minus smallest over the frames, m³.
    volume_change_m3 : (k,) array
        Measured change of the volume under the membrane, m³, negative when pressed in.
    pressure_change_pa : (k,) array
        Measured change of the gas pressure, Pa.
    seen : float
        Share of the membrane's area that the camera sees; the rest is the model's.
    sensitivity_m2 : float
        Error of V0 in m³ per metre by which all ranges change too much: it is large, because
        the volume change is a dent less a bulge of nearly the same volume.
    """

    gas_volume_m3: float
    spread_m3: float
    volume_change_m3: np.ndarray
    pressure_change_pa: np.ndarray
    seen: float
    sensitivity_m2: float

    def chamber_volume_m3(self, cap_volume_m3: float) -> float | None:
        """V0 less the volume under the cap, m³; None where V0 does not even hold the cap."""
        rest = self.gas_volume_m3 - cap_volume_m3
        return rest if rest > 0.0 else None


class MembraneTracker:
    """Displacement of the membrane from a depth frame, contact or not.

    Least squares of the ranges with λ ‖A^½ (A⁻¹ L u − p_v/γ0)‖²: where nothing is seen the
    membrane bulges as the measured gas pressure makes it.

    Parameters
    ----------
    mesh, camera, pixels
        As identified.
    tension_n_per_m : float
        γ0.
    smoothing : float
        λ over the one at which data and prior weigh alike.
    """

    def __init__(
        self,
        mesh: MembraneMesh,
        camera: DepthCamera,
        pixels: PixelStatistics,
        tension_n_per_m: float,
        smoothing: float,
    ) -> None:
        self.mesh, self.camera, self.pixels = mesh, camera, pixels
        self.tension, self.smoothing = tension_n_per_m, smoothing
        self._caster = RayCaster(camera.center, camera.directions, mesh.triangles)
        # Rows of the rim are left out: there the housing, not the gas, balances the tension.
        laplacian = cotangent_laplacian(mesh)[mesh.free][:, mesh.free]
        weighted = laplacian.T @ sparse.diags_array(1.0 / mesh.areas[mesh.free])
        self._prior = (weighted @ laplacian).tocsc()
        self._source = laplacian.T @ np.ones(len(mesh.free))

    @property
    def seen(self) -> float:
        """Share of the membrane's area in triangles that a used pixel's ray hits."""
        used = np.flatnonzero(self.pixels.mask)
        hits = self._caster.cast(self.mesh.nodes, self.mesh.normals, used)
        areas = self.mesh.facet_areas
        return float(areas[np.unique(hits.triangle)].sum() / areas.sum())

    def displacement(self, depth_m: np.ndarray, gas_pressure_change_pa: float) -> np.ndarray:
        """Displacement u along the reference normals, shape (n,), m.

        Parameters
        ----------
        depth_m : (H, W) array
            z-depth, m.
        gas_pressure_change_pa : float
            Measured p_v, Pa.
        """
        measured = self.pixels.corrected(self.camera.range_image(depth_m)).ravel()
        pixels = np.flatnonzero(np.isfinite(measured))
        mesh, u = self.mesh, np.zeros(len(self.mesh.nodes))
        weights = np.ones(measured.size)  # the first round must follow the dent, false or not
        for _ in range(_RELINEARISATIONS):
            hits = self._caster.cast(mesh.deformed(u), mesh.normals, pixels)
            D = range_jacobian(hits, mesh.triangles, len(u))
            target = measured[hits.ray] - hits.range_m + D @ u
            D = D[:, mesh.free]
            weighted = D.multiply(weights[hits.ray][:, None]).tocsr()
            normal = (weighted.T @ D).tocsc()
            weight = self.smoothing * float(normal.diagonal().sum() / self._prior.diagonal().sum())
            right = (
                weighted.T @ target + weight * gas_pressure_change_pa / self.tension * self._source
            )
            u = np.zeros(len(u))
            u[mesh.free] = symmetric_lu((normal + weight * self._prior).tocsc()).solve(right)
            left = target - D @ u[mesh.free]
            weights[hits.ray] = tukey_weights(left, robust_sigma(left))
        return u


def estimate_chamber(
    tracker: MembraneTracker,
    frames: list[Frame],
    rest_pressure_pa: float,
    progress: Progress = quiet,
) -> ChamberEstimate:
    """Gas volume V0 from pressed frames: P0 V0 = P (V0 + ΔV), isothermal.

    Parameters
    ----------
    tracker : MembraneTracker
    frames : list of Frame
        Pressed frames with gas pressure, held still: the gas pressure leads the camera.
    rest_pressure_pa : float
        Absolute gas pressure P0 without contact, Pa.
    """
    rest = tracker.mesh.cap_volume()
    changes, rises = [], []
    for k, frame in enumerate(frames):
        progress("measuring the chamber", 0.5 + 0.5 * k / len(frames))
        if frame.gas_pressure_pa is None:
            continue
        rise = frame.gas_pressure_pa - rest_pressure_pa
        u = tracker.displacement(frame.depth_m, rise)
        changes.append(tracker.mesh.cap_volume(u) - rest)
        rises.append(rise)
    change, pressures = np.array(changes), np.array(rises)
    volumes = -change * (rest_pressure_pa + pressures) / pressures
    return ChamberEstimate(
        gas_volume_m3=float(np.median(volumes)),
        spread_m3=float(np.ptp(volumes)),
        volume_change_m3=change,
        pressure_change_pa=pressures,
        seen=tracker.seen,
        sensitivity_m2=float(
            tracker.mesh.areas.sum() * np.median((rest_pressure_pa + pressures) / pressures)
        ),
    )
