"""An independent estimate of γ0: the one whose predicted force fits a measured press.

The frame of a force/torque sensor is rarely documented, so magnitudes are compared. One part of the
press chooses γ0, another one says how well it predicts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bubbleviz.errors import InputError
from bubbleviz.frames.frame import Frame
from bubbleviz.frames.frame_source import FrameSource
from bubbleviz.pipeline import Pipeline
from bubbleviz.progress import Progress, quiet
from bubbleviz.sensor_model import SensorModel

_FACTORS = (0.5, 0.75, 1.0, 1.4, 2.0)  # of the sensor's γ0


@dataclass(frozen=True)
class WrenchTension:
    """γ0 by force.

    Attributes
    ----------
    tension_n_per_m : float
        γ0 that predicts the force of the chosen frames best, N/m.
    at_limit : bool
        It lies at an end of what was tried: the force cannot be explained by γ0.
    fitted_rms_n, tested_rms_n : float
        Rms error of |F| on the frames it was chosen by, and on those it was not, N.
    given_rms_n : float
        The same on the latter with the γ0 it started from, N.
    measured_n, predicted_n : (T,) array
        |F| of the frames not chosen, N.
    """

    tension_n_per_m: float
    at_limit: bool
    fitted_rms_n: float
    tested_rms_n: float
    given_rms_n: float
    measured_n: np.ndarray
    predicted_n: np.ndarray


def tension_by_wrench(
    source: FrameSource,
    model: SensorModel,
    contact_free: Sequence[int],
    fit: Sequence[int],
    test: Sequence[int],
    progress: Progress = quiet,
) -> WrenchTension:
    """Estimate γ0 from frames `fit` of a press and test it on frames `test`.

    Parameters
    ----------
    source : FrameSource
        With wrenches.
    model : SensorModel
        As calibrated; its γ0 is the start.
    contact_free : sequence of int
        Frames whose mean wrench is the bias.
    fit, test : sequence of int
        Pressed frames, held still or slow (wrench, gas and depth lag one another); no frame in
        both.

    Raises
    ------
    InputError
        No wrench, no frames, or a frame in both parts.
    """
    if not len(fit) or not len(test) or set(fit) & set(test):
        raise InputError(f"{source.name}: γ0 by wrench: give frames to fit and others to test")
    bias = np.mean([_force(source, source[k]) for k in contact_free], axis=0)
    frames = [source[k] for k in (*fit, *test)]
    measured = np.array([np.linalg.norm(_force(source, f) - bias) for f in frames])
    start = model.tension_n_per_m
    tensions = start * np.array(_FACTORS)
    predicted = np.empty((len(tensions), len(frames)))
    for k, tension in enumerate(tensions):
        predicted[k] = _predicted(model.with_tension(float(tension)), frames)
        progress("γ0 by wrench", (k + 1) / len(tensions))
    # A γ0 at which the picture contradicts the measured gas pressure is ruled out already.
    possible = np.all(np.isfinite(predicted), axis=1)
    if np.count_nonzero(possible) < 2:
        raise InputError(
            f"{source.name}: γ0 by wrench: no γ0 explains these frames; choose other frames"
        )
    tensions, predicted = tensions[possible], predicted[possible]
    fine = np.linspace(tensions[0], tensions[-1], 1001)
    # Cubes would overshoot: the force is nearly linear in γ0, piece by piece.
    curves = np.stack([np.interp(fine, tensions, column) for column in predicted.T], axis=1)
    chosen, tested = np.arange(len(frames)) < len(fit), np.arange(len(frames)) >= len(fit)
    costs = np.sum((curves - measured)[:, chosen] ** 2, axis=1)
    best = int(np.argmin(costs))
    given = np.array([np.interp(start, tensions, column) for column in predicted.T])
    return WrenchTension(
        tension_n_per_m=float(fine[best]),
        at_limit=best in (0, len(fine) - 1),
        fitted_rms_n=_rms((curves[best] - measured)[chosen]),
        tested_rms_n=_rms((curves[best] - measured)[tested]),
        given_rms_n=_rms((given - measured)[tested]),
        measured_n=measured[tested],
        predicted_n=curves[best][tested],
    )


def press_halves(
    source: FrameSource, contact_free: Sequence[int], count: int = 8
) -> tuple[list[int], list[int]] | None:
    """Frames of the press after the contact-free ones: an earlier half and a later one.

    None where there is no wrench, or no press that stands out of its noise tenfold.

    Parameters
    ----------
    source : FrameSource
    contact_free : sequence of int
    count : int
        Frames to pick from both halves together.
    """
    if any(source[k].wrench is None for k in (contact_free[0], len(source) - 1)):
        return None
    rest = np.array([_force(source, source[k]) for k in contact_free])
    later = np.arange(max(contact_free) + 1, len(source))
    if not len(later):
        return None
    force = np.array([_force(source, source[int(k)]) for k in later]) - rest.mean(axis=0)
    size = np.linalg.norm(force, axis=1)
    noise = float(np.linalg.norm(rest.std(axis=0)))
    pressed = later[size > 0.5 * size.max()]
    if size.max() <= 10.0 * noise or len(pressed) < 2:
        return None
    picked = pressed[np.unique(np.linspace(0, len(pressed) - 1, count).astype(int))]
    middle = len(picked) // 2
    return [int(k) for k in picked[:middle]], [int(k) for k in picked[middle:]]


def _force(source: FrameSource, frame: Frame) -> np.ndarray:
    if frame.wrench is None:
        raise InputError(f"{source.name}: frame {frame.index} has no wrench; record one")
    return frame.wrench[:3]


def _predicted(model: SensorModel, frames: list[Frame]) -> np.ndarray:
    """|F| of every frame, N; 0 without contact, NaN where the frame is refused."""
    pipeline = Pipeline(model)
    forces = []
    for frame in frames:
        # With a measured gas pressure the force is mostly that pressure times the membrane's area,
        # whatever γ0 is: only the gas law lets γ0 show in it.
        unmeasured = replace(frame, gas_pressure_pa=None)
        result = pipeline.process(unmeasured, frozenset({"patch"}))
        known = result.estimate is not None and result.estimate.status in ("ok", "no_contact")
        force = 0.0 if result.patch is None else float(np.linalg.norm(result.patch.force_n))
        forces.append(force if known else np.nan)
    return np.array(forces)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
