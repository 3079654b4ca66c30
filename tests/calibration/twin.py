"""Synthetic twin of the real press: an oval, tilted, imperfect dome seen by a noisy camera."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from bubbleviz.camera import DepthCamera, Intrinsics, RayCaster
from bubbleviz.membrane import EllipsoidalCap, MembraneMesh, mesh_cap
from bubbleviz.recordings import Frame
from bubbleviz.sensor import Camera, Membrane, Pneumatics, Sensor

ATMOSPHERE, GAUGE = 101_325.0, 5_000.0
RISE = 400.0
"""Of the gas pressure by the press, Pa."""
QUANTUM = 1e-4
RIM, HEIGHT, VERTICAL = (0.0557, 0.0396), 0.0305, 0.0437
FREE, PRESSED = 30, 15
TILT = Rotation.from_euler("y", 25.0, degrees=True)


@dataclass
class Twin:
    """A source of frames with its ground truth."""

    name: str
    times_s: np.ndarray
    depth: np.ndarray
    pressures: list[float | None]
    intrinsics: Intrinsics
    camera: DepthCamera
    truth: MembraneMesh
    false_returns: np.ndarray
    rim_biased: np.ndarray

    def __len__(self):
        return len(self.depth)

    def __getitem__(self, k):
        return Frame(k, self.times_s[k], self.depth[k], self.intrinsics, self.pressures[k])

    def close(self):
        pass


def nominal_sensor(gauge=GAUGE):
    """Sensor as drawn; the true camera is displaced by 1.3 mm."""
    return Sensor(
        name="twin",
        membrane=Membrane(shape="ellipsoidal_cap", rim_semi_axes_m=RIM, height_m=HEIGHT),
        pneumatics=Pneumatics(gauge_pressure_pa=gauge, chamber_volume_m3=2e-4),
        camera=Camera(
            width=10,
            height=10,
            fx=1.0,
            fy=1.0,
            cx=0.0,
            cy=0.0,
            position_m=(-0.0401, 0.0005, -0.054),
            quaternion_xyzw=tuple(TILT.as_quat()),
        ),
    )


def make_twin(seed=0, pressure=True, noise_seed=None, frames=FREE + PRESSED):
    """Frames of 160×120 pixels: FREE without contact, then a press that grows to a constant depth.

    The same seed with another `noise_seed` gives another recording of the same sensor.
    """
    rng = np.random.default_rng(seed)
    truth, camera = true_dome()
    rest = pressed(0.0)
    rows, columns = np.indices(rest.shape)
    near_rim = np.isfinite(rest) & (columns > 150)
    false = ((rows - 8) ** 2 + (columns - 8) ** 2 < 36) & ~np.isfinite(rest)
    static = 2e-4 * gaussian_filter(rng.standard_normal(rest.shape), 2.0) / 0.14
    holes = rng.random(rest.shape) < 0.03
    if noise_seed is not None:
        rng = np.random.default_rng(noise_seed)
    noise = np.zeros(rest.shape)
    depth, pressures = [], []
    for k in range(frames):
        press = float(np.clip((k - FREE + 1) / 8.0, 0.0, 1.0))
        fresh = gaussian_filter(rng.standard_normal(rest.shape), 1.0) / 0.28
        noise = 0.6 * noise + 0.8 * fresh
        image = pressed(press) + static * 0.5 + 5e-5 * noise + 1.5e-3 * near_rim
        image = np.where(false, 0.11 + 1e-3 * rng.standard_normal(rest.shape), image)
        outlier = rng.random(rest.shape) < 0.02
        image = np.where(outlier, image + 0.01, image)
        image[holes | (rng.random(rest.shape) < 0.01)] = np.nan
        z = camera.depth_image(image)
        depth.append((np.rint(z / QUANTUM) * QUANTUM).astype(np.float32))
        gas = ATMOSPHERE + GAUGE + RISE * press + 5.0 * rng.standard_normal()
        pressures.append(gas if pressure else None)
    return Twin(
        "twin", np.arange(len(depth)) / 30.0, np.stack(depth), pressures, camera.intrinsics, camera,
        truth, false, near_rim,
    )  # fmt: skip


@cache
def true_dome():
    """The membrane and its camera."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = TILT.as_matrix(), (-0.0391, -0.0003, -0.054)
    camera = DepthCamera(Intrinsics(160, 120, 107.4, 107.2, 78.4, 61.9), T)
    return bumpy(mesh_cap(EllipsoidalCap.of(RIM, HEIGHT, VERTICAL), 4000)), camera


@cache
def pressed(share):
    """Ranges without noise at a share of the press."""
    truth, camera = true_dome()
    dent = -np.exp(-np.sum((truth.nodes[:, :2] - (0.0, 0.008)) ** 2, axis=1) / 0.008**2)
    return cast(truth, camera, 5e-3 * share * dent)


def bumpy(mesh):
    """The dome with a broad, non-ellipsoidal deviation of 0.8 mm that vanishes at the rim."""
    x, y, z = mesh.nodes.T
    bulge = 8e-4 * np.cos(np.pi * x / 0.04) * np.cos(np.pi * y / 0.04) * (z / HEIGHT)
    return MembraneMesh(mesh.deformed(bulge), mesh.triangles, mesh.rim)


def cast(mesh, camera, displacement):
    caster = RayCaster(camera.center, camera.directions, mesh.triangles)
    hits = caster.cast(mesh.deformed(displacement))
    image = np.full((camera.intrinsics.height, camera.intrinsics.width), np.nan)
    image.ravel()[hits.ray] = hits.range_m
    return image


def residuals_and_bias(found, frames):
    """Measured minus modelled range (F, k) of the pixels in use, and the bias (k,) of each, m."""
    used = found.pixels.mask
    per_depth, model = found.model.camera.range_per_depth[used], found.modelled_range_m[used]
    residual = np.stack([frame.depth_m[used] * per_depth - model for frame in frames])
    return residual, found.pixels.bias_m[used]
