"""Recordings of a puck that is pressed in and dragged, with JPEG images of a printed membrane."""

from functools import cache

import numpy as np

from bubbleviz.camera import MembraneView
from bubbleviz.sensor import sensor_to_toml
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation import PrintedMembrane, Speckle
from tests.colour.colour_bag import add_compressed, encoded
from tests.recordings.bagmaker import PERIOD, START, BagMaker
from tests.shear.drag import NOISE, sensor, stuck

FRAMES, TOUCHED, HELD = 60, 30, 40
"""Contact begins and the hold, in which the membrane is in equilibrium."""


@cache
def images():
    """Depth, m, and grey image of every frame."""
    truth, camera = stuck("puck", 0.004, 0.001, 8.0), SensorModel.of(sensor()).camera
    view = MembraneView(camera, truth.mesh)
    printed = PrintedMembrane(Speckle(), view)
    found = []
    for k in range(FRAMES):
        share = np.clip((k - TOUCHED + 1) / (HELD - TOUCHED), 0.0, 1.0)
        moved = share * truth.displacement_m
        ranges = NOISE.apply(view.range_image(moved), 0, k)
        found.append((camera.depth_image(ranges).astype(np.float32), printed.image(moved, k)))
    return found


def write_texture_press(folder, changed, lead=0):
    """Recording, whose colour leads by `lead` frames, and sensor file; `changed`: JPEG by frame."""
    bag, own = BagMaker("mcap file"), sensor().camera
    matrix = np.array([own.fx, 0.0, own.cx, 0.0, own.fy, own.cy, 0.0, 0.0, 1.0])
    size = {"k": matrix, "height": own.height, "width": own.width}
    for k, (depth, _) in enumerate(images()):
        stamp = START + k * PERIOD
        grey = images()[min(k + lead, FRAMES - 1)][1]
        bag.image(stamp, depth)
        bag.camera_info(stamp, **size)
        jpeg = changed.get(k, encoded(grey, "jpeg"))
        add_compressed(bag, stamp, jpeg, "jpeg")
    file = folder / "dome.toml"
    file.write_text(sensor_to_toml(sensor()), encoding="utf-8")
    return bag.write(folder), file
