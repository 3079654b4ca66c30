"""A nut turned by 60° on its flat face over 120 frames: followed to the end, and found again.

The simulation decides on each node at a time whether it touches, so that the outline of a flat face
catches on its mesh: it is refined there.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from bubbleviz.membrane.reference_mesh import build_mesh
from bubbleviz.pipeline import Pipeline, Product
from bubbleviz.sensor import Sensor
from bubbleviz.simulation.depth_noise import DepthNoise
from bubbleviz.simulation.synthetic_source import SyntheticSource
from bubbleviz.study.presses import made

FRAMES, TURN_DEG, PITCH_M = 120, 60.0, 1.75e-3
BLANK = range(55, 65)
RECOVERY_FRAMES = 5
LATE = 30
SEEDS = (101, 102, 103, 104, 105)
"""Noise of each run, none of which any constant was chosen on: one alone says more of its noise
than of the tracker."""

_PRODUCTS: frozenset[Product] = frozenset({"pose"})


@dataclass(frozen=True)
class Screw:
    """How the nut was followed.

    Attributes
    ----------
    blanked : bool
        Without returns in the ten frames in the middle.
    seed : int
        Of the noise.
    frames : int
    status : dict
        Number of frames by status.
    recovered_after : int or None
        Frames from the return of the data to the first pose; None when not blanked or never.
    rotation_error_rad_median, rotation_error_rad_max, rotation_error_rad_end : float
        Over the frames that are `ok`, the turn by 60° not divided out.
    rotation_error_rad_late : float
        Largest after the first second, when the velocity is known.
    translation_error_m_max : float
    median_total_ms, p95_total_ms : float
        Depth image in → pose out, from the second frame on.
    """

    blanked: bool
    seed: int
    frames: int
    status: dict[str, int]
    recovered_after: int | None
    rotation_error_rad_median: float
    rotation_error_rad_max: float
    rotation_error_rad_end: float
    rotation_error_rad_late: float
    translation_error_m_max: float
    median_total_ms: float
    p95_total_ms: float


def screw_path(height_m: float, depth_m: float, frames: int) -> np.ndarray:
    """Poses T_B_O (frames, 4, 4) of the nut, its axis 3° off the dome's."""
    share = np.arange(frames) / max(frames - 1, 1)
    turns = Rotation.from_euler("z", (10.0 + TURN_DEG * share)[:, None], degrees=True)
    poses = np.tile(np.eye(4), (frames, 1, 1))
    poses[:, :3, :3] = (Rotation.from_euler("x", 3.0, degrees=True) * turns).as_matrix()
    poses[:, :2, 3] = [0.003, -0.002]
    poses[:, 2, 3] = height_m - depth_m - PITCH_M * TURN_DEG / 360.0 * share
    return poses


def screw_source(sensor: Sensor, nodes: int | None = None) -> SyntheticSource:
    """The nut pressed 13 mm into the dome, at 1 % noise."""
    height = float(build_mesh(sensor).nodes[:, 2].max())
    poses = screw_path(height, 0.013, FRAMES)
    nut, noise = made("hex_nut"), DepthNoise(relative=0.01)
    return SyntheticSource(sensor, nut, poses, noise, nodes=nodes, sharp=True)


def run_screws(
    sensor: Sensor, source: SyntheticSource, seeds: Sequence[int] = SEEDS
) -> list[Screw]:
    """All runs: with noise of every seed, and once more with the frames in the middle blank."""
    runs = [run_screw(sensor, source, seed, blanked=False) for seed in seeds]
    return [*runs, run_screw(sensor, source, seeds[0], blanked=True)]


def run_screw(sensor: Sensor, source: SyntheticSource, seed: int, *, blanked: bool) -> Screw:
    """Follow the nut from its true first pose."""
    source.seed = seed  # what was solved is kept
    pipeline = Pipeline.of(sensor)
    pipeline.follow(source.obj, source.poses[0])
    status, rotation, translation, times = [], [], [], []
    for k in range(len(source)):
        frame = source[k]
        if blanked and k in BLANK:
            frame = replace(frame, depth_m=np.full_like(frame.depth_m, np.nan))
        result = pipeline.process(frame, _PRODUCTS)
        assert result.pose is not None
        status.append(result.pose.status)
        times.append(result.times_ms["total"])
        if result.pose.status == "ok":
            off = result.pose.T_B_O @ np.linalg.inv(source.poses[k])
            rotation.append(float(Rotation.from_matrix(off[:3, :3]).magnitude()))
            way = result.pose.T_B_O[:3, 3] - source.poses[k][:3, 3]
            translation.append(float(np.linalg.norm(way)))
    back = [k - BLANK.stop + 1 for k in range(BLANK.stop, len(status)) if status[k] == "ok"]
    return Screw(
        blanked=blanked,
        seed=seed,
        frames=len(status),
        status=dict(Counter(status)),
        recovered_after=back[0] if blanked and back else None,
        rotation_error_rad_median=float(np.median(rotation)),
        rotation_error_rad_max=max(rotation),
        rotation_error_rad_end=rotation[-1],
        rotation_error_rad_late=max(rotation[LATE:], default=np.nan),
        translation_error_m_max=max(translation),
        median_total_ms=float(np.median(times[1:])),
        p95_total_ms=float(np.percentile(times[1:], 95.0)),
    )
