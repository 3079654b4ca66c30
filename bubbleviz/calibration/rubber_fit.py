"""Pre-stretch and gauge pressure from the shapes of an untouched sensor at inflation levels.

Shape S0 and gauge pressure G give the stress at rest, and q = λ⁻⁶ = 1 − γ0/μh the rubber: the
membrane's shape at another level, whose pressure differs by a measured Δp, then depends on q and
on the ratio (G + Δp)/G alone. Both are fitted to how the range of every pixel changes between the
levels, in which fixed errors of the camera and the flat facets of the mesh cancel.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.special import ndtri, stdtrit

from bubbleviz.calibration.bootstrap import DRAWS, draw_errors, frames_block, samples_scores
from bubbleviz.calibration.rest_frames import Samples
from bubbleviz.camera import DepthCamera, RayCaster
from bubbleviz.errors import InputError, SolveError
from bubbleviz.membrane import (
    STRESS_DEGREE,
    Inflation,
    MembraneMesh,
    Prestress,
    RubberMembrane,
    mean_curvature,
    prestressed,
)
from bubbleviz.recordings import (
    FrameSource,
    error_of_mean,
    robust_sigma,
    tukey_slopes,
    tukey_weights,
)
from bubbleviz.sensor import Sensor
from bubbleviz.wording import count_of

SMALLEST_Q, LARGEST_Q = 1e-3, 0.97
"""Range of q: λ from 3.2, which is as good as constant tension, to 1.005."""
LEAST_RISE = 0.01  # change of the gauge pressure, over itself, below which a level says nothing
_STARTS = (0.35, 0.7, 0.05)
"""λ of 1.19 to begin with; 1.06 and 1.65 where that cannot hold the levels, or slides down to
constant tension, as it may from a gauge pressure that is far too low."""
_STEPS = 12
_SMALL = 1e-4
STEP_OF_Q = 1e-3  # relative step of q for the derivative of the forces
_LOOK_M = 1e-5  # largest motion of a node for the derivative of ranges, m
_RINGS = 4
"""Of equal numbers of pixels between rim and top: each large against what errors of the model are
alike over, and the others still tell q from G."""


@dataclass(frozen=True)
class LevelShape:
    """A membrane inflated otherwise, as the camera sees it."""

    nodes_m: np.ndarray  # (n, 3)
    range_m: np.ndarray  # (k,), NaN where a ray misses
    # (k, 2), derivatives of the range by q and by the ratio of gauge pressures, m
    slopes_m: np.ndarray


class LevelModel:
    """Range of the camera's pixels when the sensor is inflated otherwise."""

    def __init__(
        self,
        mesh: MembraneMesh,  # reference surface in B
        camera: DepthCamera,
        pixels: np.ndarray,  # (k,) int, flat indices of those to look at
    ) -> None:
        self._mesh, self._camera, self._pixels = mesh, camera, pixels
        self._caster = RayCaster(camera.center, camera.directions, mesh.triangles)
        self._tension = 1.0 / mean_curvature(mesh)  # over the gauge pressure, which is 1 Pa here
        self._stress = Prestress.of(mesh, 1.0)
        self.rest_m = self._cast(mesh.nodes)

    @property
    def height_m(self) -> np.ndarray:
        """Height of what the pixels see at rest over the rim plane, (k,), m; NaN where none."""
        upward: np.ndarray = self._camera.directions[self._pixels, 2]
        return self._camera.center[2] + self.rest_m * upward

    def tighter(self, share: float) -> LevelModel:
        """The same with all stress at rest larger by a share, γ0 with it."""
        other = copy(self)
        other._tension = (1.0 + share) * self._tension
        other._stress = self._stress.times(1.0 + share)
        return other

    def smoother(self) -> LevelModel:
        """The same with the stress at rest by polynomials of a lower degree."""
        other = copy(self)
        other._stress = Prestress.of(self._mesh, 1.0, STRESS_DEGREE - 2)
        return other

    def on(self, mesh: MembraneMesh) -> LevelModel:
        """The same pixels over another reference surface."""
        return LevelModel(mesh, self._camera, self._pixels)

    def at(self, q: float, ratio: float, near: np.ndarray | None = None) -> LevelShape:
        """Shape of rubber of q at a ratio of gauge pressures.

        Raises SolveError: the rubber cannot hold the pressure.
        """
        inflation = Inflation(self._rubber(q))
        x = inflation.at(ratio, near)
        step = STEP_OF_Q * q
        here, ahead = (
            membrane.force(x) - membrane.rest_force
            for membrane in (inflation.membrane, self._rubber(q + step))
        )
        forces = np.stack([(here - ahead) / step, inflation.membrane.volume_gradient(x)])
        ranges = self._cast(x)
        slopes = []
        for motion in inflation.motions(x, ratio, forces):
            way = _LOOK_M / max(float(np.abs(motion).max()), 1e-300)
            slopes.append((self._cast(x + way * motion) - ranges) / way)
        return LevelShape(x, ranges, np.stack(slopes, axis=1))

    def _rubber(self, q: float) -> RubberMembrane:
        return prestressed(self._mesh, 1.0, self._tension / (1.0 - q), self._stress)

    def _cast(self, nodes: np.ndarray) -> np.ndarray:
        hits = self._caster.cast(nodes, self._mesh.normals, self._pixels)
        ranges = np.full(len(self._caster.directions), np.nan)
        ranges[hits.ray] = hits.range_m
        return ranges[self._pixels]


