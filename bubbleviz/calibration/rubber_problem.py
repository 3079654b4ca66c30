"""One least-squares problem for pre-stretch and gauge pressure, over all that tells of them.

The rest surface S0 and its gauge pressure G give the stress at rest by statics, and q = λ⁻⁶ =
1 − γ0/μh the rubber. Under another gas pressure, which differs by a measured Δp, the shape depends
on q, on (G + Δp)/G, and, where something presses, on the contact pressures. Unknown are q, G and
the contact pressures of the nodes that may be touched; an inflation level is a press without any.
Rows are the changes of range from rest, in which fixed errors of camera and mesh cancel, G as the
sensor file or the open chamber tells it, and the gas pressure of every recording, each with its
standard deviation; the errors of these pressures are unknowns, too.

White noise of a hundred thousand pixels would outweigh that row, though what the model gets wrong
does not average out. So the rows of ranges are tempered: they count as much less as the covariance
of their own estimate is wider with the errors of the model than by noise alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.optimize import least_squares
from scipy.sparse.csgraph import connected_components

from bubbleviz.calibration.errors import cluster_covariances, student
from bubbleviz.calibration.rest_frames import Samples
from bubbleviz.camera import RangeObserver, ShapeRanges
from bubbleviz.errors import InputError
from bubbleviz.inverse import PRESSURE_SCALE, RIM_SLACK_M
from bubbleviz.membrane import (
    STRESS_DEGREE,
    Factor,
    Factoriser,
    MembraneMesh,
    Prestress,
    RubberMembrane,
    cotangent_laplacian,
    mean_curvature,
    prestressed,
)
from bubbleviz.recordings import (
    SIGNIFICANT,
    error_of_mean,
    robust_sigma,
    tukey_loss,
    tukey_slopes,
    tukey_weights,
)
from bubbleviz.sensor_model import SensorModel

SMALLEST_Q, LARGEST_Q = 1e-3, 0.97
"""Range of q: λ from 3.2, which is as good as constant tension, to 1.005."""
_STARTS = (0.35, 0.7, 0.05)
"""λ of 1.19 to begin with; 1.06 and 1.65 where that cannot hold the shapes, or slides down to
constant tension, as it may from a gauge pressure that is far too low."""
_LEAST_GAUGE = 0.1  # of the gauge pressure to begin with
_STEP_OF_Q = 1e-3  # relative step of q for the derivative of the forces
_LEAST_RISE = 0.01  # change of the gauge pressure, over itself, below which a shape says nothing
_PRESSURE_ERROR = 0.01
"""Standard deviation of the gas pressure of a recording beside that of another one, over the
largest gauge pressure of them. Data sheets of silicon pressure sensors give a total error band of
±1 to ±2 % of full scale, by zero, span and temperature (Honeywell HSC and ABP: ±1 and ±1.5 %), and
full scale is that pressure at least: ±2 % is taken for 95 %. Frames of one recording share the zero
and the temperature: a press in it has none of this."""
_EDGE_OF_DENT = 0.25
"""Share of a dent's depth beyond which something may touch. The membrane leaves a flat plate that
covers a dome to 0.85 of its radius there; anything smaller or rounder it leaves deeper."""
_RINGS, _SECTORS = 4, 8
"""Parts of the view left out in turn, each large against what errors of the model are alike over:
of equal numbers of blocks between rim and top of a level, around the dent of a press."""
_CLOSE = 1e-4  # relative change of the sum of squares that ends the fit, far below its noise
_MOST_STEPS = 60
_NEWTON, _BALANCED = 30, 1e-6
"""Steps to equilibrium, and force left there over the load on a node of mean area."""
_OUTLIER = 10.0  # standard deviations of a block whose ray misses the membrane

Rubber = Callable[[float], RubberMembrane]
"""The membrane by its q, under a gauge pressure of 1 Pa."""


def _rest_rubber(mesh: MembraneMesh, slack_m: float | None, degree: int = STRESS_DEGREE) -> Rubber:
    """Rubber whose stress at rest follows from its surface; `slack_m` as of `RubberMembrane`."""
    tension = 1.0 / mean_curvature(mesh)  # γ0, m
    stress = Prestress.of(mesh, 1.0, degree).on(mesh)
    return lambda q: prestressed(mesh, 1.0, tension / (1.0 - q), stress, slack_m)


@dataclass(frozen=True)
class _SeenShape:
    """The membrane under another gas pressure, as the camera sees it: change from rest."""

    samples: Samples
    rise_pa: float  # of the gas pressure over that of the rest
    # change_m, weight: (B,), of the range of each block, and 1/σ² of that
    change_m: np.ndarray
    weight: np.ndarray
    zone: np.ndarray  # (k,) int, nodes that something may touch


class _Predicted(NamedTuple):
    x: np.ndarray  # (n, 3), m
    inside: float | np.ndarray  # pressure from inside over that from outside, over G
    factor: Factor  # of the tangent
    change_m: np.ndarray  # (B,) change of range; NaN of blocks that are not seen
    view: ShapeRanges


class Fit(NamedTuple):
    """Where the least squares ended."""

    vector: np.ndarray  # as of `RubberProblem`
    covariance: np.ndarray  # (2, 2), of q and G over the one to begin with, model errors in it
    temper: float  # variance of G over what it were if the residuals were white noise


class RubberProblem:
    """The least squares in q, G over the one to begin with, contact pressures over G, and errors.

    The errors are those of the gas pressures of rest and shapes over their standard deviations.

    Raises InputError: shapes that say nothing, such as of an unknown gas pressure.
    """

    def __init__(
        self,
        model: SensorModel,
        rest: Samples,
        seen: Sequence[Samples],
        other_mesh: MembraneMesh,  # of another surface: what differs on it is an error, too
        gauge_pa: float,  # to begin with
        stress_sigma: float,  # relative, of the stress that shape and gauge pressure give
        level_sigma_pa: float | None,  # of the gas pressure beside that of another recording
        *,
        pressed: bool,
    ) -> None:
        pixels = None if model.pixels is None else replace(model.pixels, line=None)
        # lines are fitted to the levels themselves
        self._observer = observer = replace(model, pixels=pixels).observer()
        self._rest, self._gauge_pa, self._stress_sigma = rest, gauge_pa, stress_sigma
        self._mesh, self._other_mesh = model.mesh, other_mesh
        # a press bends the membrane at its clamp
        self._slack_m = RIM_SLACK_M if pressed else None
        self._rubber = _rest_rubber(model.mesh, self._slack_m)
        self._shapes = [_seen(observer, rest, each, pressed=pressed) for each in seen]
        for shape in self._shapes:
            _check_rise(shape, gauge_pa, pressed=pressed)
        ends = 2 + np.cumsum([0, *(len(shape.zone) for shape in self._shapes)])
        self._places = [slice(*pair) for pair in pairwise(ends.tolist())]
        self._errors = slice(int(ends[-1]), int(ends[-1]) + 1 + len(seen))
        self._size = self._errors.stop
        self.rises_pa = tuple(shape.rise_pa for shape in self._shapes)
        if level_sigma_pa is None:
            level_sigma_pa = _PRESSURE_ERROR * (gauge_pa + max(0.0, *self.rises_pa))
        noise = [_mean_pressure(each)[1] for each in (rest, *seen)]
        self._pressure_sigma_pa = np.hypot(noise, 0.0 if pressed else level_sigma_pa)
        # rows of the contact pressures' roughness
        self._smooth = np.zeros((self._errors.start - 2, self._size))
        laplacian = cotangent_laplacian(model.mesh).tocsr()
        for shape, place in zip(self._shapes, self._places, strict=True):
            if len(shape.zone):
                root = np.linalg.cholesky(laplacian[shape.zone][:, shape.zone].toarray()).T
                self._smooth[place.start - 2 : place.stop - 2, place] = root / PRESSURE_SCALE
        weight = np.concatenate([shape.weight for shape in self._shapes])
        self._root = np.sqrt(np.where(weight > 0.0, weight, np.nan))  # 1/σ of each block
        self._change_m = np.concatenate([shape.change_m for shape in self._shapes])
        self._start_from_rest()
        tangent = self._rubber(_STARTS[0]).tangent(model.mesh.nodes, 1.0)
        self._factoriser = Factoriser(tangent)
        self._last: tuple[bytes, list[_Predicted] | None] = (b"", None)

    def _start_from_rest(self) -> None:
        """Look for the shapes from the rest on, and no more from those found last."""
        self._near: list[tuple[np.ndarray, ShapeRanges | None]]
        self._near = [(self._mesh.nodes, None)] * len(self._shapes)

    @property
    def change_rms_m(self) -> float:
        """Robust rms of the changes of range, m."""
        return robust_sigma(self._change_m[np.isfinite(self._root)], center=0.0)

    def unexplained_rms_m(self, vector: np.ndarray) -> float:
        """Robust rms of what the rubber leaves of them, m."""
        return robust_sigma(self._missed(vector), center=0.0)

    # -- model ----------------------------------------------------------------------------------

    def _at(self, vector: np.ndarray) -> list[_Predicted] | None:
        """All shapes; None where the rubber has no equilibrium."""
        key = vector.tobytes()
        if self._last[0] != key:
            found = self._predicted(vector, self._rubber(float(vector[0])))
            if found is not None:
                self._near = [(each.x, each.view) for each in found]
            self._last = key, found
        return self._last[1]

    def _predicted(self, vector: np.ndarray, membrane: RubberMembrane) -> list[_Predicted] | None:
        out = []
        gauge_pa, rises_pa = self._gauge_pa * float(vector[1]), self._rises_pa(vector)
        moved, at_rest = membrane.mesh.nodes - self._mesh.nodes, np.zeros(self._observer.blocks)
        if moved.any():
            at_rest = self._observer.around(membrane.mesh.nodes).model_m
        for shape, place, rise_pa, (x, last) in zip(
            self._shapes, self._places, rises_pa, self._near, strict=True
        ):
            inside: float | np.ndarray = 1.0 + rise_pa / gauge_pa
            if len(shape.zone):
                inside = np.full(len(x), inside)
                inside[shape.zone] -= vector[place]
            balanced = self._balanced(membrane, inside, x + moved)
            if balanced is None:
                return None
            view = self._observer.around(balanced[0], last)
            change = np.full(len(at_rest), np.nan)
            change[view.block] = (view.model_m - at_rest)[view.block]
            out.append(_Predicted(balanced[0], inside, balanced[1], change, view))
        return out

    def _rises_pa(self, vector: np.ndarray) -> list[float]:
        """Gas pressures of the shapes over that of the rest, less their errors."""
        off = self._pressure_sigma_pa * vector[self._errors]
        return [rise + error - off[0] for rise, error in zip(self.rises_pa, off[1:], strict=True)]

    def _balanced(
        self, membrane: RubberMembrane, inside: float | np.ndarray, x: np.ndarray
    ) -> tuple[np.ndarray, Factor] | None:
        """Newton's method, in steps of a mesh edge at most."""
        mesh, moving = membrane.mesh, membrane.moving
        for _ in range(_NEWTON):
            left = membrane.residual(x, inside)[moving].ravel()
            try:
                factor = self._factoriser.factor(membrane.tangent(x, inside).data)
            except RuntimeError:  # singular
                return None
            if np.abs(left).max() < _BALANCED * mesh.areas.mean():
                stable = np.ndim(inside) > 0 or factor.negative_directions() == 0
                return (x, factor) if stable else None
            motion = np.zeros_like(x)
            motion[moving] = -factor.solve(left).reshape(-1, 3)
            longest = float(np.abs(motion).max())
            if not np.isfinite(longest):
                return None
            x = x + min(1.0, mesh.edge_length / max(longest, 1e-300)) * motion
        return None

    def _slopes(self, vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the changes by the unknowns (D, N), and by the stress at rest (D,)."""
        found, q = self._at(vector), float(vector[0])
        assert found is not None
        here, ahead = self._rubber(q), self._rubber((1.0 + _STEP_OF_Q) * q)
        pull, slopes, by_stress = here.force(here.mesh.nodes), [], []
        gauge_pa, rises_pa = self._gauge_pa * vector[1], self._rises_pa(vector)
        error = np.arange(self._size)[self._errors]
        for k, (shape, place, each) in enumerate(
            zip(self._shapes, self._places, found, strict=True)
        ):
            moving, area = here.moving, here.volume_gradient(each.x)
            by_q = here.residual(each.x, each.inside) - ahead.residual(each.x, each.inside)
            forces = np.zeros((*each.x.shape, 3 + len(shape.zone)))
            forces[..., 0] = pull - here.force(each.x)
            forces[..., 1] = by_q / (_STEP_OF_Q * q)
            forces[..., 2] = area / gauge_pa
            forces[shape.zone, :, 3 + np.arange(len(shape.zone))] = -area[shape.zone]
            motions = np.zeros_like(forces)
            right = np.ascontiguousarray(forces[moving].reshape(3 * len(moving), -1))
            motions[moving] = each.factor.solve(right).reshape(len(moving), 3, -1)
            rows = np.zeros((len(shape.change_m), motions.shape[2]))
            rows[each.view.block] = each.view.jacobian @ motions.reshape(3 * len(each.x), -1)
            own = np.zeros((len(rows), self._size))
            by_rise = rows[:, 2]  # by a pascal
            own[:, 0], own[:, 1] = rows[:, 1], -rises_pa[k] / vector[1] * by_rise
            own[:, place] = rows[:, 3:]
            own[:, error[0]] = -self._pressure_sigma_pa[0] * by_rise
            own[:, error[1 + k]] = self._pressure_sigma_pa[1 + k] * by_rise
            slopes.append(own)
            by_stress.append(rows[:, 0])
        return np.concatenate(slopes), np.concatenate(by_stress)

    def _missed(self, vector: np.ndarray) -> np.ndarray:
        """Measured less modelled change, (D,), m; NaN: not seen, inf: no equilibrium."""
        found = self._at(vector)
        if found is None:
            return np.full(len(self._change_m), np.inf)
        return self._change_m - np.concatenate([each.change_m for each in found])

    # -- least squares --------------------------------------------------------------------------

    def fit(self) -> Fit:
        """Least squares by the shapes alone.

        Raises InputError: no rubber is near what is seen.
        """
        vector: np.ndarray | None = None
        for q in _STARTS:
            start = np.zeros(self._size)
            start[:2] = q, 1.0
            self._start_from_rest()
            if self._at(start) is None:
                continue
            vector = self._descend(start, None, np.inf, 1.0)
            vector = self._descend(vector, self._scale(vector), np.inf, 1.0)
            if vector[0] > 1.01 * SMALLEST_Q:
                break
        if vector is not None:
            return self._with_errors(vector, np.inf, 1.0)
        raise InputError(
            f"{self._rest.source_name}: no rubber of this shape explains what"
            f" {', '.join(shape.samples.source_name for shape in self._shapes)} shows; check the"
            " gas pressures and the atmospheric pressure"
        )

    def refit(self, alone: Fit, gauge_sigma: float) -> Fit:
        """Least squares with G known otherwise to a relative σ, tempered as by `fit`."""
        scale = self._scale(alone.vector)
        end = self._descend(alone.vector, scale, gauge_sigma, alone.temper)
        return self._with_errors(end, gauge_sigma, alone.temper)

    def _known(self, gauge_sigma: float) -> tuple[np.ndarray, np.ndarray]:
        """Rows of what is known otherwise, G and the gas pressures, and their right sides."""
        rows = np.zeros((1 + len(self._pressure_sigma_pa), self._size))
        rows[0, 1] = 1.0 / gauge_sigma
        rows[1:, self._errors] = np.eye(len(rows) - 1)
        return rows, rows[:, 1]

    def _scale(self, vector: np.ndarray) -> float:
        return max(robust_sigma(self._missed(vector) * self._root, center=0.0), 1e-9)

    def _descend(
        self,
        vector: np.ndarray,
        scale: float | None,  # of residuals, for Tukey's loss; None: least squares, to get near
        gauge_sigma: float,
        temper: float,  # by which all rows count less but those of what is known otherwise
    ) -> np.ndarray:
        root, data = self._root / (scale or self._scale(vector)), len(self._root)
        known, told = self._known(gauge_sigma)

        def residuals(v: np.ndarray) -> np.ndarray:
            z = np.nan_to_num(self._missed(v) * root, nan=_OUTLIER, posinf=np.inf)
            return np.concatenate([z, self._smooth @ v, known @ v - told])

        def jacobian(v: np.ndarray) -> np.ndarray:
            rows = -np.nan_to_num(root)[:, None] * self._slopes(v)[0]
            return np.concatenate([rows, self._smooth, known])

        def loss(squares: np.ndarray) -> np.ndarray:
            rho = np.stack([squares, np.ones_like(squares), np.zeros_like(squares)])
            if scale is not None:
                rho[:, :data] = tukey_loss(squares[:data])
            rho[:, : -len(known)] /= temper
            return rho

        low, high = np.full(self._size, -np.inf), np.full(self._size, np.inf)
        low[:2], high[0] = (SMALLEST_Q, _LEAST_GAUGE), LARGEST_Q
        start, x_scale = vector.copy(), np.ones(self._size)
        start[0] = np.clip(start[0], 1.001 * SMALLEST_Q, 0.999 * LARGEST_Q)
        x_scale[:2] = 0.1
        found: np.ndarray = least_squares(
            residuals, start, jacobian, (low, high), x_scale=x_scale, max_nfev=_MOST_STEPS,
            loss=loss, xtol=_CLOSE, ftol=_CLOSE,  # type: ignore[arg-type]  # loss's name in stubs
        ).x  # fmt: skip
        return found

    # -- errors ---------------------------------------------------------------------------------

    def _with_errors(self, vector: np.ndarray, gauge_sigma: float, temper: float) -> Fit:
        (slopes, by_stress), missed = self._slopes(vector), self._missed(vector)
        scale = self._scale(vector)
        root, z = np.nan_to_num(self._root) / scale, missed * self._root / scale
        rows, z_known = slopes * root[:, None], np.nan_to_num(z)
        weight = tukey_weights(z, 1.0) / temper
        efficiency = float(np.nan_to_num(tukey_slopes(z, 1.0)).sum() / weight.sum() / temper)
        otherwise, told = self._known(gauge_sigma)
        smooth = self._smooth.T @ self._smooth / temper
        prior = smooth + otherwise.T @ otherwise

        def step(weight: np.ndarray) -> np.ndarray:
            """Step of q and G under other weights of the rows of ranges."""
            right = rows.T @ (weight * z_known) - prior @ vector + otherwise.T @ told
            normal = rows.T @ (weight[:, None] * rows) + prior
            return np.linalg.solve(normal, right)[:2]

        by_data = rows.T @ (efficiency * weight[:, None] * rows) + smooth
        inverse = np.linalg.inv(by_data + otherwise.T @ otherwise)[:2]
        influence = (inverse @ (weight * root * slopes.T * root)).T  # of each change, (D, 2)
        known = np.nan_to_num(missed)
        ways = [
            (self._mesh.edge_length * 0.5 * mean_curvature(self._mesh)) ** 2
            * (influence.T @ (self._change_m - known)),
            -self._stress_sigma * (influence.T @ by_stress),
            # shapes tell of μh, whatever share of it is taken for γ0 = (1 − q) μh
            np.array([(1.0 - vector[0]) * self._stress_sigma, 0.0]),
        ]
        for rubber in self._other_rubbers:
            other = self._predicted(vector, rubber(float(vector[0])))
            if other is not None:
                moved = np.concatenate([each.change_m for each in other])
                ways.append(-influence.T @ np.nan_to_num(moved - self._change_m + missed))
        # Uneven rubber, and a surface that is wrong where it is not seen, show as parts of the
        # view that ask for different rubber: the jackknife over them.
        divided = [_parts(self._observer, shape) for shape in self._shapes]
        sets = [np.concatenate(each) for each in zip(*divided, strict=True)]
        for part in sets:
            count = int(part.max()) + 1
            steps = np.stack([step(weight * (part != k)) for k in range(count)])
            share = np.sqrt((count - 1) / count / len(sets)) * student(count - 1)
            ways += list(share * (steps - steps.mean(axis=0)))
        # of the data with what their model gets wrong, which the tempering is for; and of all
        covariance = self._noise(influence, known) + sum(np.outer(way, way) for way in ways)
        white = inverse[1] @ by_data @ inverse[1]
        temper = float(covariance[1, 1] / white)
        covariance = covariance + inverse @ otherwise.T @ otherwise @ inverse.T
        return Fit(vector, covariance, temper)

    @cached_property
    def _other_rubbers(self) -> tuple[Rubber, ...]:
        """Rubber of a smoother stress, and on another surface: what differs is an error."""
        smoother = _rest_rubber(self._mesh, self._slack_m, STRESS_DEGREE - 2)
        return smoother, _rest_rubber(self._other_mesh, self._slack_m)

    def _noise(
        self,
        influence: np.ndarray,  # (D, 2), of every change of range
        missed_m: np.ndarray,  # (D,)
    ) -> np.ndarray:
        """Covariance (2, 2) by noise of all frames, and what the model leaves."""
        ends = np.cumsum([len(shape.change_m) for shape in self._shapes])[:-1]
        own, left = np.split(influence, ends), np.split(missed_m, ends)
        total = self._scored(self._rest, -np.sum(own, axis=0), np.zeros(len(own[0])))
        for shape, of, missed in zip(self._shapes, own, left, strict=True):
            total = total + self._scored(shape.samples, of, missed)
        return total

    def _scored(self, samples: Samples, influence: np.ndarray, missed_m: np.ndarray) -> np.ndarray:
        observer, used = self._observer, np.flatnonzero(influence.any(axis=1))
        seen = [observer.observe(image) for image in samples.depth_m]
        frames = np.stack([np.where(s.weight > 0.0, s.residual_m, np.nan)[used] for s in seen])
        by_tiles, by_frames = cluster_covariances(
            samples.statistics,
            (observer.block_number[used], observer.columns, observer.block),
            frames,
            np.nan_to_num(np.nanmean(frames, axis=0)),
            np.full(len(used), np.inf),
            influence[used],
            missed_m[used],
            2,
        )
        return by_tiles + by_frames


def _seen(observer: RangeObserver, rest: Samples, seen: Samples, *, pressed: bool) -> _SeenShape:
    if seen.statistics.range_m.shape != rest.statistics.range_m.shape:
        raise InputError(
            f"{seen.source_name}: image size differs from {rest.source_name}; record all "
            "levels with one camera mode"
        )
    rise = _mean_pressure(seen)[0] - _mean_pressure(rest)[0]
    steady = seen.statistics.validity >= seen.statistics.regular_validity
    ranges = np.where(steady, seen.statistics.range_m, np.nan)
    found = observer.observe(ranges / seen.camera.range_per_depth)
    shape = _SeenShape(seen, rise, found.residual_m, found.weight, np.zeros(0, int))
    return replace(shape, zone=_dents(observer, shape)) if pressed else shape


def _dents(observer: RangeObserver, shape: _SeenShape) -> np.ndarray:
    """Nodes that are pressed in, as far as something may touch them."""
    mesh, view = observer.mesh, observer.around(observer.mesh.nodes)
    n = len(mesh.nodes)
    outward = sparse.csr_array(
        (mesh.normals.ravel(), np.arange(3 * n), 3 * np.arange(n + 1)), shape=(n, 3 * n)
    )
    by_node = (view.jacobian @ outward.T).tocsr()
    weight, change = shape.weight[view.block], shape.change_m[view.block]
    total = by_node.T @ weight
    moved = np.divide(by_node.T @ (weight * change), total, out=np.zeros(n), where=total > 0.0)
    deviations = moved * np.sqrt((by_node**2).T @ weight)
    laplacian = cotangent_laplacian(mesh).tocsr()
    inward = np.flatnonzero((moved < 0.0) & ~mesh.rim)
    _, part = connected_components(laplacian[inward][:, inward], directed=False)
    zone = np.zeros(n, bool)
    for k in np.unique(part):
        nodes = inward[part == k]
        if deviations[nodes].min() < -SIGNIFICANT:
            zone[nodes] = moved[nodes] < _EDGE_OF_DENT * moved[nodes].min()
    if not zone.any():
        name = shape.samples.source_name
        raise InputError(f"{name}: no dent in the depth images while the gas pressure is high")
    beside = abs(laplacian) @ zone.astype(float) > 0.0
    return np.flatnonzero(zone | (beside & (total == 0.0) & ~mesh.rim))


def _parts(observer: RangeObserver, shape: _SeenShape) -> list[np.ndarray]:
    """Numbers of large parts of the view, (B,) each: rings of a level, sectors of a press."""
    if not len(shape.zone):
        mesh = observer.mesh
        hits = observer.around(mesh.nodes).hits
        height = np.full(len(shape.change_m), -np.inf)
        corners = mesh.nodes[mesh.triangles[hits.triangle], 2]
        height[hits.ray] = np.einsum("ij,ij->i", hits.barycentric, corners)
        return [np.searchsorted(np.quantile(height, np.arange(1, _RINGS) / _RINGS), height)]
    row, column = np.divmod(observer.block_number, observer.columns)
    deepest = int(np.argmin(shape.change_m))
    turn = np.arctan2(row - row[deepest], column - column[deepest]) / (2.0 * np.pi)
    shifts = 0.0, 0.5 / _SECTORS
    return [(np.floor((turn + shift) * _SECTORS) % _SECTORS).astype(int) for shift in shifts]


def _check_rise(shape: _SeenShape, gauge_pa: float, *, pressed: bool) -> None:
    name, rise = shape.samples.source_name, shape.rise_pa
    if pressed and rise < 0.0:
        raise InputError(
            f"{name}: the gas pressure falls by {-rise:.0f} Pa during the press, impossible in a "
            "closed chamber; check the pressure topic, and the chamber for leaks"
        )
    if abs(rise) < _LEAST_RISE * gauge_pa:
        raise InputError(
            f"{name}: its gas pressure differs from that at rest by {rise:.0f} Pa only;"
            + (" press deeper" if pressed else " inflate by 15 % more and less")
        )


def _mean_pressure(samples: Samples) -> tuple[float, float]:
    """Mean absolute gas pressure and its standard error, Pa."""
    gas = samples.gas_pressure_pa
    if gas is None:
        raise InputError(
            f"{samples.source_name}: some frames lack the gas pressure; λ needs it in all frames "
            "of levels and press"
        )
    return float(np.mean(gas)), error_of_mean(gas)
