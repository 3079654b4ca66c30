"""From contact-free frames to a sensor: surface, pixels, tension, chamber.

The rim belongs to the housing: its plane is the one of the given sensor's camera pose (from the
drawing), in which only the centre is moved to the fitted dome's. What the cloud's edge says
about its height is reported beside it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from bubbleviz.calibration.chamber import ChamberEstimate, MembraneTracker, estimate_chamber
from bubbleviz.calibration.contact_free import find_contact_free
from bubbleviz.calibration.depth_statistics import DepthStatistics, measure_depth
from bubbleviz.calibration.free_form import FreeForm, fit_free_form
from bubbleviz.calibration.pixels import PixelStatistics, select_pixels
from bubbleviz.calibration.rim import rim_height
from bubbleviz.calibration.segment import away_from_edges, membrane_pixels, outer_edge
from bubbleviz.calibration.surface_fit import SurfaceFit, fit_ellipsoid, fit_sphere
from bubbleviz.calibration.tension import balance_tension
from bubbleviz.camera.depth_camera import DepthCamera
from bubbleviz.errors import InputError
from bubbleviz.frames.frame import Frame
from bubbleviz.frames.source import FrameSource
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.surface import EllipsoidalCap, mesh_cap
from bubbleviz.sensor import Camera, Sensor

_TILE_LENGTHS = 10  # correlation lengths to a tile's side: its middle is news to its neighbours
_SCALE = 0.5  # of the rim's smaller semi-axis: what is broader is the cap's business
_PRESSED_FRAMES = 10  # for the chamber


@dataclass(frozen=True)
class Fits:
    """The analytic surfaces, in the frame B of the identified sensor.

    Attributes
    ----------
    sphere, cap, ellipsoid : SurfaceFit
        Sphere; ellipsoid with semi-axes along B; ellipsoid with its tilt free.
    rim_height_m, rim_height_sigma_m : float
        Height of the rim above z = 0 by the cloud's edge, and its uncertainty, m.
    """

    sphere: SurfaceFit
    cap: SurfaceFit
    ellipsoid: SurfaceFit
    rim_height_m: float
    rim_height_sigma_m: float


@dataclass(frozen=True)
class Identification:
    """A sensor as its own contact-free frames describe it.

    Attributes
    ----------
    sensor : Sensor
        With shape "mesh"; its files do not exist before `write_sensor`.
    mesh : MembraneMesh
        Free-form reference surface in B.
    pixels : PixelStatistics
    statistics : DepthStatistics
    contact_free : range
        Frames used.
    fits : Fits
    surface : FreeForm
    tension_n_per_m : float
        γ0 by Young–Laplace over the free-form surface.
    chamber : ChamberEstimate or None
        None where the source has no press with gas pressure.
    source_name : str
    """

    sensor: Sensor
    mesh: MembraneMesh
    pixels: PixelStatistics
    statistics: DepthStatistics
    contact_free: range
    fits: Fits
    surface: FreeForm
    tension_n_per_m: float
    chamber: ChamberEstimate | None
    source_name: str

    @property
    def camera(self) -> DepthCamera:
        """The camera in B."""
        return DepthCamera.of(self.sensor.camera)

    @property
    def modelled_range_m(self) -> np.ndarray:
        """Range of the rays cast on the reference surface, (H, W), m; NaN where they miss."""
        return self.statistics.range_m - self.surface.residual_m


def identify(
    source: FrameSource,
    sensor: Sensor,
    contact_free: range | None = None,
    *,
    nodes: int = 1000,
) -> Identification:
    """Identify a sensor from contact-free frames.

    Parameters
    ----------
    source : FrameSource
        Recording that starts without contact. A press later in it, with gas pressure, gives the
        chamber's volume.
    sensor : Sensor
        Name, camera pose (its rim plane and axes are kept), gauge pressure, chamber volume; what
        the recording tells better (intrinsics, gas pressure) is taken from there.
    contact_free : range, optional
        Frames to use; found by themselves where not given.
    nodes : int
        Target number of nodes of the mesh.

    Raises
    ------
    InputError
        Too few contact-free frames, frames of another camera, or no dome in them.
    """
    chosen = find_contact_free(source).frames if contact_free is None else contact_free
    if len(chosen) and not 0 <= min(chosen) <= max(chosen) < len(source):
        raise InputError(
            f"{source.name}: contact-free frames {chosen.start}:{chosen.stop} are outside its"
            f" {len(source)} frames; name others"
        )
    frames = [source[k] for k in chosen]
    if not frames:
        raise InputError(f"{source.name}: no contact-free frames; name at least 5")
    camera = DepthCamera.of(sensor.camera, frames[0].intrinsics)
    statistics = measure_depth(frames, camera.range_per_depth)
    membrane, usable = _membrane(statistics, camera)
    fits, camera = _fit_surfaces(statistics, camera, membrane, usable)
    start = mesh_cap(_cap_over_rim(fits.cap), nodes)
    surface = fit_free_form(
        start,
        camera,
        statistics.range_m,
        usable,
        scale_m=_SCALE * float(np.abs(start.nodes[start.rim, :2]).max(axis=0).min()),
        tile_px=max(2, round(_TILE_LENGTHS * statistics.correlation_length_px)),
    )
    pixels = select_pixels(statistics, membrane, surface.residual_m)
    pneumatics = sensor.pneumatics
    rest = _rest_pressure(frames)
    if rest is not None:
        gauge = rest - pneumatics.atmospheric_pressure_pa
        if gauge <= 0.0:
            raise InputError(
                f"{source.name}: gas pressure {rest:.0f} Pa is not above the atmospheric"
                f" {pneumatics.atmospheric_pressure_pa:.0f} Pa; correct the latter, or inflate"
            )
        pneumatics = pneumatics.model_copy(update={"gauge_pressure_pa": round(gauge, 1)})
    tension = balance_tension(surface.mesh, pneumatics.gauge_pressure_pa)
    tracker = MembraneTracker(surface.mesh, camera, pixels, tension, surface.smoothing)
    chamber = _chamber(source, chosen, tracker, rest)
    measured = chamber.chamber_volume_m3(surface.mesh.cap_volume()) if chamber else None
    volume = pneumatics.chamber_volume_m3 if measured is None else measured
    pneumatics = pneumatics.model_copy(
        update={"chamber_volume_m3": float(f"{volume:.3g}"), "tension_n_per_m": round(tension, 2)}
    )
    return Identification(
        sensor=sensor.model_copy(
            update={
                "membrane": sensor.membrane.model_copy(
                    update={"shape": "mesh", "mesh_file": "membrane.ply", "height_m": None}
                    | {"rim_radius_m": None, "rim_semi_axes_m": None, "nodes": len(start.nodes)}
                ),
                "pneumatics": pneumatics,
                "camera": _camera_section(sensor.camera, camera, statistics, pixels),
                "calibration": None,
            }
        ),
        mesh=surface.mesh,
        pixels=pixels,
        statistics=statistics,
        contact_free=chosen,
        fits=fits,
        surface=surface,
        tension_n_per_m=tension,
        chamber=chamber,
        source_name=source.name,
    )


def _points(statistics: DepthStatistics, camera: DepthCamera, use: np.ndarray) -> np.ndarray:
    """Points in B of the pixels in use (H, W), shape (k, 3), m."""
    pixels = np.flatnonzero(use)
    return camera.center + statistics.range_m.ravel()[pixels, None] * camera.directions[pixels]


def _membrane(
    statistics: DepthStatistics, camera: DepthCamera, min_validity: float = 0.9
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels that see the membrane, and those of them far enough from its edges, (H, W) bool."""
    known = statistics.validity >= min_validity
    points = _points(statistics, camera, known)
    rough = fit_ellipsoid(points, np.eye(3)).ellipsoid
    distance = np.full(known.shape, np.nan)
    distance[known] = rough.distance(points)
    membrane = membrane_pixels(distance, known)
    return membrane, away_from_edges(membrane, statistics.correlation_length_px)