@dataclass(frozen=True)
class RubberFit:
    """What the levels say."""

    q: float  # λ⁻⁶
    gauge_pressure_pa: float  # G of the reference surface
    # q_errors, gauge_errors_pa: (R,), bootstrap errors of both
    q_errors: np.ndarray
    gauge_errors_pa: np.ndarray
    rms_m: float  # robust rms of what the changes of range are missed by, m
    change_rms_m: float  # that of the changes themselves, m
    rises_pa: tuple[float, ...]  # pressure of every level over that of the reference surface, Pa

    def under(self, gauge_pa: float, sigma_pa: float) -> Self:
        """The same where the gauge pressure is known otherwise; q follows as their errors do."""
        relative = self.gauge_errors_pa / self.gauge_pressure_pa
        slope = float(np.cov(self.q_errors, relative)[0, 1] / np.var(relative))  # dq/d(ln G)
        drawn = sigma_pa / gauge_pa * np.random.default_rng([0, 3]).standard_normal(DRAWS)
        return replace(
            self,
            q=self.q + slope * float(np.log(gauge_pa / self.gauge_pressure_pa)),
            q_errors=self.q_errors + slope * (drawn - relative),
        )


def fit_rubber(
    base: Samples,  # of the reference surface
    mesh: MembraneMesh,  # reference surface in B
    # of another surface that fits the same frames: what it changes is an error, too
    other_mesh: MembraneMesh,
    camera: DepthCamera,  # in B
    mask: np.ndarray,  # (H, W) bool, pixels in use
    levels: Sequence[Samples],  # same camera, other pressures
    gauge_pressure_pa: float,  # G, or where to begin
    gauge_sigma_pa: float | None = None,  # its standard deviation where it is known
    # relative standard deviation of the stress that shape and gauge pressure give
    stress_sigma: float = 0.0,
) -> RubberFit:
    """Fit λ⁻⁶ and, where it is not known, the gauge pressure to inflation levels.

    Raises InputError: a level has no gas pressure, or no rubber is near the levels. Raises
    SolveError: the rubber that is found cannot hold the levels over the other surface.
    """
    pressures = [_mean_pressure(each) for each in (base, *levels)]
    rises = np.array([mean - pressures[0][0] for mean, _ in pressures[1:]])
    for each, rise in zip(levels, rises, strict=True):
        if abs(rise) < LEAST_RISE * gauge_pressure_pa:
            raise InputError(
                f"{each.source_name}: its gas pressure differs from {base.source_name}'s by"
                f" {rise:.0f} Pa only; inflate by 15 % more and less"
            )
    fit = _Fit(base, mesh, camera, mask, levels, rises)
    free = (True, gauge_sigma_pa is None)
    state = fit.solve(gauge_pressure_pa, free)
    influence, to_rise = fit.influence(state, free)
    errors = fit.bootstrap(state, influence)
    rng = np.random.default_rng([0, 1])
    shaken = rng.standard_normal((DRAWS, len(pressures))) * [sigma for _, sigma in pressures]
    errors += (shaken[:, 1:] - shaken[:, :1]) @ to_rise
    facets = (mesh.edge_length * 0.5 * mean_curvature(mesh)) ** 2
    ways = [
        stress_sigma * fit.by_stress(state, influence),
        facets * fit.by_motion(state, influence),
        fit.by_degree(state, influence),
        fit.by_surface(state, influence, other_mesh),
        *fit.by_ring(state, free),
    ]
    errors += rng.standard_normal((DRAWS, len(ways))) @ ways
    if gauge_sigma_pa is not None:
        shift = gauge_sigma_pa / state.gauge_pa * rng.standard_normal(DRAWS)
        errors[:, 1] = shift
        errors[:, 0] += shift * fit.q_by_gauge(state)
    return RubberFit(
        q=state.q,
        gauge_pressure_pa=state.gauge_pa,
        q_errors=errors[:, 0],
        gauge_errors_pa=state.gauge_pa * errors[:, 1],
        rms_m=robust_sigma(state.missed_m, center=0.0),
        change_rms_m=robust_sigma(fit.change_m, center=0.0),
        rises_pa=tuple(float(rise) for rise in rises),
    )


