"""Depth images of membranes that another solver computed, as a sensor would record them.

The positions are those of `../shared/data/rubber_truth`, or any other (F, n, 3) over one mesh.
"""

from pathlib import Path

import numpy as np
import pytest

from bubbleviz.camera import DepthCamera, MembraneView
from bubbleviz.membrane import MembraneMesh
from bubbleviz.recordings import Frame, HeldFrames
from bubbleviz.sensor import Camera, Membrane, Pneumatics, Sensor

FOLDER = Path(__file__).parents[2] / "shared" / "data" / "rubber_truth"
GAUGE_PA, ATMOSPHERE_PA = 5_258.0, 101_325.0
GAS_NOISE_PA = 2.0


def rubber_truth(name: str) -> dict[str, np.ndarray]:
    """Arrays of `name`.npz, in float64; skips the test where this machine does not have it."""
    path = FOLDER / f"{name}.npz"
    if not path.is_file():
        pytest.skip(f"{path.name} of rubber_truth is not on this machine")
    with np.load(path) as data:
        arrays = {key: data[key] for key in data.files}
    single = {key: each for key, each in arrays.items() if each.dtype == np.float32}
    return arrays | {key: each.astype(np.float64) for key, each in single.items()}


def camera_of(width: int = 320, focal_px: float = 215.0, z_m: float = -0.052) -> Camera:
    """A 4:3 camera on the axis that looks along +z."""
    height = 3 * width // 4
    return Camera(
        width=width,
        height=height,
        fx=focal_px,
        fy=focal_px,
        cx=0.5 * (width - 1),
        cy=0.5 * (height - 1),
        position_m=(0.0, 0.0, z_m),
    )


def dome_sensor(
    camera: Camera | None = None,
    gauge_pa: float = GAUGE_PA,
    atmosphere_pa: float = ATMOSPHERE_PA,
    chamber_m3: float = 2e-4,
) -> Sensor:
    """Sensor of `rubber_truth` as drawn, with true gauge and atmospheric pressure."""
    return Sensor(
        name="moulded dome",
        membrane=Membrane(shape="spherical_cap", rim_radius_m=0.045, height_m=0.029),
        pneumatics=Pneumatics(
            gauge_pressure_pa=gauge_pa,
            atmospheric_pressure_pa=atmosphere_pa,
            chamber_volume_m3=chamber_m3,
        ),
        camera=camera or camera_of(),
    )


def render(
    name: str,
    camera: Camera,
    nodes_m: np.ndarray,
    triangles: np.ndarray,
    gauge_pa: np.ndarray | float | None,
    *,
    noise_m: float = 1e-4,
    gas_noise_pa: float = GAS_NOISE_PA,
    atmosphere_pa: float = ATMOSPHERE_PA,
    seed: int = 0,
) -> HeldFrames:
    """Frames of shapes (F, n, 3) at 30 Hz, with white noise of its own in each.

    `gauge_pa` of each frame, (F,), or of all; None where no gas pressure is recorded.
    """
    lens, frames = DepthCamera.of(camera), []
    images: dict[bytes, np.ndarray] = {}  # frames of one shape are cast once
    gas_pa: list[float | None] = [None] * len(nodes_m)
    if gauge_pa is not None:
        shaken = np.random.default_rng([seed, 1 << 20]).standard_normal(len(nodes_m))
        gauge_pa = np.broadcast_to(gauge_pa, len(nodes_m))
        gas_pa = (atmosphere_pa + gauge_pa + gas_noise_pa * shaken).tolist()
    for k, (nodes, gas) in enumerate(zip(nodes_m, gas_pa, strict=True)):
        key = nodes.tobytes()
        if key not in images:
            mesh = MembraneMesh(nodes, triangles, np.zeros(len(nodes), bool))
            ranges = MembraneView(lens, mesh).range_image(np.zeros(len(nodes)))
            images[key] = lens.depth_image(ranges)
        noise = np.random.default_rng([seed, k]).standard_normal(images[key].shape)
        depth = (images[key] + noise_m * noise).astype(np.float32)
        frames.append(Frame(k, k / 30.0, depth, lens.intrinsics, gas))
    return HeldFrames(frames, name)


def at_rest(shape_m: np.ndarray, frames: int = 30) -> np.ndarray:
    """So many frames of one shape (n, 3), (F, n, 3)."""
    return np.repeat(shape_m[None], frames, axis=0)
