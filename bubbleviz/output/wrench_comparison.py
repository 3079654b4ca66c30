"""Estimated force against that of a wrench sensor: bias, gain, rotation, delay and hysteresis.

estimate(t) = gain · R (measured(t − delay) − bias) by least squares. Errors of neighbouring frames
are correlated, so intervals come from a jackknife over presses, or over blocks of time where there
are too few presses. Delay and hysteresis are hard to separate, so the intervals include the result
of a model without hysteresis.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import stdtrit

from bubbleviz.errors import InputError
from bubbleviz.recordings import MIN_FRAMES, SIGNIFICANT, mean_inflation, robust_sigma

_DELAYS_S = np.linspace(-0.3, 0.3, 121)  # depth filters average ten frames at most
_MIN_GAP = 5  # contact-free frames between two presses; shorter gaps are failed estimates
_MIN_CLUSTERS = 5  # presses for a jackknife over presses; also the fewest blocks of time
_FIT_ROUNDS = 4  # of rotation, then gain and hysteresis
_BRANCH_ROUNDS = 4  # of delay, then rising and falling branches of the force
_UNDETERMINED_RAD = 0.5 * np.pi  # half-width beyond which an angle is not determined


class Interval(NamedTuple):
    """Values with half of their 95 % intervals; NaN where not determined."""

    value: np.ndarray
    half_width: np.ndarray


@dataclass(frozen=True)
class WrenchComparison:
    """Relation between an estimated and a measured force."""

    # of the frames compared: time (n,), s; estimate and its prediction by the fit, (n, 3) in B, N
    time_s: np.ndarray
    estimate_n: np.ndarray
    fitted_n: np.ndarray
    measured_n: np.ndarray  # (n, 3), corrected for bias and delay, in the wrench sensor's axes, N
    presses: int
    bias_n: Interval  # (3,), reading of the wrench sensor without force, in its axes
    gain: Interval  # estimate over measured
    rotation_rad: Interval  # (3,), rotation vector from the wrench sensor's axes to B
    delay_s: Interval  # of the estimate after the measured force
    # estimate under rising force minus that under falling force, at equal force, N; separable from
    # the delay where the force is held, or changes at several rates
    hysteresis_n: Interval
    spin_known: bool  # whether forces of several directions determine all of the rotation

    @property
    def rmse_n(self) -> float:
        """Root mean square residual of the fit, of force vectors, N."""
        return float(np.sqrt(np.mean(np.sum((self.estimate_n - self.fitted_n) ** 2, axis=1))))

    @property
    def size_rmse_n(self) -> float:
        """Root mean square of |estimate| minus |measured|, without a gain, N."""
        sizes = (np.linalg.norm(force, axis=1) for force in (self.estimate_n, self.measured_n))
        return float(np.sqrt(np.mean(np.subtract(*sizes) ** 2)))


class _Fit(NamedTuple):
    """Fitted parameters, batched over leading axes (…)."""

    delay_s: np.ndarray
    gain: np.ndarray
    rotation: np.ndarray  # (…, 3, 3)
    bias_n: np.ndarray  # (…, 3)
    hysteresis_n: np.ndarray


def compare_with_wrench(
    time_s: np.ndarray,  # (F,)
    estimate_n: np.ndarray,  # (F, 3) in B; NaN where there is no trusted estimate
    measured_n: np.ndarray,  # (F, 3) in the wrench sensor's axes; NaN where there is none
) -> WrenchComparison:
    """Compare forces. Raises InputError: too few frames with contact, or without."""
    has = np.isfinite(measured_n).all(axis=1)
    used = has & np.isfinite(estimate_n).all(axis=1)
    t, e = time_s[used], estimate_n[used]
    touching = np.linalg.norm(e, axis=1) > 0.0
    if touching.sum() < MIN_FRAMES or (~touching).sum() < MIN_FRAMES:
        raise InputError(
            f"wrench and trusted estimate are both known in only {touching.sum()} frames with "
            f"contact and {(~touching).sum()} without; record at least {MIN_FRAMES} of each"
        )

    # Averaged over two frame periods: interpolation alone has less noise between frames than at
    # them, which would bias the delay.
    window_s = float(np.median(np.diff(time_s))) * np.linspace(-1.0, 1.0, 9)[:, None]

    def moved(delay_s: np.ndarray) -> np.ndarray:
        """Measured force (…, n, 3) at the times of the estimates minus delays (…)."""
        at = t - delay_s[..., None, None] + window_s
        axes = [np.interp(at, time_s[has], axis).mean(axis=-2) for axis in measured_n[has].T]
        return np.stack(axes, axis=-1)

    at_delays, press = moved(_DELAYS_S), _presses(touching)
    q, cluster = np.zeros_like(e), np.zeros(len(t), int)
    for _ in range(_BRANCH_ROUNDS):  # delay and branches depend on each other
        first = _fitted(_sums(e, at_delays, q, cluster).sum(axis=0), aligned=False)
        m = moved(first.delay_s) - first.bias_n
        branch = _branches(m, touching)
        falls = bool((branch < 0.0).any())
        q = falls * branch[:, None] * e / np.maximum(np.linalg.norm(e, axis=1), 1e-300)[:, None]
    cluster = press
    if press.max() + 1 < _MIN_CLUSTERS:
        residual = e - first.gain * m @ first.rotation.T
        cluster = _time_blocks(residual @ e[touching].mean(axis=0))
    sums = _sums(e, at_delays, q, cluster)
    freedom = len(np.unique(cluster[touching])) - 1
    scale = stdtrit(freedom, 0.975) * np.sqrt(freedom / (freedom + 1)) if freedom else np.nan
    for aligned in (False, True):
        fit = _fitted(sums.sum(axis=0), aligned)
        without = _fitted(sums.sum(axis=0) - sums, aligned)
        difference = Rotation.from_matrix(without.rotation @ fit.rotation.T).as_rotvec()
        half_rotation = scale * np.linalg.norm(difference, axis=0)
        if np.linalg.norm(half_rotation) < _UNDETERMINED_RAD:
            break

    without_hysteresis = sums.sum(axis=0)
    without_hysteresis[..., 7:, :] = without_hysteresis[..., 7:] = 0.0
    other = _fitted(without_hysteresis, aligned)

    def jackknife(name: str) -> Interval:
        value, each = getattr(fit, name), getattr(without, name)
        return Interval(value, scale * np.linalg.norm(each - value, axis=0))

    def interval(name: str) -> Interval:
        """Jackknife, and the difference from a model without hysteresis."""
        value, noise = jackknife(name)
        return Interval(value, np.hypot(noise, value - getattr(other, name)))

    m = moved(fit.delay_s) - fit.bias_n
    unknown = Interval(np.array(np.nan), np.array(np.nan))
    return WrenchComparison(
        time_s=t,
        estimate_n=e,
        fitted_n=fit.gain * m @ fit.rotation.T + 0.5 * fit.hysteresis_n * q,
        measured_n=m,
        presses=int(press.max()) + 1,
        bias_n=interval("bias_n"),
        gain=interval("gain"),
        rotation_rad=Interval(Rotation.from_matrix(fit.rotation).as_rotvec(), half_rotation),
        delay_s=interval("delay_s"),
        hysteresis_n=jackknife("hysteresis_n") if falls else unknown,
        spin_known=not aligned,
    )


def _presses(touching: np.ndarray) -> np.ndarray:
    """Number of the press that each frame (n,) belongs to; contact-free frames precede a press."""
    frames = np.flatnonzero(touching)
    starts = frames[1:][np.diff(frames) > _MIN_GAP]
    return np.searchsorted(starts - _MIN_GAP // 2, np.arange(len(touching)), side="right")


def _branches(m: np.ndarray, touching: np.ndarray) -> np.ndarray:
    """1 where the force rises or stays after rising, −1 after it fell, 0 without contact, (n,).

    The branch changes when the force differs from its last extreme by more than noise.
    """
    size = np.linalg.norm(m, axis=1)
    threshold = SIGNIFICANT * robust_sigma(m[~touching], center=0.0)
    branch, now, extreme = np.zeros(len(size)), 1.0, 0.0
    for k in np.flatnonzero(touching):
        if not touching[k - 1]:
            now, extreme = 1.0, 0.0
        extreme = now * max(now * extreme, now * size[k])
        if now * (extreme - size[k]) > threshold:
            now, extreme = -now, size[k]
        branch[k] = now
    return branch


def _time_blocks(errors: np.ndarray) -> np.ndarray:
    """Block of each of the errors (n,), with blocks of twice their correlation time."""
    centred = errors - errors.mean()
    lags = range(len(errors) // 2)
    rho = np.array([centred[k:] @ centred[: len(errors) - k] for k in lags])
    length = 2.0 * mean_inflation(rho / max(rho[0], 1e-300))
    count = int(max(_MIN_CLUSTERS, len(errors) // length))
    return np.arange(len(errors)) * count // len(errors)


def _sums(e: np.ndarray, m: np.ndarray, q: np.ndarray, cluster: np.ndarray) -> np.ndarray:
    """Products of (1, e, m, q), summed over frames of each cluster, per delay, (C, D, 10, 10)."""
    same = np.broadcast_to(np.column_stack([np.ones(len(e)), e, q]), (len(m), len(e), 7))
    z = np.concatenate([same[..., :4], m, same[..., 4:]], axis=2)
    return np.stack([z[:, cluster == c].mT @ z[:, cluster == c] for c in range(cluster.max() + 1)])


def _fitted(sums: np.ndarray, aligned: bool) -> _Fit:
    """Least squares of e = g R (m − b) + h q / 2 from sums (…, D, 10, 10), at the best delay.

    `aligned`: use the smallest rotation that fits forces of a single direction.
    """
    mean = sums / sums[..., :1, :1]
    center = mean[..., 0, :]
    S = mean - center[..., :, None] * center[..., None, :]
    E, M, Q = slice(1, 4), slice(4, 7), slice(7, 10)
    var_e, var_m, var_q, follows_q = (
        np.trace(S[..., a, b], axis1=-2, axis2=-1) for a, b in ((E, E), (M, M), (Q, Q), (E, Q))
    )
    half = np.zeros(var_e.shape)
    for _ in range(_FIT_ROUNDS):
        rotation = _rotation(S[..., E, M] - half[..., None, None] * S[..., Q, M], aligned)
        follows, both = (np.sum(rotation * S[..., a, M], axis=(-2, -1)) for a in (E, Q))
        alone = np.maximum(var_q - both**2 / var_m, 1e-12 * var_e)
        half = (follows_q - follows * both / var_m) / alone
        gain = (follows - half * both) / var_m
    misfit = var_e - gain * follows - half * follows_q
    best = np.clip(np.argmin(misfit, axis=-1), 1, misfit.shape[-1] - 2)
    before, least, after = (_at(misfit, best + k) for k in (-1, 0, 1))
    shift = 0.5 * (before - after) / np.maximum(before - 2.0 * least + after, 1e-300)
    delay = _DELAYS_S[best] + np.clip(shift, -0.5, 0.5) * (_DELAYS_S[1] - _DELAYS_S[0])
    gain, half, rotation, center = (_at(each, best) for each in (gain, half, rotation, center))
    force = center[..., E] - half[..., None] * center[..., Q]
    bias = center[..., M] - np.einsum("...ji,...j->...i", rotation, force) / gain[..., None]
    return _Fit(delay, gain, rotation, bias, 2.0 * half)


def _at(values: np.ndarray, best: np.ndarray) -> np.ndarray:
    """Values (…, D, …) at the delays with indices (…)."""
    return np.asarray(values[(*np.indices(best.shape), best)])


def _rotation(C: np.ndarray, aligned: bool) -> np.ndarray:
    """Rotation (…, 3, 3) that maximises the trace of Rᵀ C (Kabsch, 1976), or the smallest one."""
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
