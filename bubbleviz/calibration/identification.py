"""A sensor as its own contact-free frames describe it, and what would make that worthless."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import ndimage

from bubbleviz.calibration.contact_free import held_frames, settled
from bubbleviz.calibration.free_form import FreeForm
from bubbleviz.calibration.material import RubberEstimate, Vented, estimate_rubber
from bubbleviz.calibration.rest_frames import PixelStatistics, Samples, collect
from bubbleviz.calibration.segmentation import away_from_edges
from bubbleviz.calibration.surface import (
    Ellipsoid,
    Fits,
    Surfaces,
    cap_over_rim,
    mesh_ellipsoid,
)
from bubbleviz.calibration.tension import Quantity, TensionEstimate
from bubbleviz.camera import DepthCamera
from bubbleviz.errors import InputError
from bubbleviz.membrane import MembraneMesh
from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import MIN_FRAMES, DepthStatistics, FrameSource, robust_sigma
from bubbleviz.sensor import (
    ATMOSPHERES,
    LEAST_NOISE,
    WEATHER_SIGMA_PA,
    Camera,
    Membrane,
    Pneumatics,
    Sensor,
)
from bubbleviz.sensor_model import SensorModel

# Validity checks of an identification; each error says what is wrong and what to do.


_LEAST_SEEN = 0.5  # of the dome's area; chosen: the rest is the fit's continuation
_SIGNIFICANT = 6.0  # standard deviations of a tile
_LEAST_PIXELS = 20  # in a dent that counts; chosen: smaller ones are false returns
_DEEP = 1e-2  # of the dome's radius: what is shallower is the dome's own shape


def seen_share(
    mesh: MembraneMesh,  # the fitted dome over the rim plane, in B
    camera: DepthCamera,
    membrane: np.ndarray,  # (H, W) bool, pixels that see the membrane; holes in it count as seen
) -> float:
    """Share of a dome's area that the camera sees."""
    centres = mesh.nodes[mesh.triangles].mean(axis=1)
    T = camera.T_B_C
    uv = np.rint(camera.intrinsics.project((centres - T[:3, 3]) @ T[:3, :3])).astype(int)
    height, width = membrane.shape
    inside = ((uv >= 0) & (uv < (width, height))).all(axis=1)
    filled = ndimage.binary_fill_holes(_closed(membrane))
    seen = np.zeros(len(uv), bool)
    seen[inside] = filled[uv[inside, 1], uv[inside, 0]]
    return float(mesh.facet_areas[seen].sum() / mesh.facet_areas.sum())


def check_seen(name: str, share: float) -> None:
    """Refuse a dome of which less than half is seen."""
    if share < _LEAST_SEEN:
        raise InputError(
            f"{name}: only {100 * share:.0f} % of the dome is seen: the shape of the rest, the"
            " volume under it and so γ0 cannot be known; uncover the camera, or give the sensor"
            " file of this camera's pose"
        )