@dataclass(frozen=True)
class _State:
    """A pair of parameters, and what it leaves."""

    q: float
    gauge_pa: float
    missed_m: np.ndarray  # (L, k), measured less modelled change of range
    slopes: np.ndarray  # (L, k, 2), derivatives of the modelled change by q and by ln G, m
    nodes_m: list[np.ndarray]  # list of (n, 3) array, of every level


class _Fit:
    """Gauss–Newton in (q, ln G), down Tukey's loss."""

    def __init__(
        self,
        base: Samples,
        mesh: MembraneMesh,
        camera: DepthCamera,
        mask: np.ndarray,
        levels: Sequence[Samples],
        rises_pa: np.ndarray,
    ) -> None:
        self._base, self._levels, self._rises = base, levels, rises_pa
        self._pixels = np.flatnonzero(mask.ravel())
        self._model = LevelModel(mesh, camera, self._pixels)
        rest = base.statistics.range_m.ravel()[self._pixels]
        self.change_m = np.stack([self._ranges(each) - rest for each in levels])

    def _ranges(self, level: Samples) -> np.ndarray:
        statistics = level.statistics
        if statistics.range_m.shape != self._base.statistics.range_m.shape:
            raise InputError(
                f"{level.source_name}: images of another size than {self._base.source_name}'s;"
                " record all levels with one camera mode"
            )
        steady = statistics.validity >= statistics.regular_validity
        return np.where(steady, statistics.range_m, np.nan).ravel()[self._pixels]

    def solve(self, gauge_pa: float, free: tuple[bool, bool]) -> _State:
        slid: _State | None = None
        for q in _STARTS:
            state = self._descend(q, gauge_pa, free)
            if state is not None and state.q > SMALLEST_Q:
                return state
            slid = slid or state
        if slid is not None:
            return slid
        raise InputError(
            f"{self._base.source_name}: the levels' pressures are beyond what rubber of this shape"
            " holds; check the gas pressures and the atmospheric pressure"
        )

    def _descend(self, q: float, gauge_pa: float, free: tuple[bool, bool]) -> _State | None:
        state, damping = self._state(q, gauge_pa), 1e-3
        if state is None:
            return None
        for _ in range(_STEPS):
            sigma = max(robust_sigma(state.missed_m, center=0.0), 1e-9)
            weights = tukey_weights(state.missed_m, sigma)
            step = _step(state, weights, free, damping)
            ahead = float(np.clip(state.q + step[0], SMALLEST_Q, LARGEST_Q))
            gauge = state.gauge_pa * float(np.exp(np.clip(step[1], -0.5, 0.5)))
            trial = self._state(ahead, gauge, state)
            if trial is not None and _loss(trial.missed_m, sigma) <= _loss(state.missed_m, sigma):
                moved = max(abs(trial.q - state.q), abs(np.log(trial.gauge_pa / state.gauge_pa)))
                state, damping = trial, damping / 10.0
                if moved < _SMALL:
                    break
            else:
                damping *= 10.0
                if damping > 1e6:
                    break
        return state

    def _state(self, q: float, gauge_pa: float, near: _State | None = None) -> _State | None:
        ratios = 1.0 + self._rises / gauge_pa
        try:
            shapes = [
                self._model.at(q, ratio, None if near is None else near.nodes_m[k])
                for k, ratio in enumerate(ratios)
            ]
        except SolveError:
            return None
        missed = self.change_m - np.stack([shape.range_m for shape in shapes]) + self._model.rest_m
        slopes = np.stack([shape.slopes_m for shape in shapes])
        slopes[..., 1] *= -(self._rises / gauge_pa)[:, None]
        known = np.isfinite(missed) & np.isfinite(slopes).all(axis=2)
        missed[~known], slopes[~known] = np.nan, 0.0
        return _State(q, gauge_pa, missed, slopes, [shape.nodes_m for shape in shapes])

    def influence(self, state: _State, free: tuple[bool, bool]) -> tuple[np.ndarray, np.ndarray]:
        """Change of (q, ln G) per change of every range (L, k, 2), and of every rise (L, 2)."""
        sigma = max(robust_sigma(state.missed_m, center=0.0), 1e-9)
        weights = tukey_weights(state.missed_m, sigma)
        normal = _normal(state, tukey_slopes(state.missed_m, sigma), free)
        influence = (weights[..., None] * state.slopes) @ normal
        by_rise = state.slopes[:, :, 1] / -self._rises[:, None]
        return influence, -np.einsum("lk,lkp->lp", by_rise, influence)

    def q_by_gauge(self, state: _State) -> float:
        """Change of the fitted q per change of ln G."""
        weights = tukey_weights(state.missed_m, max(robust_sigma(state.missed_m, 0.0), 1e-9))
        by_q, by_gauge = state.slopes[..., 0], state.slopes[..., 1]
        return -float(np.sum(weights * by_q * by_gauge) / np.sum(weights * by_q**2))

    def by_stress(self, state: _State, influence: np.ndarray) -> np.ndarray:
        """Change of the fitted (q, ln G), (2,), per relative change of the stress at rest."""
        share = 0.01
        return self._by_model(self._model.tighter(share), state, influence, state.nodes_m) / share

    def by_degree(self, state: _State, influence: np.ndarray) -> np.ndarray:
        """Change of the fitted (q, ln G), (2,), where the stress at rest is a smoother field."""
        return self._by_model(self._model.smoother(), state, influence, state.nodes_m)

    def by_surface(self, state: _State, influence: np.ndarray, mesh: MembraneMesh) -> np.ndarray:
        """Change of the fitted (q, ln G), (2,), on another reference surface."""
        return self._by_model(self._model.on(mesh), state, influence, [None] * len(self._levels))

    def _by_model(
        self,
        other: LevelModel,
        state: _State,
        influence: np.ndarray,
        near: Sequence[np.ndarray | None],
    ) -> np.ndarray:
        """Change of the fitted (q, ln G), (2,), by another model of the levels."""
        ratios = 1.0 + self._rises / state.gauge_pa
        shapes = [other.at(state.q, *each) for each in zip(ratios, near, strict=True)]
        change = np.stack([shape.range_m for shape in shapes]) - other.rest_m
        moved = np.nan_to_num(change - (self.change_m - state.missed_m))
        return -np.einsum("lk,lkp->p", moved, influence)

    def by_ring(self, state: _State, free: tuple[bool, bool]) -> np.ndarray:
        """Errors (_RINGS, 2) of a standard deviation each by whatever the model gets wrong.

        The jackknife over rings: uneven rubber, and a surface that is wrong where it is not seen,
        show as rings that ask for different rubber.
        """
        height = np.nan_to_num(self._model.height_m, nan=-np.inf)
        limits = np.nanquantile(self._model.height_m, np.arange(1, _RINGS) / _RINGS)
        ring = np.searchsorted(limits, height)
        sigma = max(robust_sigma(state.missed_m, center=0.0), 1e-9)
        weights = tukey_weights(state.missed_m, sigma)
        moved = np.stack([_step(state, weights * (ring != k), free, 0.0) for k in range(_RINGS)])
        spread = np.sqrt((_RINGS - 1) / _RINGS) * moved
        return spread * float(stdtrit(_RINGS - 1, 0.975) / ndtri(0.975))

    def by_motion(self, state: _State, influence: np.ndarray) -> np.ndarray:
        """Change of the fitted (q, ln G), (2,), where the mesh moves too much by a share of it.

        Facets are wrong by the square of their size over the radius of curvature.
        """
        modelled = np.nan_to_num(self.change_m - state.missed_m)
        return -np.einsum("lk,lkp->p", modelled, influence)

    def bootstrap(self, state: _State, influence: np.ndarray) -> np.ndarray:
        """Errors of (q, ln G), (R, 2), from noise and from what the model does not explain."""
        total = np.zeros((DRAWS, 2))
        for k, level in enumerate(self._levels):
            total += self._drawn(level, influence[k], np.nan_to_num(state.missed_m[k]), [0, k])
        none = np.zeros(len(self._pixels))
        return total + self._drawn(self._base, -influence.sum(axis=0), none, [0, -1 & 0xFFFF])

    def _drawn(
        self, samples: Samples, influence: np.ndarray, missed_m: np.ndarray, seed: list[int]
    ) -> np.ndarray:
        table = samples_scores(samples, self._pixels, influence, missed_m, parameters=2)
        drawn = int(np.random.default_rng(seed).integers(2**31))
        return draw_errors(table, frames_block(samples.statistics), drawn).total


