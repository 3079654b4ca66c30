"""A small sensor and short recordings of a cylinder pressed into it, fast to solve."""

from functools import cache

from bubbleviz.api.simulating import Simulation
from bubbleviz.files import parse_pose
from bubbleviz.recordings import RecordingWriter
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor import changed, load_sensor, sensor_to_toml
from bubbleviz.simulation import DepthNoise, SyntheticSource

HEIGHTS = (0.060, 0.044, 0.042, 0.042, 0.060)
"""Of the cylinder's flat end above the rim: clear of the dome (50 mm), pressed in, and clear."""


def coarser(sensor, times):
    """Values of the sensor's camera with so many times fewer pixels a side."""
    own = sensor.camera
    width, height = own.width // times, round(own.height / times)
    center = {"cx": 0.5 * (width - 1), "cy": 0.5 * (height - 1)}
    return {"width": width, "height": height, "fx": own.fx / times, "fy": own.fy / times, **center}


@cache
def rubber_dome():
    """A rubber dome, seen by a camera of a quarter of the pixels."""
    given = load_sensor("pico_flexx_75mm")
    return changed(given, membrane={"nodes": 400, "prestretch": 1.2}, camera=coarser(given, 2))


def write_small_sensor(path):
    """The pico flexx preset with a coarse mesh and a quarter of the pixels a side."""
    sensor = load_sensor("pico_flexx_75mm")
    small = changed(sensor, membrane={"nodes": 200}, camera=coarser(sensor, 4))
    path.write_text(sensor_to_toml(small), encoding="utf-8")
    return path


class HeldPress(SyntheticSource):
    """A simulation without friction that solves every pose once, however many frames have it."""

    def contact(self, index):
        equal = (self.poses == self.poses[index]).all(axis=(1, 2))
        return super().contact(int(equal.argmax()))


def small_source(sensor, heights=HEIGHTS, seed=0):
    """The presses as a source with ground truth."""
    poses = [parse_pose(f"0.005 0 {height} 0 0 0 1") for height in heights]
    noise = DepthNoise(relative=0.002)
    return HeldPress(load_sensor(sensor), load_object("cylinder"), poses, noise, seed=seed)


def record(path, frames):
    """A recording of frames, or of those of a source."""
    with RecordingWriter(path) as writer:
        for frame in frames:
            writer.write(frame)
    return path


def write_press(path, sensor, heights=HEIGHTS, seed=0):
    """A recording of the presses."""
    Simulation(small_source(sensor, heights, seed)).save(path)
    return path