def _fit_surfaces(
    statistics: DepthStatistics, camera: DepthCamera, membrane: np.ndarray, usable: np.ndarray
) -> tuple[Fits, DepthCamera]:
    """Analytic surfaces, and the camera in B with its origin below the fitted dome's centre."""
    cap = fit_ellipsoid(_points(statistics, camera, usable), np.eye(3))
    T_B_C = camera.T_B_C.copy()
    T_B_C[:2, 3] -= cap.ellipsoid.centre_m[:2]
    moved = DepthCamera(camera.intrinsics, T_B_C)
    points = _points(statistics, moved, usable)
    centre = cap.ellipsoid.centre_m * (0.0, 0.0, 1.0)
    edge = _points(statistics, moved, outer_edge(membrane))
    height, sigma = rim_height(edge[:, 2])
    fits = Fits(
        sphere=fit_sphere(points),
        cap=replace(cap, ellipsoid=replace(cap.ellipsoid, centre_m=centre)),
        ellipsoid=fit_ellipsoid(points),
        rim_height_m=height,
        rim_height_sigma_m=sigma,
    )
    return fits, moved


def _cap_over_rim(fit: SurfaceFit) -> EllipsoidalCap:
    """The part of the fitted ellipsoid above the rim plane z = 0."""
    ax, ay, c = (float(x) for x in fit.ellipsoid.semi_axes_m)
    sunk = float(fit.ellipsoid.centre_m[2]) / c
    if not -1.0 < sunk < 1.0:
        raise InputError(
            "contact-free cloud: the fitted dome does not reach the rim plane z = 0; correct"
            " camera.position_m in the sensor file"
        )
    at_rim = float(np.sqrt(1.0 - sunk**2))
    return EllipsoidalCap.of((ax * at_rim, ay * at_rim), c * (1.0 + sunk), c)


