"""Frames for an identification, their statistics per pixel, and the choice of usable pixels."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse.csgraph import connected_components

from bubbleviz.camera import DepthCamera, PixelModel
from bubbleviz.errors import InputError, check_type
from bubbleviz.membrane import build_mesh
from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import (
    MIN_FRAMES,
    DepthStatistics,
    FrameSource,
    check_unit,
    measure_depth,
    robust_sigma,
    upper_fence,
)
from bubbleviz.sensor import Sensor
from bubbleviz.wording import count_of

MAX_FRAMES = 150  # of more frames, evenly spaced ones are used: the rest only cost memory

_TRACED_PIXELS = 5_000  # of each frame: noise of 0.1 mm then moves a fitted sphere by some 4 µm


@dataclass(frozen=True)
class FrameSamples:
    """Frames of one camera with the membrane at rest or in one steady press, without images."""

    source_name: str
    frames: tuple[int, ...]  # indices in the recording
    last_depth_m: np.ndarray  # (H, W) float32, z-depth of the last frame, m; NaN: no return
    traced_depth_m: np.ndarray  # (F, k) float32, that of `traced_pixels` in every frame, m
    gas_pressure_pa: np.ndarray | None  # (F,), absolute; None where a frame lacks it
    camera: DepthCamera  # at the sensor file's pose in B, with the recording's intrinsics
    rim_m: np.ndarray  # (r, 3), points of the sensor file's rim in B, m
    statistics: DepthStatistics


def traced_pixels(statistics: DepthStatistics) -> tuple[np.ndarray, int]:
    """Evenly spread pixels (k,) of those that return as often as usual, and their stride."""
    regular = np.flatnonzero(statistics.validity >= statistics.regular_validity)
    stride = max(1, len(regular) // _TRACED_PIXELS)
    return regular[::stride], stride


def collect(
    source: FrameSource,
    # gives the camera pose, the distance of the membrane, and intrinsics if the recording has none
    sensor: Sensor,
    chosen: Sequence[int],  # indices of contact-free frames
    progress: Progress = quiet,
) -> FrameSamples:
    """Read the chosen frames and compute statistics of every pixel over them.

    Raises InputError: fewer than 5 frames, frames of another camera, no returns, or depth in a
    wrong unit.
    """
    if len(chosen) and not 0 <= min(chosen) <= max(chosen) < len(source):
        raise InputError(
            f"{source.name}: contact-free frames {min(chosen)}:{max(chosen) + 1} are not within its"
            f" {count_of(len(source), 'frame')}; choose within 0:{len(source)}"
        )
    if len(chosen) < MIN_FRAMES:
        raise InputError(
            f"{source.name}: only {count_of(len(chosen), 'contact-free frame')}; choose or record "
            f"at least {MIN_FRAMES}"
        )
    chosen = list(chosen)[:: -(-len(chosen) // MAX_FRAMES)]
    pressures: list[float | None] = []
    for number, k in enumerate(chosen):
        frame = source[k]
        if number == 0:
            depth = np.empty((len(chosen), *frame.depth_m.shape), np.float32)
            camera, mesh = DepthCamera.of(sensor.camera, frame.intrinsics), build_mesh(sensor)
            rest_m = camera.local(mesh.nodes)[:, 2]
            remedy = "record 16UC1 in millimetres or 32FC1 in metres"
            check_unit(f"{source.name}: depth", frame.depth_m, rest_m, remedy)
        if frame.depth_m.shape != depth.shape[1:]:
            raise InputError(
                f"{source.name}: frame {k} has another image size than frame {chosen[0]}; record "
                "with one resolution"
            )
        depth[number] = frame.depth_m
        pressures.append(frame.gas_pressure_pa)
        progress("reading frames", (number + 1) / len(chosen))
    progress("measuring pixels", 0.0)
    statistics = measure_depth(depth, camera.range_per_depth)
    gas = np.array(pressures, float)  # NaN: not measured
    return FrameSamples(
        source_name=source.name,
        frames=tuple(chosen),
        last_depth_m=depth[-1].copy(),
        traced_depth_m=depth.reshape(len(depth), -1)[:, traced_pixels(statistics)[0]],
        gas_pressure_pa=gas if np.isfinite(gas).all() else None,
        camera=camera,
        rim_m=mesh.nodes[mesh.rim],
        statistics=statistics,
    )


# Pixel selection: which pixels to use, with the bias and noise of each.


_SAMPLE_SCALE = 3.0  # robust standard deviations: 1 in 370 of a normal population lies outside


def select_pixels(
    statistics: DepthStatistics,  # of the contact-free frames
    membrane: np.ndarray,  # (H, W) bool, pixels that see the membrane (`membrane_pixels`)
    # (H, W), measured minus modelled range, m; NaN where the ray misses the model
    residual_m: np.ndarray,
    # share of the frames in which a pixel must have a return; None: 0.9 of the typical share
    min_validity: float | None = None,
    # robust standard deviations beyond which a pixel is `unstable` or `biased`
    deviations: float = _SAMPLE_SCALE,
) -> PixelModel:
    """Choose the pixels to use, and estimate the bias of each.

    Reasons to exclude a pixel, in this order: `never_valid` and `rarely_valid` (returns in fewer
    than `min_validity` of the frames), `false_return` (not part of the membrane), `outside_rim`
    (its ray misses the membrane), `edge` (its matching window extends past the membrane's edge or
    into a hole), `unstable` (σ is an outlier among the pixels) and `biased` (its distance from the
    surface is an outlier, as by glare or near the rim).
    """
    if min_validity is None:
        min_validity = statistics.regular_validity
    validity, sigma = statistics.validity, statistics.noise_m
    inner = away_from_edges(membrane, 0.5 * statistics.correlation_length_px)
    typical = membrane & np.isfinite(residual_m)
    fence = upper_fence(statistics.scatter_m[typical], deviations)
    # A pixel between two steps of the depth scatters by half a step, more in few correlated frames.
    fence = np.hypot(fence, statistics.quantum_m)
    middle = float(np.median(residual_m[typical])) if typical.any() else 0.0
    spread = robust_sigma(residual_m[typical])
    # Comparisons with NaN are false: pixels without residual have an earlier reason.
    with np.errstate(invalid="ignore"):
        reasons = {
            "never_valid": validity <= 0.0,
            "rarely_valid": validity < min_validity,
            "false_return": ~membrane,
            "outside_rim": ~np.isfinite(residual_m),
            "edge": ~inner,
            "unstable": ~(statistics.scatter_m <= fence),
            "biased": np.abs(residual_m - middle) > deviations * spread,
        }
    mask = np.ones(validity.shape, bool)
    removed = {}
    for name, out in reasons.items():
        removed[name] = int(np.count_nonzero(mask & out))
        mask &= ~out
    return PixelModel(
        mask=mask,
        bias_m=np.where(mask, residual_m, 0.0).astype(np.float32),
        noise_m=np.where(mask, sigma, np.inf).astype(np.float32),
        removed=removed,
        correlated_pixels=statistics.correlated_pixels,
    )


# Sets of frames as ranges.


Ranges = tuple[tuple[int, int], ...]
"""First frame and the one after the last of each range; sorted, disjoint, none empty."""


def frame_numbers(ranges: Ranges) -> list[int]:
    return [k for start, stop in ranges for k in range(start, stop)]


def as_ranges(frames: Iterable[int]) -> Ranges:
    every = set(frames)
    for each in every:
        check_type("frame", each, int, np.integer)
    starts = sorted(k for k in every if k - 1 not in every)
    stops = sorted(k + 1 for k in every if k + 1 not in every)
    return tuple(zip(starts, stops, strict=True))


# Pixels that see the membrane: the largest part of the cloud without steps in depth.


_STEP_SIGMA = 6.0  # standard deviations beyond which differences of neighbours are steps


def membrane_pixels(
    distance_m: np.ndarray,  # (H, W), distance of each pixel's point from the fitted cap, m
    known: np.ndarray,  # (H, W) bool, pixels with returns in enough frames
) -> np.ndarray:
    """Pixels of the largest connected part of the measured surface, (H, W) bool.

    A step in the distance from the fitted cap separates neighbours, as at the edges of false
    returns and of the housing behind the rim.
    """
    index = np.arange(known.size).reshape(known.shape)
    pairs = []
    for a, b in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:, :], np.s_[:-1, :])):
        both = known[a] & known[b]
        step = np.abs(distance_m[a] - distance_m[b])[both]
        pairs.append((index[a][both], index[b][both], step))
    first, second, steps = (np.concatenate(part) for part in zip(*pairs, strict=True))
    together = steps <= _STEP_SIGMA * max(robust_sigma(steps, center=0.0), 1e-9)
    graph = sparse.coo_array(
        (np.ones(int(together.sum()), bool), (first[together], second[together])),
        shape=(known.size, known.size),
    )
    labels = connected_components(graph, directed=False)[1]
    sizes = np.bincount(labels[known.ravel()])
    return (labels == np.argmax(sizes)).reshape(known.shape) & known


def away_from_edges(region: np.ndarray, distance_px: float) -> np.ndarray:
    """Pixels of a region (H, W) further than a distance from its edges.

    The image's border does not count as an edge: the surface continues beyond it.
    """
    inside = ndimage.distance_transform_edt(np.pad(region, 1, mode="edge"))[1:-1, 1:-1]
    return region & (inside > distance_px)


def outer_edge(region: np.ndarray) -> np.ndarray:
    """Pixels (H, W) on the outer edge of a region, without edges of holes and image border."""
    filled = ndimage.binary_fill_holes(region)
    return region & filled & ~ndimage.binary_erosion(filled, border_value=1)
