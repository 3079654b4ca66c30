"""Small sensors and fast sources for window tests."""

import time
from dataclasses import replace
from threading import Event

import numpy as np

from bubbleviz.camera import ColourCamera, ColourImage, DepthCamera, EncodedImage, MembraneView
from bubbleviz.errors import InputError
from bubbleviz.membrane import build_mesh
from bubbleviz.recordings import Frame
from bubbleviz.sensor import Camera, Membrane, Pneumatics, Sensor
from tests.small_press import record as record

FIRST_CONTACT = 4
FRAMES = 12


def small_sensor(name="small dome", nodes=200, prestretch=None):
    """Dome of 75 mm radius with a camera of 80×60 pixels; of rubber if prestretched."""
    return Sensor(
        name=name,
        membrane=Membrane(rim_radius_m=0.075, height_m=0.050, nodes=nodes, prestretch=prestretch),
        pneumatics=Pneumatics(gauge_pressure_pa=2585.5, chamber_volume_m3=2.2e-3),
        camera=Camera(
            width=80, height=60, fx=46.0, fy=38.0, cx=39.5, cy=29.5,
            position_m=(0.0, 0.0, -0.104), noise_relative=0.001,
        ),
    )  # fmt: skip


class DentSource:
    """Dome with an off-centre dent that grows frame by frame, after contact-free frames."""

    def __init__(self, sensor, *, broken_from=None, slow_s=0.0, centre_m=(0.02, 0.0)):
        self.name = "dent"
        self.times_s = np.arange(FRAMES) / 30.0
        self.closed = False
        self.reads = 0
        self._broken_from, self._slow_s = broken_from, slow_s
        self._camera = DepthCamera.of(sensor.camera)
        mesh = build_mesh(sensor)
        self._view = MembraneView(self._camera, mesh)
        away = np.linalg.norm(mesh.nodes[:, :2] - centre_m, axis=1)
        self._dent = -np.exp(-((away / 0.015) ** 2)) * ~mesh.rim

    def __len__(self):
        return len(self.times_s)

    def __iter__(self):
        return (self[k] for k in range(len(self)))

    def __getitem__(self, index):
        if self._broken_from is not None and index >= self._broken_from:
            raise InputError(f"dent: frame {index} cannot be read; the recording is damaged")
        self.reads += 1
        time.sleep(self._slow_s)
        depth = 2e-3 * max(index - FIRST_CONTACT + 1, 0)
        ranges = self._view.range_image(depth * self._dent)
        along = self._camera.directions.reshape(*ranges.shape, 3) @ self._camera.T_B_C[:3, 2]
        return Frame(index, float(self.times_s[index]), (ranges * along).astype(np.float32))

    def close(self):
        self.closed = True


class HeldSource(DentSource):
    """Frames after the first are read while `released` is set; `read` notes which are."""

    def __init__(self, sensor, **dent):
        super().__init__(sensor, **dent)
        self.released, self.read = Event(), []

    def __getitem__(self, index):
        if index > 0:
            self.released.wait()
        self.read.append(index)
        return super().__getitem__(index)


class GappySource(DentSource):
    """The dent, with three frames missing after the fifth."""

    def __init__(self, sensor):
        super().__init__(sensor)
        self.times_s = self.times_s + 0.1 * (np.arange(FRAMES) > 5)


class ColouredSource(DentSource):
    """The dent with what an aligned colour camera sees: red on the left, green on the right.

    Its first frame has no colour image, the last a damaged one; `decoded` counts what was read.
    """

    def __init__(self, sensor):
        super().__init__(sensor)
        self.decoded = 0
        height, width = self._camera.intrinsics.height, self._camera.intrinsics.width
        rgb = np.zeros((height, width, 3), np.uint8)
        rgb[:, : width // 2, 0] = rgb[:, width // 2 :, 1] = 220
        self.rgb = rgb

    def __getitem__(self, index):
        frame = super().__getitem__(index)
        return replace(frame, find_colour=lambda _: self._colour(index) if index else None)

    def _colour(self, index):
        def read():
            self.decoded += 1
            if index == FRAMES - 1:
                return EncodedImage("jpeg", b"no picture")
            height, width = self.rgb.shape[:2]
            return EncodedImage("rgb8", self.rgb.tobytes(), width, height, 3 * width)

        return ColourImage(read, camera=ColourCamera(self._camera.intrinsics))


class SpeckledSource(DentSource):
    """Contact-free membrane with a printed texture, 25 frames.

    Those of frames `halved` are half as wide and high; no camera info is known without `info`.
    """

    def __init__(self, sensor, *, halved=frozenset(), info=True, **dent):
        super().__init__(sensor, **dent)
        self._halved, self._info = halved, info
        self.times_s = np.arange(25) / 30.0
        self.decoded = 0
        height, width = self._camera.intrinsics.height, self._camera.intrinsics.width
        coarse = np.random.default_rng(3).integers(40, 210, (height // 3 + 1, width // 3 + 1))
        self._speckles = np.kron(coarse, np.ones((3, 3)))[:height, :width]

    def __getitem__(self, index):
        frame = super().__getitem__(0)
        noise = np.random.default_rng(index)
        depth = frame.depth_m * (1.0 + 1e-3 * noise.standard_normal(frame.depth_m.shape))
        grey = (self._speckles + noise.normal(0.0, 2.0, self._speckles.shape)).astype(np.uint8)
        grey = np.ascontiguousarray(grey[::2, ::2]) if index in self._halved else grey

        def read():
            self.decoded += 1
            height, width = grey.shape
            return EncodedImage("mono8", grey.tobytes(), width, height, width)

        time_s = float(self.times_s[index])
        camera = ColourCamera(self._camera.intrinsics if self._info else None, remark="no pose")
        colour = ColourImage(read, time_s=time_s, camera=camera)
        return replace(
            frame,
            index=index,
            time_s=time_s,
            depth_m=depth.astype(np.float32),
            find_colour=lambda _: colour,
        )
