"""Random sensor errors: how often a wrong force is neither refused nor warned about.

Each error changes the frames of a recording whose forces are known: of the real press, whose own
estimates count as true, and of simulated presses into two sensors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

import bubbleviz as bv
from bubbleviz.camera import DepthCamera
from bubbleviz.membrane import build_mesh
from bubbleviz.recordings import FROZEN_AFTER, Frame
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor import load_sensor
from bubbleviz.simulation import DepthNoise, touching_height
from bubbleviz.study.harness import Case, Column, Report, Study, Table, at_least, groups

REAL_PRESS = Path(__file__).resolve().parents[2] / "shared/data/punyo_press_a"
"""Recording of the real press; without it the study omits that press."""
_REAL_FRAMES = (10, 20, 30, 40, 50, 66, 70, 74, 80, 86)  # five without contact, loading, hold
_DEPTHS_M = (-0.004, -0.004, -0.004, -0.004, -0.004, 0.002, 0.004, 0.006, 0.008, 0.008)
_NO_CONTACT_N = 0.1
"""Force that may be missed without a warning: about the detection limit of the sensors."""

Change = Callable[[list[Frame]], list[Frame]]
"""Adds an error to the frames of a press; further frames have the last true force."""


@dataclass(frozen=True)
class Press:
    """Frames with their true forces (f, 3), N, and their sensor."""

    sensor: str
    frames: list[Frame]
    force_n: np.ndarray


@dataclass(frozen=True)
class FaultRow:
    """Outcome of the frames of a press with one error.

    Of `frames`, some are `reported` (refused, or the recording has a warning); of the others, the
    interval includes the true force in `covered`. `worst_n` is the largest error of the rest.
    """

    press: str
    kind: str
    size: float
    unit: str
    frames: int
    reported: int
    covered: int
    worst_n: float


def faults_study(errors: int, seed: int, parts: Path | None = None) -> Study:
    """A number of random errors, cycling through kinds and presses."""
    presses = [name for name in _PRESSES if name != "real press" or REAL_PRESS.exists()]
    kinds = list(_KINDS)
    cases = []
    for k in range(errors):
        press, kind = presses[k % len(presses)], kinds[k // len(presses) % len(kinds)]
        cases.append(Case(f"{k} {press}: {kind}", partial(_row, press, kind, seed, k)))
    settings = {"errors": errors, "seed": seed}
    return Study("faults", FaultRow, cases, report_of, settings, parts)


def _row(press_name: str, kind: str, seed: int, number: int) -> list[FaultRow]:
    press, rng = _PRESSES[press_name](), np.random.default_rng([seed, number])
    size, unit, change = _KINDS[kind](press, rng)
    frames = change(press.frames)
    count = len(frames)
    try:
        run = bv.estimate(frames, press.sensor)
    except bv.InputError:
        return [FaultRow(press_name, kind, size, unit, count, count, 0, 0.0)]
    force, status = np.linalg.norm(run.force_n, axis=1), run.status
    half = np.array([found.estimate.force_half_width_n for found in run])
    half = np.where(status == "no_contact", _NO_CONTACT_N, half)
    true = np.linalg.norm(press.force_n, axis=1)
    error = np.abs(force - np.pad(true, (0, count - len(true)), "edge"))
    reported = ~np.isin(status, ("ok", "no_contact")) | bool(run.context["warning"])
    covered = ~reported & (error <= half)
    worst = float(error[~reported & ~covered].max(initial=0.0))
    counts = count, int(reported.sum()), int(covered.sum())
    return [FaultRow(press_name, kind, size, unit, *counts, worst)]


# Presses.


@cache
def _real_press() -> Press:
    sensor, recording = "punyo_oval_d405", bv.open(REAL_PRESS)
    frames = [recording[k] for k in _REAL_FRAMES]
    return Press(sensor, frames, bv.estimate(frames, sensor).force_n)


@cache
def _simulated(sensor_name: str, place_m: tuple[float, float], noise: DepthNoise) -> Press:
    """A ball that approaches the membrane of a sensor, slowly at first."""
    sensor, ball = load_sensor(sensor_name), load_object("sphere")
    mesh, pose = build_mesh(sensor), np.eye(4)
    pose[:2, 3] = place_m
    top = touching_height(ball, pose, mesh)
    poses = np.tile(pose, (len(_DEPTHS_M), 1, 1))
    poses[:, 2, 3] = top - np.array(_DEPTHS_M)
    simulation = bv.simulate(
        sensor,
        ball,
        poses,
        noise_sigma_m=noise.absolute_m,
        noise_relative=noise.relative,
        noise_correlation_px=noise.correlation_px,
    )
    force = [simulation.truth(k).force_n for k in range(len(poses))]
    return Press(sensor_name, [simulation[k] for k in range(len(poses))], np.array(force))


_PRESSES: dict[str, Callable[[], Press]] = {
    "real press": _real_press,
    "rubber oval": partial(
        _simulated,
        "punyo_oval_d405",
        (0.02, 0.005),
        DepthNoise(absolute_m=5e-5, correlation_px=4.0),
    ),
    "flat pico": partial(_simulated, "pico_flexx_75mm", (0.01, 0.005), DepthNoise(relative=0.01)),
}


# Errors. Each kind draws a random size in its unit and returns a change of the frames.


def _pressure(press: Press, rng: np.random.Generator) -> tuple[float, str, Change]:
    shift = rng.uniform(-3e3, 3e3)
    change = _each(lambda f: replace(f, gas_pressure_pa=_plus(f.gas_pressure_pa, shift)))
    return shift, "Pa", change


def _offset(press: Press, rng: np.random.Generator) -> tuple[float, str, Change]:
    off = rng.uniform(-1e-3, 1e-3)
    return off, "m", _of_depth(lambda depth, _: depth + np.float32(off))


def _drift(press: Press, rng: np.random.Generator) -> tuple[float, str, Change]:
    off, last = rng.uniform(-1e-3, 1e-3), len(press.frames) - 1
    return off, "m", _of_depth(lambda depth, k: depth + np.float32(off * k / last))


def _scale(press: Press, rng: np.random.Generator) -> tuple[float, str, Change]:
    by = rng.uniform(-0.02, 0.02)
    return by, "", _of_depth(lambda depth, _: depth * np.float32(1.0 + by))


def _focal_length(press: Press, rng: np.random.Generator) -> tuple[float, str, Change]:
    by = rng.uniform(-0.05, 0.05)

    def change(frame: Frame) -> Frame:
        own = frame.intrinsics or DepthCamera.of(load_sensor(press.sensor).camera).intrinsics
        other = replace(own, fx=(1.0 + by) * own.fx, fy=(1.0 + by) * own.fy)
        return replace(frame, intrinsics=other)

    return by, "", _each(change)


def _moved(press: Press, rng: np.random.Generator) -> tuple[float, str, Change]:
    """The image that a camera moved across its axis would see."""
    distance, angle = rng.uniform(0.0, 2e-3), rng.uniform(0.0, 2.0 * np.pi)
    aside = distance * np.array([np.sin(angle), np.cos(angle)])[:, None, None]  # down, right
    own = press.frames[0].intrinsics or DepthCamera.of(load_sensor(press.sensor).camera).intrinsics
    focal = np.array([own.fy, own.fx])[:, None, None]

    def seen(depth: np.ndarray, _: int) -> np.ndarray:
        known = np.where(np.isfinite(depth) & (depth > 0.0), depth, np.nan)
        pixels, there = np.indices(depth.shape), np.full(depth.shape, np.nanmedian(known))
        for _ in range(8):  # fixed point: where a pixel's point was seen depends on its depth
            places = pixels + focal * aside / there
            found = map_coordinates(known, places, order=1, cval=np.nan)
            there = np.where(np.isfinite(found), found, there)
        return found

    return distance, "m", _of_depth(seen)


def _turned(press: Press, rng: np.random.Generator) -> tuple[float, str, Change]:
    ways: tuple[tuple[int, int], ...] = ((-1, -1), (-1, 1), (1, -1))
    down, right = ways[rng.integers(len(ways))]
    return (
        float(2 * (down < 0) + (right < 0)),
        "",
        _of_depth(lambda depth, _: depth[::down, ::right]),
    )


def _hole(press: Press, rng: np.random.Generator) -> tuple[float, str, Change]:
    """Pixels without return around one near the contact."""
    radius = float(np.exp(rng.uniform(np.log(4.0), np.log(100.0))))
    scale = press.frames[0].depth_m.shape[1] / 640.0
    row, column = _dent(press) + rng.normal(0.0, 20.0 * scale, 2)
    rows, columns = np.indices(press.frames[0].depth_m.shape)
    hole = np.hypot(rows - row, columns - column) < radius * scale
    return radius, "px of 640", _of_depth(lambda depth, _: np.where(hole, np.nan, depth))


def _bad_pixels(press: Press, rng: np.random.Generator) -> tuple[float, str, Change]:
    count = int(np.exp(rng.uniform(0.0, np.log(1000.0))))
    shape = press.frames[0].depth_m.shape
    where = rng.integers(shape[0], size=count), rng.integers(shape[1], size=count)
    values = np.exp(rng.uniform(np.log(1e-3), np.log(50.0), count)).astype(np.float32)

    def change(depth: np.ndarray, _: int) -> np.ndarray:
        depth[where] = values
        return depth

    return float(count), "pixels", _of_depth(change)


def _frozen(press: Press, rng: np.random.Generator) -> tuple[float, str, Change]:
    """A camera that repeats one of the images from then on, with new stamps."""
    stop = int(rng.integers(len(press.frames)))

    def change(frames: list[Frame]) -> list[Frame]:
        longer = [*frames, *FROZEN_AFTER * [frames[-1]]]
        return [*frames[:stop], *(replace(f, depth_m=frames[stop].depth_m) for f in longer[stop:])]

    return float(stop), "frames before", change


_KINDS: dict[str, Callable[[Press, np.random.Generator], tuple[float, str, Change]]] = {
    "gas pressure": _pressure,
    "offset": _offset,
    "growing offset": _drift,
    "scale": _scale,
    "focal length": _focal_length,
    "moved camera": _moved,
    "turned or mirrored": _turned,
    "hole": _hole,
    "bad pixels": _bad_pixels,
    "frozen": _frozen,
}


def _plus(pressure_pa: float | None, shift_pa: float) -> float | None:
    return None if pressure_pa is None else pressure_pa + shift_pa


def _each(change: Callable[[Frame], Frame]) -> Change:
    return lambda frames: [change(frame) for frame in frames]


def _of_depth(change: Callable[[np.ndarray, int], np.ndarray]) -> Change:
    """A change of each image (H, W) by its number."""
    return lambda frames: [
        replace(f, depth_m=np.ascontiguousarray(change(f.depth_m.copy(), k), np.float32))
        for k, f in enumerate(frames)
    ]


def _dent(press: Press) -> np.ndarray:
    """Pixel (row, column) of the deepest dent in the last frame."""
    dent = np.nan_to_num(press.frames[0].depth_m - press.frames[-1].depth_m)
    smooth = gaussian_filter(dent, 0.01 * dent.shape[1])
    return np.array(np.unravel_index(np.argmax(smooth), dent.shape), float)


_COLUMNS = (
    *(Column(name, name) for name in ("press", "kind", "frames")),
    *(Column(f"{name} %", name, ".0f", 100.0) for name in ("reported", "covered")),
    Column("wrong %", "wrong", ".1f", 100.0),
    Column("worst N", "worst_n", ".2f"),
)


def report_of(rows: Sequence[FaultRow]) -> Report:
    """Shares of the frames of each kind of error on each press."""
    records = [
        _record(kind, press, own) for (kind, press), own in groups(rows, "kind", "press").items()
    ]
    everything = _record("all", "", rows)
    right = 1.0 - everything["wrong"]
    targets = [at_least("refused, warned of or inside the interval", right, 0.97)]
    return Report([Table("faults", [*records, everything], _COLUMNS)], targets, rows=rows)


def _record(kind: str, press: str, rows: Sequence[FaultRow]) -> dict[str, Any]:
    frames = sum(row.frames for row in rows)
    reported = sum(row.reported for row in rows) / frames
    covered = sum(row.covered for row in rows) / frames
    worst = max((row.worst_n for row in rows), default=0.0)
    return {
        **{"kind": kind, "press": press, "frames": frames},
        **{"reported": reported, "covered": covered},
        **{"wrong": 1.0 - reported - covered, "worst_n": worst},
    }