def check_no_dent(
    name: str,
    # (H, W), distance of the measured from the fitted surface, m, negative inside; NaN: none
    residual_m: np.ndarray,
    membrane: np.ndarray,  # (H, W) bool
    # how far from the membrane's outer edge, in pixels, a measurement can be trusted
    edge_px: float,
    pixel_m: np.ndarray,  # (H, W), side of a pixel on the membrane, m
    dome: Ellipsoid,
) -> None:
    """Refuse a dome that is pressed in: contact in every frame, as far as it can be told.

    A patch of the surface that lies deep inside the cap that fits the rest, so deep for its
    width that the membrane has lost half of its curvature there, is a contact: gas pressure
    alone makes a membrane bulge everywhere.
    """
    inner = away_from_edges(ndimage.binary_fill_holes(_closed(membrane)), edge_px + 1.0)
    seen = inner & np.isfinite(residual_m)
    known = seen & membrane
    spread = robust_sigma(residual_m[known])
    radius = float(np.prod(dome.semi_axes_m) ** (1.0 / 3.0))
    below = np.nan_to_num(residual_m) < -_SIGNIFICANT * spread
    known |= _dents_apart(seen & ~membrane, -residual_m)
    deep = known & below
    # Most of a pixel's neighbours: single pixels err, and holes must not tear a patch apart.
    share = ndimage.uniform_filter(deep.astype(float), 5)
    deep = share > 0.5 * np.maximum(ndimage.uniform_filter(known.astype(float), 5), 1e-9)
    labels, count = ndimage.label(deep)
    for k in range(1, count + 1):
        whole = labels == k
        patch = whole & known
        if np.count_nonzero(patch) < _LEAST_PIXELS:
            continue
        area = (
            float(np.sum(pixel_m[patch] ** 2)) * np.count_nonzero(whole) / np.count_nonzero(patch)
        )
        depth = float(np.quantile(-residual_m[patch], 0.95))
        flattened = area / np.pi / (4.0 * radius)  # r²/(4 R): half of the curvature is gone
        if depth > max(flattened, _DEEP * radius):
            row, column = (round(float(x)) for x in ndimage.center_of_mass(patch))
            raise InputError(
                f"{name}: the membrane is pressed in by {1e3 * depth:.1f} mm around pixel"
                f" ({column}, {row}) in all of the frames; take the object away, or name"
                " contact-free frames"
            )


def _dents_apart(apart: np.ndarray, depth_m: np.ndarray) -> np.ndarray:
    """Pixels (H, W) of dents whose flanks are so steep that a step separates them.

    A dent gets deeper from its edge to its middle, and most of its variance is told by that;
    a false return is as far off at its edge.
    """
    pieces, count = ndimage.label(_closed(apart))
    dents = np.zeros_like(apart)
    for k in range(1, count + 1):
        whole = pieces == k
        piece = whole & apart
        if np.count_nonzero(piece) < _LEAST_PIXELS:
            continue
        inwards, depth = ndimage.distance_transform_edt(whole)[piece], depth_m[piece]
        if np.corrcoef(inwards, depth)[0, 1] > np.sqrt(0.5):
            dents |= piece
    return dents


def _closed(region: np.ndarray) -> np.ndarray:
    """Morphological closing of a region; pixels beyond the image border repeat its edge."""
    padded = np.pad(region, 3, mode="edge")
    closed: np.ndarray = ndimage.binary_closing(padded, iterations=2)[3:-3, 3:-3]
    return closed


_SEEN_NODES = 2_000  # of a mesh to tell what the camera sees; chosen: some 2 mm


@dataclass(frozen=True)
class Identification:
    """A sensor as its own contact-free frames describe it."""

    # of shape "spherical_cap" where the sphere was chosen, else "mesh", whose files do not exist
    # before `write_sensor`
    sensor: Sensor
    given: Sensor  # the sensor file it started from
    samples: Samples
    surfaces: Surfaces
    pixels: PixelStatistics
    tension: TensionEstimate
    seen: float  # share of the dome's area that the camera sees
    wander_m: float  # how far the dome moves over the frames beyond noise, m
    # where inflation levels, a press or the open chamber told of gauge pressure and rubber
    rubber: RubberEstimate | None = None

    @property
    def mesh(self) -> MembraneMesh:
        """Reference surface in B."""
        return self.surfaces.mesh

    @property
    def fits(self) -> Fits:
        """The analytic surfaces."""
        return self.surfaces.fits

    @property
    def surface(self) -> FreeForm:
        """The free-form surface."""
        return self.surfaces.free_form

    @property
    def statistics(self) -> DepthStatistics:
        """Of every pixel."""
        return self.samples.statistics

    @property
    def tension_n_per_m(self) -> float:
        """γ0, N/m."""
        return self.tension.tension.value

    @property
    def gauge(self) -> Quantity | None:
        """Gauge pressure, Pa, whose interval γ0's holds; None where nothing tells how well."""
        if self.rubber is not None and self.rubber.gauge is not None:
            return self.rubber.gauge
        pneumatics = self.sensor.pneumatics
        sigma = pneumatics.gauge_sigma_pa
        return None if sigma is None else Quantity.normal(pneumatics.gauge_pressure_pa, sigma)

    @property
    def gauge_rests_on(self) -> str:
        """What the gauge pressure comes from, in words."""
        return "the sensor file" if self.rubber is None else self.rubber.gauge_rests_on

    @property
    def source_name(self) -> str:
        """Name of the recording."""
        return self.samples.source_name

    @cached_property
    def model(self) -> SensorModel:
        """The identified sensor as it would be loaded from its files."""
        return SensorModel(self.sensor, DepthCamera.of(self.sensor.camera), self.mesh, self.pixels)

    @property
    def camera(self) -> DepthCamera:
        """The camera in B."""
        return self.model.camera

    @property
    def modelled_range_m(self) -> np.ndarray:
        """Range of the rays cast on the reference surface, (H, W), m; NaN where they miss."""
        return self.statistics.range_m - self.surfaces.residual_m


