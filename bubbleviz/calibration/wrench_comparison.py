"""Estimated force against that of a wrench sensor: bias, gain, rotation, delay and hysteresis.

estimate(t) = gain · R (measured(t − delay) − bias) by least squares. Errors of neighbouring frames
are alike, so intervals are by a jackknife that leaves out whole presses, or blocks of time where
there are too few of them, with everything fitted again. A delay and hysteresis look much alike:
intervals hold the answer of a model without hysteresis, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import stdtrit

from bubbleviz.errors import InputError
from bubbleviz.recordings import MIN_FRAMES, SIGNIFICANT, mean_inflation, robust_sigma

_DELAYS_S = np.linspace(-0.3, 0.3, 121)  # of depth filters of some ten frames at most
_APART = 5  # contact-free frames between two presses; fewer are a failed image
_LEAST = 5  # presses from which they are the clusters, and blocks of time at least
_ROUNDS = 4  # of rotation, then gain and hysteresis
_TURNS = 4  # of delay, then where the force rises and falls
_OPEN_RAD = 0.5 * np.pi  # half-width from which an angle is not determined


class Interval(NamedTuple):
    """A number, or several, with half of the 95 % interval; NaN where it is not determined."""

    value: np.ndarray
    half_width: np.ndarray


@dataclass(frozen=True)
class WrenchComparison:
    """How an estimated force follows a measured one."""

    # (n,), (n, 3), of the frames compared: times, s, estimate in B, and what the fit makes of the
    # measured force, N
    time_s: np.ndarray
    estimate_n: np.ndarray
    fitted_n: np.ndarray
    measured_n: np.ndarray  # (n, 3), less its bias and delay, in the wrench sensor's axes, N
    presses: int
    bias_n: Interval  # (3,), what the wrench sensor reads without force, in its axes
    gain: Interval  # estimate over measured
    rotation_rad: Interval  # (3,), rotation vector from the wrench sensor's axes to B
    delay_s: Interval  # of the estimate after the measured force
    # estimate while the force rises less that while it falls, at the same force, N; it is told from
    # the delay where the force is held, or changes at several rates
    hysteresis_n: Interval
    spin_known: bool  # whether forces of several directions tell the whole rotation

    @property
    def rmse_n(self) -> float:
        """Root mean square of what the fit leaves, vectors, N."""
        return float(np.sqrt(np.mean(np.sum((self.estimate_n - self.fitted_n) ** 2, axis=1))))

    @property
    def size_rmse_n(self) -> float:
        """Root mean square of |estimate| less |measured|, without a gain, N."""
        sizes = (np.linalg.norm(force, axis=1) for force in (self.estimate_n, self.measured_n))
        return float(np.sqrt(np.mean(np.subtract(*sizes) ** 2)))


class _Fit(NamedTuple):
    """Parameters for each of several sets of sums (…)."""

    delay_s: np.ndarray
    gain: np.ndarray
    rotation: np.ndarray  # (…, 3, 3)
    bias_n: np.ndarray  # (…, 3)
    hysteresis_n: np.ndarray


def compare_with_wrench(
    time_s: np.ndarray,  # (F,)
    estimate_n: np.ndarray,  # (F, 3) in B; NaN where there is no number to trust
    measured_n: np.ndarray,  # (F, 3) in the sensor's own axes; NaN where there is none
) -> WrenchComparison:
    """Fit and intervals. Raises InputError: there is no contact in frames that have both."""
    has = np.isfinite(measured_n).all(axis=1)
    used = has & np.isfinite(estimate_n).all(axis=1)
    t, e = time_s[used], estimate_n[used]
    touching = np.linalg.norm(e, axis=1) > 0.0
    if touching.sum() < MIN_FRAMES or (~touching).sum() < MIN_FRAMES:
        raise InputError(
            f"{touching.sum()} frames with contact and a wrench, {(~touching).sum()} without"
            f" contact: record at least {MIN_FRAMES} of each"
        )

    # over two periods: else noise, which is less between frames than at them, draws the delay there
    window_s = float(np.median(np.diff(time_s))) * np.linspace(-1.0, 1.0, 9)[:, None]

    def moved(delay_s: np.ndarray) -> np.ndarray:
        """Measured force (…, n, 3) at the times of the estimates less delays (…)."""
        at = t - delay_s[..., None, None] + window_s
        axes = [np.interp(at, time_s[has], axis).mean(axis=-2) for axis in measured_n[has].T]
        return np.stack(axes, axis=-1)

    every, press = moved(_DELAYS_S), _presses(touching)
    q, cluster = np.zeros_like(e), np.zeros(len(t), int)
    for _ in range(_TURNS):  # when the force turns depends on the delay, and the delay on that
        first = _fitted(_sums(e, every, q, cluster).sum(axis=0), aligned=False)
        m = moved(first.delay_s) - first.bias_n
        branch = _branches(m, touching)
        falls = bool((branch < 0.0).any())
        q = falls * branch[:, None] * e / np.maximum(np.linalg.norm(e, axis=1), 1e-300)[:, None]
    cluster = press
    if press.max() + 1 < _LEAST:
        left = e - first.gain * m @ first.rotation.T
        cluster = _blocks(left @ e[touching].mean(axis=0))
    sums = _sums(e, every, q, cluster)
    freedom = len(np.unique(cluster[touching])) - 1
    scale = stdtrit(freedom, 0.975) * np.sqrt(freedom / (freedom + 1)) if freedom else np.nan
    for aligned in (False, True):
        whole = _fitted(sums.sum(axis=0), aligned)
        without = _fitted(sums.sum(axis=0) - sums, aligned)
        turned = Rotation.from_matrix(without.rotation @ whole.rotation.T).as_rotvec()
        half_turn = scale * np.linalg.norm(turned, axis=0)
        if np.linalg.norm(half_turn) < _OPEN_RAD:
            break

    without_hysteresis = sums.sum(axis=0)
    without_hysteresis[..., 7:, :] = without_hysteresis[..., 7:] = 0.0
    other = _fitted(without_hysteresis, aligned)

    def jackknife(name: str) -> Interval:
        value, each = getattr(whole, name), getattr(without, name)
        return Interval(value, scale * np.linalg.norm(each - value, axis=0))

    def interval(name: str) -> Interval:
        """Jackknife, and what the number would be of a model without hysteresis."""
        value, noise = jackknife(name)
        return Interval(value, np.hypot(noise, value - getattr(other, name)))

    m = moved(whole.delay_s) - whole.bias_n
    unknown = Interval(np.array(np.nan), np.array(np.nan))
    return WrenchComparison(
        time_s=t,
        estimate_n=e,
        fitted_n=whole.gain * m @ whole.rotation.T + 0.5 * whole.hysteresis_n * q,
        measured_n=m,
        presses=int(press.max()) + 1,
        bias_n=interval("bias_n"),
        gain=interval("gain"),
        rotation_rad=Interval(Rotation.from_matrix(whole.rotation).as_rotvec(), half_turn),
        delay_s=interval("delay_s"),
        hysteresis_n=jackknife("hysteresis_n") if falls else unknown,
        spin_known=not aligned,
    )


def _presses(touching: np.ndarray) -> np.ndarray:
    """Number of the press that each frame (n,) belongs to, with the rest before it."""
    frames = np.flatnonzero(touching)
    starts = frames[1:][np.diff(frames) > _APART]
    return np.searchsorted(starts - _APART // 2, np.arange(len(touching)), side="right")


def _branches(m: np.ndarray, touching: np.ndarray) -> np.ndarray:
    """1 where the force rises or is held after it rose, −1 after it fell, 0 without contact, (n,).

    It has turned when it is further from its last extreme than noise without contact reaches.
    """
    size = np.linalg.norm(m, axis=1)
    turns = SIGNIFICANT * robust_sigma(m[~touching], center=0.0)
    branch, now, extreme = np.zeros(len(size)), 1.0, 0.0
    for k in np.flatnonzero(touching):
        if not touching[k - 1]:
            now, extreme = 1.0, 0.0
        extreme = now * max(now * extreme, now * size[k])
        if now * (extreme - size[k]) > turns:
            now, extreme = -now, size[k]
        branch[k] = now
    return branch


def _blocks(left: np.ndarray) -> np.ndarray:
    """Blocks of time twice as long as errors (n,) are alike."""
    centred = left - left.mean()
    lags = range(len(left) // 2)
    rho = np.array([centred[k:] @ centred[: len(left) - k] for k in lags])
    length = 2.0 * mean_inflation(rho / max(rho[0], 1e-300))
    count = int(max(_LEAST, len(left) // length))
    return np.arange(len(left)) * count // len(left)


def _sums(e: np.ndarray, m: np.ndarray, q: np.ndarray, cluster: np.ndarray) -> np.ndarray:
    """Products of (1, e, m, q) of frames, summed over clusters, at each delay, (C, D, 10, 10)."""
    same = np.broadcast_to(np.column_stack([np.ones(len(e)), e, q]), (len(m), len(e), 7))
    z = np.concatenate([same[..., :4], m, same[..., 4:]], axis=2)
    return np.stack([z[:, cluster == c].mT @ z[:, cluster == c] for c in range(cluster.max() + 1)])


def _fitted(sums: np.ndarray, aligned: bool) -> _Fit:
    """Least squares of e = g R (m − b) + h q / 2 from sums (…, D, 10, 10), at the best delay.

    `aligned`: the least rotation that fits one direction of force.
    """
    mean = sums / sums[..., :1, :1]
    center = mean[..., 0, :]
    S = mean - center[..., :, None] * center[..., None, :]
    E, M, Q = slice(1, 4), slice(4, 7), slice(7, 10)
    var_e, var_m, var_q, follows_q = (
        np.trace(S[..., a, b], axis1=-2, axis2=-1) for a, b in ((E, E), (M, M), (Q, Q), (E, Q))
    )
    half = np.zeros(var_e.shape)
    for _ in range(_ROUNDS):
        rotation = _rotation(S[..., E, M] - half[..., None, None] * S[..., Q, M], aligned)
        follows, both = (np.sum(rotation * S[..., a, M], axis=(-2, -1)) for a in (E, Q))
        alone = np.maximum(var_q - both**2 / var_m, 1e-12 * var_e)
        half = (follows_q - follows * both / var_m) / alone
        gain = (follows - half * both) / var_m
    left = var_e - gain * follows - half * follows_q
    best = np.clip(np.argmin(left, axis=-1), 1, left.shape[-1] - 2)
    before, least, after = (_at(left, best + k) for k in (-1, 0, 1))
    shift = 0.5 * (before - after) / np.maximum(before - 2.0 * least + after, 1e-300)
    delay = _DELAYS_S[best] + np.clip(shift, -0.5, 0.5) * (_DELAYS_S[1] - _DELAYS_S[0])
    gain, half, rotation, center = (_at(each, best) for each in (gain, half, rotation, center))
    force = center[..., E] - half[..., None] * center[..., Q]
    bias = center[..., M] - np.einsum("...ji,...j->...i", rotation, force) / gain[..., None]
    return _Fit(delay, gain, rotation, bias, 2.0 * half)


def _at(values: np.ndarray, best: np.ndarray) -> np.ndarray:
    """Values (…, D, …) at the delays with numbers (…)."""
    return np.asarray(values[(*np.indices(best.shape), best)])


def _rotation(C: np.ndarray, aligned: bool) -> np.ndarray:
    """Rotation (…, 3, 3) with the largest trace of Rᵀ C (Kabsch, 1976), or the least one."""
    U, S, Vt = np.linalg.svd(C)
    if not aligned:
        sign = np.ones(S.shape)
        sign[..., 2] = np.sign(np.linalg.det(U) * np.linalg.det(Vt))
        return np.asarray((U * sign[..., None, :]) @ Vt)
    start, end = Vt[..., 0, :], U[..., :, 0]
    axis = np.cross(start, end)
    sine, cosine = np.linalg.norm(axis, axis=-1), np.sum(start * end, axis=-1)
    vector = axis * (np.arctan2(sine, cosine) / np.maximum(sine, 1e-12))[..., None]
    return Rotation.from_rotvec(vector.reshape(-1, 3)).as_matrix().reshape(C.shape)