def _rest_pressure(frames: Iterable[Frame]) -> float | None:
    """Median absolute gas pressure in Pa; None where frames lack it."""
    values = [f.gas_pressure_pa for f in frames if f.gas_pressure_pa is not None]
    return float(np.median(values)) if values else None


def _chamber(
    source: FrameSource, free: range, tracker: MembraneTracker, rest: float | None
) -> ChamberEstimate | None:
    """Chamber from the frames after `free` in which the gas pressure holds near its largest."""
    later = [source[k] for k in range(max(free) + 1, len(source))]
    rises = np.array([np.nan if f.gas_pressure_pa is None else f.gas_pressure_pa for f in later])
    if rest is None or not len(later) or not np.isfinite(rises).any():
        return None
    noise = np.std([source[k].gas_pressure_pa or rest for k in free])
    rises = rises - rest
    top = float(np.nanmax(rises))
    if top < 10.0 * noise:  # no press, or one too light to measure a tenth of
        return None
    held = np.flatnonzero(rises > 0.9 * top)
    picked = held[np.unique(np.linspace(0, len(held) - 1, _PRESSED_FRAMES).astype(int))]
    return estimate_chamber(tracker, [later[k] for k in picked], rest)


def _camera_section(
    section: Camera, camera: DepthCamera, statistics: DepthStatistics, pixels: PixelStatistics
) -> Camera:
    own = camera.intrinsics
    relative = np.median(statistics.noise_m[pixels.mask] / statistics.range_m[pixels.mask])
    return section.model_copy(
        update={
            "width": own.width,
            "height": own.height,
            "fx": own.fx,
            "fy": own.fy,
            "cx": own.cx,
            "cy": own.cy,
            "distortion_model": own.distortion_model,
            "distortion": tuple(own.distortion),
            "position_m": tuple(round(float(x), 6) for x in camera.T_B_C[:3, 3]),
            "noise_relative": float(f"{relative:.3g}"),
        }
    )