def _loss(missed_m: np.ndarray, sigma: float) -> float:
    """Tukey's loss up to a factor; pixels without a value count as outliers."""
    share = np.minimum((missed_m / (4.685 * sigma)) ** 2, 1.0)
    return float(np.sum(1.0 - (1.0 - np.nan_to_num(share, nan=1.0)) ** 3))


def _normal(
    state: _State, weights: np.ndarray, free: tuple[bool, bool], damping: float = 0.0
) -> np.ndarray:
    """Inverse of the normal matrix over the free parameters, 0 for the others, (2, 2)."""
    matrix = np.einsum("lk,lkp,lkq->pq", weights, state.slopes, state.slopes)
    matrix[np.diag_indices(2)] *= 1.0 + damping
    chosen = np.flatnonzero(free)
    inverse = np.zeros((2, 2))
    inverse[np.ix_(chosen, chosen)] = np.linalg.pinv(matrix[np.ix_(chosen, chosen)])
    return inverse


def _step(
    state: _State, weights: np.ndarray, free: tuple[bool, bool], damping: float
) -> np.ndarray:
    right = np.einsum("lk,lkp->p", weights * np.nan_to_num(state.missed_m), state.slopes)
    return _normal(state, weights, free, damping) @ right


def _mean_pressure(samples: Samples) -> tuple[float, float]:
    """Mean absolute gas pressure and its standard error, Pa."""
    gas = samples.gas_pressure_pa
    if gas is None:
        raise InputError(
            f"{samples.source_name}: no gas pressure; λ needs that of every level: record it"
        )
    return float(np.mean(gas)), error_of_mean(gas)