def rest_gauge_pressure(samples: Samples, sensor: Sensor) -> float:
    """Gauge pressure of the contact-free frames, Pa.

    The sensor file's where that says how well it is known, or no gas pressure was recorded; else
    the recorded one less the sensor file's atmospheric pressure.
    """
    pneumatics = sensor.pneumatics
    if samples.gas_pressure_pa is None:
        return pneumatics.gauge_pressure_pa
    rest = float(np.median(samples.gas_pressure_pa))
    if pneumatics.gauge_sigma_pa is not None:
        gauge = pneumatics.gauge_pressure_pa
        if not ATMOSPHERES[0] <= rest - gauge <= ATMOSPHERES[1]:
            raise InputError(
                f"{samples.source_name}: gas pressure {rest:.0f} Pa less the sensor file's gauge"
                f" pressure {gauge:.0f} Pa is no atmospheric pressure; record the absolute one, or"
                " correct the sensor file"
            )
        return gauge
    gauge = rest - pneumatics.atmospheric_pressure_pa
    if gauge <= 0.0:
        raise InputError(
            f"{samples.source_name}: gas pressure {rest:.0f} Pa is not above the atmospheric"
            f" {pneumatics.atmospheric_pressure_pa:.0f} Pa; correct the latter, or inflate"
        )
    return gauge


def rest_gauge_sigma(samples: Samples, sensor: Sensor) -> float | None:
    """Standard deviation of `rest_gauge_pressure`, Pa; None where nothing tells it.

    An absolute pressure leaves the weather's. So does a sensor file that says how well its gauge
    pressure is known where the recorded pressure is another one than its: either the weather
    changed since, or the inflation, and nothing tells which.
    """
    pneumatics = sensor.pneumatics
    told = pneumatics.gauge_sigma_pa
    if samples.gas_pressure_pa is None:
        return told
    if told is None:
        return WEATHER_SIGMA_PA
    moved = float(np.median(samples.gas_pressure_pa)) - pneumatics.reference_pressure_pa
    return float(np.hypot(told, min(abs(moved), WEATHER_SIGMA_PA)))


def check_dome(samples: Samples, surfaces: Surfaces) -> float:
    """Refuse a dome pressed in or half unseen; share of it that is seen."""
    name, cap, camera = samples.source_name, surfaces.fits.cap, surfaces.camera
    seen = seen_share(mesh_ellipsoid(cap, _SEEN_NODES), camera, surfaces.membrane)
    check_seen(name, seen)
    ranges = samples.statistics.range_m
    points = camera.center + ranges[..., None] * camera.directions.reshape(*ranges.shape, 3)
    residual = cap.distance(points.reshape(-1, 3)).reshape(ranges.shape)
    pixel_m = ranges / np.sqrt(camera.intrinsics.fx * camera.intrinsics.fy)
    reach = samples.statistics.correlation_length_px
    check_no_dent(name, residual, surfaces.membrane, reach, pixel_m, cap)
    return seen


def collect_press(
    source: FrameSource, found: Identification, progress: Progress = quiet
) -> Samples | None:
    """Frames of a later press that is held and whose gas pressure is known; None without one."""
    frames = settled(held_frames(source, found.samples, progress))
    return collect(source, found.given, frames, progress) if len(frames) >= MIN_FRAMES else None


