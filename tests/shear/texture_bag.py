"""Recordings of a puck that is pressed in and dragged, with JPEG images of a printed membrane."""

from functools import cache

import numpy as np

from bubbleviz.camera import MembraneView
from bubbleviz.sensor import sensor_to_toml
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation import GREY_NOISE, PrintedMembrane
from tests.colour.colour_bag import add_compressed, encoded
from tests.recordings.bagmaker import PERIOD, START, BagMaker
from tests.shear.drag import NOISE, sensor, stuck

PRESS = "puck", 0.004, 0.001, 8.0
FRAMES, TOUCHED, HELD = 40, 30, 35
"""Contact begins, after more than `COLLECTED` images without it, and the hold, in which the
membrane is in equilibrium."""


@cache
def view():
    """The membrane before the camera at rest."""
    return MembraneView(SensorModel.of(sensor()).camera, stuck(*PRESS).mesh)


@cache
def clean(share):
    """Ranges, m, and grey image of the membrane displaced by a share of the press, noise-free."""
    moved_m = share * stuck(*PRESS).displacement_m
    printed = PrintedMembrane(view(), noise=0.0)
    return view().range_image(moved_m), printed.image(moved_m, 0)


@cache
def image(k):
    """Depth, m, and grey image of a frame."""
    share = float(np.clip((k - TOUCHED + 1) / (HELD - TOUCHED), 0.0, 1.0))
    ranges, grey = clean(share)
    depth = NOISE.depth_image(view().camera, ranges, 0, k)
    noise = np.random.default_rng(k).normal(0.0, GREY_NOISE, grey.shape)
    return depth, np.clip(np.rint(grey + noise), 0, 255).astype(np.uint8)


def write_texture_press(folder, changed, lead=0):
    """Recording, whose colour leads by `lead` frames, and sensor file; `changed`: JPEG by frame."""
    bag, own = BagMaker("mcap file"), sensor().camera
    matrix = np.array([own.fx, 0.0, own.cx, 0.0, own.fy, own.cy, 0.0, 0.0, 1.0])
    size = {"k": matrix, "height": own.height, "width": own.width}
    for k in range(FRAMES):
        stamp = START + k * PERIOD
        grey = image(min(k + lead, FRAMES - 1))[1]
        bag.image(stamp, image(k)[0])
        bag.camera_info(stamp, **size)
        jpeg = changed.get(k, encoded(grey, "jpeg"))
        add_compressed(bag, stamp, jpeg, "jpeg")
    file = folder / "dome.toml"
    file.write_text(sensor_to_toml(sensor()), encoding="utf-8")
    return bag.write(folder), file