# Atmospheric pressure by the gas pressure sensor itself, its chamber open.


_FEWEST = 5  # frames whose mean and spread say something; chosen


@dataclass(frozen=True)
class Vented:
    """Gas pressure of the open chamber: an offset of the sensor is the same with it closed."""

    source_name: str
    pressure_pa: float  # absolute, Pa
    sigma_pa: float  # standard error, Pa

    @classmethod
    def measure(cls, source: FrameSource) -> Vented:
        """Mean over all frames of a recording.

        Raises InputError: fewer than five frames with a gas pressure.
        """
        values = [source[k].gas_pressure_pa for k in range(len(source))]
        known = np.array([value for value in values if value is not None])
        if len(known) < _FEWEST:
            raise InputError(
                f"{source.name}: {count_of(len(known), 'frame')} with a gas pressure; --vented"
                f" needs {_FEWEST}: record the sensor with its chamber open"
            )
        return cls(source.name, float(np.mean(known)), error_of_mean(known))

    def set_in(self, sensor: Sensor) -> Sensor:
        """The sensor with this atmospheric pressure."""
        section = sensor.pneumatics.model_copy(
            update={
                "atmospheric_pressure_pa": round(self.pressure_pa, 1),
                "gauge_sigma_pa": None,  # of a gauge pressure told by something else
            }
        )
        return sensor.model_copy(update={"pneumatics": section})