def assemble(
    sensor: Sensor,
    samples: Samples,
    surfaces: Surfaces,
    pixels: PixelStatistics,
    tension: TensionEstimate,
    seen: float,
    wander_m: float,
) -> Identification:
    """Put what the steps found into a sensor."""
    sigma = rest_gauge_sigma(samples, sensor)
    pneumatics = sensor.pneumatics.model_copy(update=_pressures(samples, tension, sigma))
    update = {
        "membrane": _membrane_section(surfaces, sensor.membrane.prestretch),
        "pneumatics": Pneumatics.model_validate(pneumatics.model_dump()),
        "camera": _camera_section(sensor.camera, surfaces.camera, samples.statistics, pixels),
        "calibration": None,
    }
    return Identification(
        sensor=sensor.model_copy(update=update),
        given=sensor,
        samples=samples,
        surfaces=surfaces,
        pixels=pixels,
        tension=tension,
        seen=seen,
        wander_m=wander_m,
    )


def _pressures(
    samples: Samples, tension: TensionEstimate, gauge_sigma_pa: float | None
) -> dict[str, float | None]:
    """Pressures and γ0 of the sensor file; the recorded gas pressure is that of its rest."""
    gauge = tension.gauge_pressure_pa
    values = {
        "gauge_pressure_pa": round(gauge, 1),
        "gauge_sigma_pa": None if gauge_sigma_pa is None else round(gauge_sigma_pa, 1),
        "tension_n_per_m": round(tension.tension.value, 3),
    }
    if samples.gas_pressure_pa is not None:
        absolute = float(np.median(samples.gas_pressure_pa))
        values["atmospheric_pressure_pa"] = round(absolute - gauge, 1)
    return values


def with_rubber(
    # from a sensor with the open chamber's atmospheric pressure, where that is given
    found: Identification,
    levels: Sequence[Samples],  # of the untouched sensor at other pressures
    vented: Vented | None = None,
    held: Samples | None = None,  # of a press, which is asked where there are no levels
    # standard deviation of a gas pressure beside that of another recording, Pa; a usual sensor's
    level_sigma_pa: float | None = None,
) -> Identification:
    """Identification with λ, and the gauge pressure, as levels, a press and open chamber tell.

    Raises InputError: an open chamber was recorded, but not the gas pressure of the inflated
    sensor.
    """
    known = rest_gauge_sigma(found.samples, found.given)
    other = found.surfaces.other_mesh
    where = found.model, found.samples, found.tension
    rubber = estimate_rubber(
        *where, levels, vented, held,
        gauge_sigma_pa=known, level_sigma_pa=level_sigma_pa, other_mesh=other,
    )  # fmt: skip
    if rubber is None:
        return found
    tension, sensor, section = found.tension, found.sensor, {}
    if rubber.gauge is not None:
        tension = tension.under(rubber.gauge)
        section = _pressures(found.samples, tension, rubber.gauge.sigma)
    membrane = sensor.membrane
    if rubber.prestretch is not None:
        stretch = {"prestretch": round(rubber.prestretch.value, 4)}
        membrane = membrane.model_copy(update=stretch)
    pneumatics = sensor.pneumatics.model_copy(update=section)
    update = {"membrane": membrane, "pneumatics": pneumatics}
    return replace(found, sensor=sensor.model_copy(update=update), tension=tension, rubber=rubber)


def _membrane_section(surfaces: Surfaces, prestretch: float | None) -> Membrane:
    if surfaces.chosen != "sphere":
        nodes = len(surfaces.mesh.nodes)
        file = "membrane.ply"
        return Membrane(shape="mesh", mesh_file=file, nodes=nodes, prestretch=prestretch)
    cap = cap_over_rim(surfaces.fits.sphere)
    return Membrane(
        shape="spherical_cap",
        rim_radius_m=round(cap.rim_semi_axes_m[0], 7),
        height_m=round(cap.height_m, 7),
        prestretch=prestretch,
        nodes=len(surfaces.mesh.nodes),
    )


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
            "noise_relative": max(float(f"{relative:.3g}"), LEAST_NOISE),
        }
    )
