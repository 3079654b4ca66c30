"""Depth images of an ellipsoidal dome by exact ray casting, without a mesh."""

import numpy as np
from scipy.spatial.transform import Rotation

from bubbleviz.camera import DepthCamera, Intrinsics
from bubbleviz.recordings import Frame
from bubbleviz.sensor import Camera, Membrane, Pneumatics, Sensor
from bubbleviz.simulation import DepthNoise

GAUGE = 2585.5


class Dome:
    """Source of contact-free frames of an ellipsoidal cap over the plane z = 0."""

    name = "dome"

    def __init__(self, semi_axes, height, noise, seed, *, scale=0.5, frames=40, tilt_deg=0.0):
        self.semi_axes = np.asarray(semi_axes, float)
        self.height, self.noise, self.seed = height, noise, seed
        self.times_s = np.arange(frames) / 30.0
        turn = Rotation.from_euler("y", tilt_deg, degrees=True)
        back = 0.104 * np.array([-np.sin(np.radians(tilt_deg)), 0.0, -np.cos(np.radians(tilt_deg))])
        drawn = back + np.array([0.002, -0.001, 0.0])  # the drawing is that far off
        self.sensor = Sensor(
            name="dome",
            membrane=Membrane(shape="spherical_cap", rim_radius_m=0.07, height_m=0.045),
            pneumatics=Pneumatics(gauge_pressure_pa=GAUGE, chamber_volume_m3=2e-3),
            camera=Camera(
                width=round(224 * scale),
                height=round(171 * scale),
                fx=186.4 * scale,
                fy=206.4 * scale,
                cx=111.5 * scale,
                cy=85.0 * scale,
                position_m=tuple(drawn),
                quaternion_xyzw=tuple(turn.as_quat()),
            ),
        )
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = turn.as_matrix(), back
        camera = self.sensor.camera
        self.camera = DepthCamera(
            Intrinsics(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy), T
        )
        self.rest = self._cut()

    def _cut(self):
        """Range at which each ray leaves the ellipsoid, (H, W); NaN below the rim plane."""
        centre = np.array([0.0, 0.0, self.height - self.semi_axes[2]])
        o = (self.camera.center - centre) / self.semi_axes
        d = self.camera.directions / self.semi_axes
        a, b, c = np.sum(d * d, axis=1), d @ o, o @ o - 1.0
        with np.errstate(invalid="ignore"):
            t = (-b + np.sqrt(b * b - a * c)) / a
        z = self.camera.center[2] + t * self.camera.directions[:, 2]
        t[~(z > 0.0)] = np.nan
        return t.reshape(self.camera.intrinsics.height, -1)

    def __len__(self):
        return len(self.times_s)

    def __getitem__(self, k):
        depth = self.noise.depth_image(self.camera, self.rest, self.seed, k)
        return Frame(k, self.times_s[k], depth, self.camera.intrinsics)

    def close(self):
        pass


def sphere(seed, noise=DepthNoise(relative=0.01), **more):  # noqa: B008 - frozen
    """The pico flexx sensor's dome: radius 81.25 mm, height 50 mm."""
    return Dome((0.08125,) * 3, 0.05, noise, seed, **more)


def oval(seed, noise, **more):
    return Dome((0.085, 0.066, 0.06), 0.05, noise, seed, tilt_deg=12.0, **more)
