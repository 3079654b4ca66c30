"""Pre-stretch and gauge pressure by one least-squares problem over everything that tells of them.

The rest surface S0 and its gauge pressure G give the stress at rest by statics, and q = λ⁻⁶ =
1 − γ0/μh the rubber. Under another gas pressure, which differs by a measured Δp, the shape depends
on q, on (G + Δp)/G, and, where something presses, on the contact pressures. Unknown are q, G and
the contact pressures of the nodes that may be touched; an inflation level is a press without any.
Rows are the changes of range from rest, in which fixed errors of camera and mesh cancel, and G as
the sensor file or the open chamber tells it, with its standard deviation.

White noise of a hundred thousand pixels would outweigh that row, though what the model gets wrong
does not average out. So the rows of ranges are tempered: they count as much less as the covariance
of their own estimate is wider with the errors of the model than by noise alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from scipy import sparse
from scipy.optimize import OptimizeResult, least_squares
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from bubbleviz.calibration.contact_free import SIGNIFICANT
from bubbleviz.calibration.errors import (
    covariances,
    frames_block,
    student,
    tile_numbers,
    tile_scores,
    tile_side,
)
from bubbleviz.calibration.rest_frames import Samples
from bubbleviz.calibration.tension import Quantity, TensionEstimate
from bubbleviz.camera import RangeObserver
from bubbleviz.errors import InputError
from bubbleviz.inverse import PRESSURE_SCALE, RIM_SLACK_M
from bubbleviz.membrane import (
    STRESS_DEGREE,
    Factoriser,
    MembraneMesh,
    Prestress,
    RubberMembrane,
    cotangent_laplacian,
    mean_curvature,
    prestressed,
)
from bubbleviz.recordings import (
    TUKEY_TUNING,
    FrameSource,
    error_of_mean,
    robust_sigma,
    tukey_slopes,
    tukey_weights,
)
from bubbleviz.result import HALF_95
from bubbleviz.sensor import WEATHER_SIGMA_PA, Sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.wording import count_of

SMALLEST_Q, LARGEST_Q = 1e-3, 0.97
"""Range of q: λ from 3.2, which is as good as constant tension, to 1.005."""
_STARTS = (0.35, 0.7, 0.05)
"""λ of 1.19 to begin with; 1.06 and 1.65 where that cannot hold the shapes, or slides down to
constant tension, as it may from a gauge pressure that is far too low."""
_LEAST_GAUGE = 0.1  # of the gauge pressure to begin with
_STEP_OF_Q = 1e-3  # relative step of q for the derivative of the forces
_LEAST_RISE = 0.01  # change of the gauge pressure, over itself, below which a shape says nothing
_EDGE_OF_DENT = 0.25
"""Share of a dent's depth beyond which something may touch. The membrane leaves a flat plate that
covers a dome to 0.85 of its radius there; anything smaller or rounder it leaves deeper."""
_RINGS, _SECTORS = 4, 8
"""Parts of the view left out in turn, each large against what errors of the model are alike over:
of equal numbers of blocks between rim and top of a level, around the dent of a press."""
_CLOSE = 1e-4  # relative change of the sum of squares that ends the fit, far below its noise
_NEWTON, _BALANCED = (
    30,
    1e-6,
)  # steps to equilibrium; force left over the load on a node of mean area
_OUTLIER = 10.0  # standard deviations of a block whose ray misses the membrane
_UNEXPLAINED = 0.25  # share of the change of range that rubber may leave unexplained


@dataclass(frozen=True)
class RubberEstimate:
    """What inflation levels, a press and the open chamber tell of the rubber."""

    prestretch: Quantity | None  # λ; None: not determined
    # gauge pressure of the reference surface, Pa; None: not determined, the sensor file's stands
    gauge: Quantity | None
    # by levels and by a press it is weighed with the sensor file's
    gauge_from: Literal["vented", "levels", "press", "given"]
    levels: tuple[str, ...] = ()  # names of the recordings
    press: str = ""  # that of the press, where it was asked; empty where not
    vented: str = ""  # that of the open chamber; empty where there is none
    why_not: str = ""  # why λ is not determined; empty where it is
    # the gauge pressure by the shapes alone, and by the sensor file, Pa; None where not weighed
    both: tuple[Quantity, Quantity] | None = None
    rises_pa: tuple[float, ...] = ()  # pressure of every shape over that of the rest, Pa
    # robust rms of the changes of range, and of what the rubber leaves of them, m
    change_rms_m: float = np.nan
    unexplained_rms_m: float = np.nan

    @property
    def contradicts_file(self) -> bool:
        """Whether the intervals of the gauge pressure by shapes and by the file do not meet."""
        if self.both is None:
            return False
        shapes, file = self.both
        return shapes.low > file.high or shapes.high < file.low

    @property
    def told_by(self) -> Literal["press", "levels"]:
        """What was asked."""
        return "press" if self.press else "levels"

    @property
    def gauge_rests_on(self) -> str:
        """What the gauge pressure comes from, in words."""
        return {
            "vented": f"the open chamber of {self.vented}",
            "levels": f"{self._shapes}; the sensor file",
            "press": f"{self._shapes}; the sensor file",
            "given": "the sensor file's atmospheric pressure",
        }[self.gauge_from]

    @property
    def prestretch_rests_on(self) -> str:
        """What λ comes from, in words."""
        if self.gauge_from in ("levels", "press"):
            return self._shapes
        return f"{self._shapes}; the gauge pressure by {self.gauge_rests_on}"

    @property
    def _shapes(self) -> str:
        if self.levels:
            return f"inflation levels: {', '.join(self.levels)}"
        return f"the press in {self.press}"


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
        fewest = 5  # whose mean and spread say something; chosen
        values = [source[k].gas_pressure_pa for k in range(len(source))]
        known = np.array([value for value in values if value is not None])
        if len(known) < fewest:
            raise InputError(
                f"{source.name}: {count_of(len(known), 'frame')} with a gas pressure; --vented"
                f" needs {fewest}: record the sensor with its chamber open"
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


def estimate_rubber(
    model: SensorModel,  # as identified from `samples`
    samples: Samples,  # of the reference surface
    # for the gauge pressure by the sensor file's atmospheric pressure, or by the open chamber's
    tension: TensionEstimate,
    levels: Sequence[Samples],  # of the untouched sensor at other pressures
    vented: Vented | None = None,
    held: Samples | None = None,  # of a press, which is asked where there are no levels
    *,
    # standard deviation of the gauge pressure by the sensor file, Pa; the weather's where None
    gauge_sigma_pa: float | None,
    other_mesh: MembraneMesh,  # of another surface: what differs on it is an error, too
) -> RubberEstimate | None:
    """λ and gauge pressure; None where there are no levels, no press and no open chamber."""
    if vented is None and not levels and held is None:
        return None
    names = tuple(each.source_name for each in levels)
    press = "" if held is None or levels else held.source_name
    known = RubberEstimate(None, None, "given", names, press)
    gauge, gas = tension.gauge_pressure_pa, samples.gas_pressure_pa
    sigma = gauge_sigma_pa or WEATHER_SIGMA_PA
    if vented is not None:
        if gas is None:
            raise InputError(
                f"{samples.source_name}: no gas pressure, so that {vented.source_name} says nothing"
                " of its gauge pressure; leave --vented out, or record the pressure"
            )
        sigma = float(np.hypot(vented.sigma_pa, error_of_mean(gas)))
        known = replace(
            known,
            gauge=Quantity.normal(gauge, sigma),
            gauge_from="vented",
            vented=vented.source_name,
        )
    if not levels and held is None:
        return replace(known, why_not="no inflation level was recorded")
    try:
        seen = levels or [s for s in (held,) if s is not None]
        problem = _Problem(model, samples, seen, other_mesh, gauge, pressed=not levels)
        stress_sigma = tension.tension.sigma / tension.tension.value
        alone = problem.fit(stress_sigma=stress_sigma)
        fit = problem.fit(sigma / gauge, stress_sigma, alone)
    except InputError as error:
        return replace(known, why_not=str(error))
    by_file = Quantity.normal(gauge, sigma)
    return _judged(alone, fit, by_file, known)


def _judged(
    alone: _Fit,  # by the shapes alone
    fit: _Fit,  # with the gauge pressure that is known otherwise
    by_file: Quantity,
    known: RubberEstimate,
) -> RubberEstimate:
    """What was found with its λ, or what was known before and why nothing was found.

    Gauge pressures by the shapes and by the file that differ by more than both deviations leave
    widen that of the fit by as much, as the Particle Data Group does. Where not even the intervals
    meet one of them is wrong, and the interval holds both. Whether λ is determined is asked at the
    gauge pressure that was found.
    """
    known = replace(
        known,
        rises_pa=fit.rises_pa,
        change_rms_m=fit.change_rms_m,
        unexplained_rms_m=fit.unexplained_rms_m,
    )
    if fit.unexplained_rms_m > _UNEXPLAINED * fit.change_rms_m:
        why = (
            f"rubber of this shape misses by {1e3 * fit.unexplained_rms_m:.2g} mm what changes by"
            f" {1e3 * fit.change_rms_m:.2g} mm"
        )
        return replace(known, why_not=why)
    covariance, found = fit.covariance, known
    if known.gauge is None:
        by_shapes = Quantity.normal(alone.gauge_pa, alone.gauge_sigma_pa)
        found = replace(known, gauge_from=known.told_by, both=(by_shapes, by_file))
        spread = np.hypot(by_shapes.sigma, by_file.sigma)
        apart = abs(by_shapes.value - by_file.value) / spread
        mean_sigma = by_shapes.sigma * by_file.sigma / spread
        sigma = max(fit.gauge_sigma_pa, float(mean_sigma * max(1.0, apart)))
        if found.contradicts_file:
            ends = (abs(each.value - fit.gauge_pa) / HALF_95 for each in (by_shapes, by_file))
            sigma = max(sigma, *ends)
        found = replace(found, gauge=Quantity.normal(fit.gauge_pa, sigma))
        covariance = covariance * (sigma / fit.gauge_sigma_pa) ** 2
    held = fit.covariance[0, 0] - fit.covariance[0, 1] ** 2 / fit.covariance[1, 1]
    q = Quantity.normal(fit.q, float(np.sqrt(max(held, 0.0))))
    if not 0.0 < q.low <= q.high < 1.0:
        what = "press is too shallow" if found.press else "levels differ too little"
        why = f"the {what}, or constant tension explains as much"
        return replace(found, why_not=why)
    wide = Quantity.normal(fit.q, float(np.sqrt(covariance[0, 0])))
    low, high = max(wide.low, SMALLEST_Q), min(wide.high, LARGEST_Q)
    return replace(found, prestretch=Quantity(*(x ** (-1.0 / 6.0) for x in (q.value, high, low))))


class _RestRubber:
    """Rubber whose stress at rest follows from its surface, under a gauge pressure of 1 Pa."""

    def __init__(
        self,
        mesh: MembraneMesh,
        # how far the rim gives, as of `RubberMembrane`: what bends a pressed membrane at its clamp
        rim_slack_m: float | None,
        degree: int = STRESS_DEGREE,
    ) -> None:
        self.mesh, self.rim_slack_m = mesh, rim_slack_m
        self._tension = 1.0 / mean_curvature(mesh)  # γ0, m
        self._stress = _Stress(Prestress.of(mesh, 1.0, degree).on(mesh))

    def tighter(self, share: float) -> _RestRubber:
        """The same with all stress at rest larger by a share, γ0 with it."""
        other = copy(self)
        other._tension = (1.0 + share) * self._tension
        other._stress = _Stress((1.0 + share) * self._stress.tau)
        return other

    def with_q(self, q: float) -> RubberMembrane:
        mu_h = self._tension / (1.0 - q)
        return prestressed(self.mesh, 1.0, mu_h, self._stress, self.rim_slack_m)


class _Stress(Prestress):
    """Stress of one mesh, found once for all q."""

    def __init__(self, tau: np.ndarray) -> None:
        super().__init__(np.zeros((3, 0)))
        object.__setattr__(self, "tau", tau)
        self.tau: np.ndarray

    def on(self, mesh: MembraneMesh) -> np.ndarray:
        return self.tau


class _SeenShape:
    """The membrane under another gas pressure, as the camera sees it: change from rest."""

    def __init__(
        self, observer: RangeObserver, rest: Samples, seen: Samples, *, pressed: bool
    ) -> None:
        self.samples, self.observer = seen, observer
        if seen.statistics.range_m.shape != rest.statistics.range_m.shape:
            raise InputError(
                f"{seen.source_name}: images of another size than {rest.source_name}'s;"
                " record all levels with one camera mode"
            )
        (at_rest, _), (now, sigma) = _mean_pressure(rest), _mean_pressure(seen)
        self.rise_pa, self.rise_sigma_pa = now - at_rest, sigma
        steady = seen.statistics.validity >= seen.statistics.regular_validity
        ranges = np.where(steady, seen.statistics.range_m, np.nan)
        change, weight = block_ranges(observer, (ranges / seen.camera.range_per_depth)[None])
        self.change_m, self.weight = np.nan_to_num(change[0]), weight[0]
        self.zone = self._dents() if pressed else np.zeros(0, int)

    def parts(self) -> list[np.ndarray]:
        """Numbers of large parts of the view, (B,) each: rings of a level, sectors of a press."""
        if not len(self.zone):
            limits = np.quantile(self._heights_m, np.arange(1, _RINGS) / _RINGS)
            return [np.searchsorted(limits, self._heights_m)]
        row, column = np.divmod(self.observer.block_number, self.observer.columns)
        deepest = int(np.argmin(self.change_m))
        turn = np.arctan2(row - row[deepest], column - column[deepest]) / (2.0 * np.pi)
        return [
            (np.floor((turn + shift) * _SECTORS) % _SECTORS).astype(int)
            for shift in (0.0, 0.5 / _SECTORS)
        ]

    @property
    def _heights_m(self) -> np.ndarray:
        """Height over the rim plane of what the blocks see at rest, (B,), m."""
        mesh = self.observer.mesh
        hits = self.observer.around(mesh.nodes).hits
        out = np.full(len(self.change_m), -np.inf)
        corners = mesh.nodes[mesh.triangles[hits.triangle], 2]
        out[hits.ray] = np.einsum("ij,ij->i", hits.barycentric, corners)
        return out

    def _dents(self) -> np.ndarray:
        """Nodes that are pressed in, as far as something may touch them."""
        mesh, view = self.observer.mesh, self.observer.around(self.observer.mesh.nodes)
        n = len(mesh.nodes)
        outward = sparse.csr_array(
            (mesh.normals.ravel(), np.arange(3 * n), 3 * np.arange(n + 1)), shape=(n, 3 * n)
        )
        by_node = (view.jacobian @ outward.T).tocsr()
        weight, change = self.weight[view.block], self.change_m[view.block]
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
            name = self.samples.source_name
            raise InputError(f"{name}: no dent is seen while the gas pressure is high")
        beside = abs(laplacian) @ zone.astype(float) > 0.0
        return np.flatnonzero(zone | (beside & (total == 0.0) & ~mesh.rim))


class _Predicted(NamedTuple):
    """A shape in equilibrium."""

    x: np.ndarray  # (n, 3), m
    inside: float | np.ndarray  # pressure from inside over that from outside, over G
    solve: Callable[[np.ndarray], np.ndarray]  # motions (3n, k) under forces (n, 3, k)
    block: np.ndarray  # (k,) blocks that are seen
    model_m: np.ndarray  # (B,) change of range; NaN of blocks that are not seen
    jacobian: sparse.csr_array  # (k, 3n)


@dataclass(frozen=True)
class _Fit:
    """Where the least squares ended, and how uncertain q and G are there."""

    vector: np.ndarray
    gauge_pa: float
    covariance: (
        np.ndarray
    )  # (2, 2), of q and G over the one to begin with, errors of the model in it
    noise: np.ndarray  # (2, 2), the same if the residuals were white noise
    rises_pa: tuple[float, ...]
    change_rms_m: float
    unexplained_rms_m: float
    scale: float

    @property
    def q(self) -> float:
        return float(self.vector[0])

    @property
    def gauge_sigma_pa(self) -> float:
        return self.gauge_pa / float(self.vector[1]) * float(np.sqrt(self.covariance[1, 1]))


class _Problem:
    """The least squares in q, G over the one to begin with, and contact pressures over G."""

    def __init__(
        self,
        model: SensorModel,
        rest: Samples,
        seen: Sequence[Samples],
        other_mesh: MembraneMesh,
        gauge_pa: float,
        *,
        pressed: bool,
    ) -> None:
        pixels = None if model.pixels is None else replace(model.pixels, line=None)
        model = replace(model, pixels=pixels)  # lines are fitted to the levels themselves
        self._rest, self._gauge_pa, self._other_mesh, self._model = (
            rest,
            gauge_pa,
            other_mesh,
            model,
        )
        self._observer = observer = model.observer()
        self._rubber = _RestRubber(model.mesh, RIM_SLACK_M if pressed else None)
        self._shapes = [_SeenShape(observer, rest, each, pressed=pressed) for each in seen]
        for shape in self._shapes:
            self._check(shape, pressed)
        ends = 2 + np.cumsum([0, *(len(shape.zone) for shape in self._shapes)])
        self._places = [slice(*pair) for pair in pairwise(ends.tolist())]
        self._size = int(ends[-1])
        self._smooth = self._smoothness()
        self._near = [model.mesh.nodes] * len(self._shapes)
        self._factoriser = Factoriser(
            self._rubber.with_q(_STARTS[0]).tangent(model.mesh.nodes, 1.0)
        )
        self._last: tuple[bytes, list[_Predicted] | None] = (b"", None)

    def _check(self, shape: _SeenShape, pressed: bool) -> None:
        name, rise = shape.samples.source_name, shape.rise_pa
        if pressed and rise < 0.0:
            raise InputError(
                f"{name}: the gas pressure falls by {-rise:.0f} Pa in the press, which a closed"
                " chamber's cannot; check its topic, and the chamber for leaks"
            )
        if abs(rise) < _LEAST_RISE * self._gauge_pa:
            raise InputError(
                f"{name}: its gas pressure differs from that at rest by {rise:.0f} Pa only;"
                + (" press deeper" if pressed else " inflate by 15 % more and less")
            )

    def _smoothness(self) -> np.ndarray:
        """Rows of the contact pressures' roughness, (Z, 2 + Z)."""
        rows = np.zeros((self._size - 2, self._size))
        laplacian = cotangent_laplacian(self._observer.mesh).tocsr()
        for shape, place in zip(self._shapes, self._places, strict=True):
            if len(shape.zone):
                dense = laplacian[shape.zone][:, shape.zone].toarray()
                own = slice(place.start - 2, place.stop - 2)
                rows[own, place] = np.linalg.cholesky(dense).T / PRESSURE_SCALE
        return rows

    # -- model ----------------------------------------------------------------------------------

    def _at(self, vector: np.ndarray) -> list[_Predicted] | None:
        """All shapes; None where the rubber has no equilibrium."""
        key = vector.tobytes()
        if self._last[0] != key:
            found = self._predicted(vector, self._rubber, self._observer, self._near)
            if found is not None:
                self._near = [each.x for each in found]
            self._last = key, found
        return self._last[1]

    def _predicted(
        self,
        vector: np.ndarray,
        rubber: _RestRubber,
        observer: RangeObserver,
        near: Sequence[np.ndarray],
    ) -> list[_Predicted] | None:
        membrane, out = rubber.with_q(float(vector[0])), []
        gauge = self._gauge_pa * float(vector[1])
        for shape, place, x in zip(self._shapes, self._places, near, strict=True):
            inside: float | np.ndarray = 1.0 + shape.rise_pa / gauge
            if len(shape.zone):
                contact = np.zeros(len(self._observer.mesh.nodes))
                contact[shape.zone] = vector[place]
                if observer is not self._observer:
                    contact = contact[self._nearest] * ~observer.mesh.rim
                inside = inside - contact
            found = self._balanced(membrane, inside, x, observer)
            if found is None:
                return None
            out.append(found)
        return out

    def _balanced(
        self,
        membrane: RubberMembrane,
        inside: float | np.ndarray,
        x: np.ndarray,
        observer: RangeObserver,
    ) -> _Predicted | None:
        """Newton's method, in steps of a mesh edge at most."""
        mesh, moving = membrane.mesh, membrane.moving
        factoriser = self._factoriser
        if mesh is not self._observer.mesh:
            factoriser = Factoriser(membrane.tangent(x, 1.0))
        for _ in range(_NEWTON):
            left = membrane.residual(x, inside)[moving].ravel()
            try:
                factor = factoriser.factor(membrane.tangent(x, inside).data)
            except RuntimeError:  # singular
                return None
            if np.abs(left).max() < _BALANCED * mesh.areas.mean():
                if np.ndim(inside) == 0 and factor.negative_directions():
                    return None
                break
            motion = np.zeros_like(x)
            motion[moving] = -factor.solve(left).reshape(-1, 3)
            longest = float(np.abs(motion).max())
            if not np.isfinite(longest):
                return None
            x = x + min(1.0, mesh.edge_length / max(longest, 1e-300)) * motion
        else:
            return None

        def solve(forces: np.ndarray) -> np.ndarray:
            out = np.zeros_like(forces)
            right = np.ascontiguousarray(forces[moving].reshape(3 * len(moving), -1))
            out[moving] = factor.solve(right).reshape(-1, *forces.shape[1:])
            return out.reshape(3 * len(x), -1)

        view = observer.around(x)
        seen = np.full(len(view.model_m), np.nan)
        seen[view.block] = view.model_m[view.block]
        return _Predicted(x, inside, solve, view.block, seen, view.jacobian)

    def _slopes(self, vector: np.ndarray) -> list[np.ndarray]:
        """Derivatives of the changes of range, (B, 2 + Z) for each shape, m."""
        found, q = self._at(vector), float(vector[0])
        assert found is not None
        here, ahead = (self._rubber.with_q(each) for each in (q, (1.0 + _STEP_OF_Q) * q))
        gauge, out = self._gauge_pa * float(vector[1]), []
        for shape, place, each in zip(self._shapes, self._places, found, strict=True):
            by_q = here.residual(each.x, each.inside) - ahead.residual(each.x, each.inside)
            area = here.volume_gradient(each.x)
            forces = np.zeros((*each.x.shape, 2 + len(shape.zone)))
            forces[..., 0] = by_q / (_STEP_OF_Q * q)
            forces[..., 1] = -shape.rise_pa / gauge / vector[1] * area
            columns = 2 + np.arange(len(shape.zone))
            forces[shape.zone, :, columns] = -area[shape.zone]
            slopes = np.zeros((len(each.model_m), self._size))
            own = np.r_[0, 1, np.arange(place.start, place.stop)]
            slopes[np.ix_(each.block, own)] = each.jacobian @ each.solve(forces)
            out.append(slopes)
        return out

    def _deviations(self, vector: np.ndarray) -> np.ndarray:
        """Measured less modelled change over the noise of each block; NaN: not seen."""
        found = self._at(vector)
        if found is None:
            return np.full(sum(len(shape.change_m) for shape in self._shapes), np.inf)
        return np.concatenate(
            [
                (shape.change_m - each.model_m) * self._root(shape)
                for shape, each in zip(self._shapes, found, strict=True)
            ]
        )

    @staticmethod
    def _root(shape: _SeenShape) -> np.ndarray:
        """1/σ of each block, NaN where it was not measured."""
        return np.sqrt(np.where(shape.weight > 0.0, shape.weight, np.nan))

    # -- least squares --------------------------------------------------------------------------

    def fit(
        self,
        prior_sigma: float = np.inf,  # of G over the one to begin with
        stress_sigma: float = 0.0,  # relative, of the stress that shape and gauge pressure give
        alone: _Fit | None = None,  # without the prior: where to begin, and how rows are tempered
    ) -> _Fit:
        """Least squares and covariance.

        Raises InputError: no rubber is near what is seen.
        """
        temper = 1.0
        if alone is not None:
            vector, scale = alone.vector, alone.scale
            temper = float(alone.covariance[1, 1] / alone.noise[1, 1])
            vector, scale = self._descend(vector, scale, prior_sigma, temper)
        else:
            vector, scale = self._from_starts()
        return self._with_errors(vector, scale, prior_sigma, temper, stress_sigma)

    def _from_starts(self) -> tuple[np.ndarray, float]:
        slid = None
        for q in _STARTS:
            start = np.zeros(self._size)
            start[:2] = q, 1.0
            self._near = [self._observer.mesh.nodes] * len(self._shapes)
            if self._at(start) is None:
                continue
            vector, scale = self._descend(start, None, np.inf, 1.0)
            if vector[0] > 1.01 * SMALLEST_Q:
                return vector, scale
            slid = slid or (vector, scale)
        if slid is not None:
            return slid
        raise InputError(
            f"{self._rest.source_name}: no rubber of this shape explains what"
            f" {', '.join(shape.samples.source_name for shape in self._shapes)} shows; check the"
            " gas pressures and the atmospheric pressure"
        )

    def _descend(
        self, vector: np.ndarray, scale: float | None, prior_sigma: float, temper: float
    ) -> tuple[np.ndarray, float]:
        """Least squares without outliers' loss to get near, then with Tukey's."""
        for robust in (False, True) if scale is None else (True,):
            z = self._deviations(vector)
            scale = max(robust_sigma(z, center=0.0), 1e-9) if robust or scale is None else scale
            found = self._least_squares(vector, scale, prior_sigma, temper, robust=robust)
            vector = found.x
        z = self._deviations(vector)
        return vector, max(robust_sigma(z, center=0.0), 1e-9)

    def _least_squares(
        self,
        vector: np.ndarray,
        scale: float,
        prior_sigma: float,
        temper: float,
        *,
        robust: bool,
    ) -> OptimizeResult:
        def residuals(v: np.ndarray) -> np.ndarray:
            z = np.nan_to_num(self._deviations(v) / scale, nan=_OUTLIER, posinf=np.inf)
            return np.concatenate([z, self._smooth @ v, [(v[1] - 1.0) / prior_sigma]])

        def jacobian(v: np.ndarray) -> np.ndarray:
            roots = [np.nan_to_num(self._root(shape)) / scale for shape in self._shapes]
            rows = [
                -root[:, None] * slopes for root, slopes in zip(roots, self._slopes(v), strict=True)
            ]
            prior = np.zeros((1, self._size))
            prior[0, 1] = 1.0 / prior_sigma
            return np.concatenate([*rows, self._smooth, prior])

        data = sum(len(shape.change_m) for shape in self._shapes)

        def loss(squares: np.ndarray) -> np.ndarray:
            """Tukey's of the ranges; all but the last row tempered."""
            rho = np.stack([squares, np.ones_like(squares), np.zeros_like(squares)])
            if robust:
                left = 1.0 - np.minimum(squares[:data] / TUKEY_TUNING**2, 1.0)
                rho[0, :data] = TUKEY_TUNING**2 / 3.0 * (1.0 - left**3)
                rho[1, :data], rho[2, :data] = left**2, -2.0 / TUKEY_TUNING**2 * left
            rho[:, :-1] /= temper
            return rho

        low, high = np.full(self._size, -np.inf), np.full(self._size, np.inf)
        low[:2], high[0] = (SMALLEST_Q, _LEAST_GAUGE), LARGEST_Q
        start = vector.copy()
        start[0] = np.clip(start[0], 1.001 * SMALLEST_Q, 0.999 * LARGEST_Q)
        x_scale = np.ones(self._size)
        x_scale[:2] = 0.1
        return least_squares(
            residuals,
            start,
            jacobian,
            (low, high),
            x_scale=x_scale,
            loss=loss,  # type: ignore[arg-type]  # the stub's protocol names its argument
            xtol=_CLOSE,
            ftol=_CLOSE,
            max_nfev=60,
        )

    # -- errors ---------------------------------------------------------------------------------

    def _with_errors(
        self,
        vector: np.ndarray,
        scale: float,
        prior_sigma: float,
        temper: float,
        stress_sigma: float,
    ) -> _Fit:
        found, slopes = self._at(vector), self._slopes(vector)
        if found is None:
            raise InputError(f"{self._rest.source_name}: the rubber found has no equilibrium")
        z = self._deviations(vector)
        roots = np.concatenate([np.nan_to_num(self._root(shape)) for shape in self._shapes]) / scale
        rows = np.concatenate(slopes) * roots[:, None]
        z = z / scale
        system = _System(
            rows,
            np.nan_to_num(z),
            tukey_weights(z, 1.0) / temper,
            float(np.nan_to_num(tukey_slopes(z, 1.0)).sum() / tukey_weights(z, 1.0).sum()),
            self._smooth.T @ self._smooth / temper,
            vector,
            prior_sigma,
        )
        influence = np.split(
            system.gain() * roots[:, None],
            np.cumsum([len(shape.change_m) for shape in self._shapes])[:-1],
        )
        covariance = self._noise(found, influence)
        ways = self._ways(vector, found, slopes, influence, stress_sigma)
        ways.append(system.prior_gain)
        ways += system.left_out(self._parts())
        for way in ways:
            covariance = covariance + np.outer(way, way)
        change = np.concatenate([shape.change_m[shape.weight > 0.0] for shape in self._shapes])
        missed = np.concatenate(
            [shape.change_m - each.model_m for shape, each in zip(self._shapes, found, strict=True)]
        )
        return _Fit(
            vector=vector,
            gauge_pa=self._gauge_pa * float(vector[1]),
            covariance=covariance,
            noise=system.white(),
            rises_pa=tuple(shape.rise_pa for shape in self._shapes),
            change_rms_m=robust_sigma(change, center=0.0),
            unexplained_rms_m=robust_sigma(missed, center=0.0),
            scale=scale,
        )

    def _parts(self) -> list[np.ndarray]:
        """Sets of parts to leave out, numbers of all shapes' blocks."""
        return [
            np.concatenate(each) for each in zip(*(s.parts() for s in self._shapes), strict=True)
        ]

    def _ways(
        self,
        vector: np.ndarray,
        found: list[_Predicted],
        slopes: list[np.ndarray],
        influence: list[np.ndarray],
        stress_sigma: float,
    ) -> list[np.ndarray]:
        """Errors (2,) of q and G by a standard deviation each of what the model is not sure of.

        Stress at rest, its degree, the surface, facets, and the gas pressures. Shapes tell of μh,
        whatever share of it is taken for γ0 = (1 − q) μh.
        """
        mesh, share = self._observer.mesh, 0.01
        facets = (mesh.edge_length * 0.5 * mean_curvature(mesh)) ** 2
        models = [each.model_m for each in found]
        near = [each.x for each in found]

        def moved(other: list[np.ndarray]) -> np.ndarray:
            changes = (np.nan_to_num(b - a) for a, b in zip(models, other, strict=True))
            pairs = zip(influence, changes, strict=True)
            return -np.sum([each.T @ change for each, change in pairs], axis=0)

        ways = [facets * moved([2.0 * each for each in models])]
        ways.append(np.array([(1.0 - vector[0]) * stress_sigma, 0.0]))
        for size, rubber in (
            (stress_sigma / share, self._rubber.tighter(share)),
            (1.0, _RestRubber(mesh, self._rubber.rim_slack_m, STRESS_DEGREE - 2)),
        ):
            other = self._predicted(vector, rubber, self._observer, near)
            if other is not None:
                ways.append(size * moved([each.model_m for each in other]))
        elsewhere = self._on_other_surface(vector, near)
        if elsewhere is not None:
            ways.append(moved(elsewhere))
        by_rise = [
            each.T @ (-vector[1] * slope[:, 1] / shape.rise_pa)
            for shape, slope, each in zip(self._shapes, slopes, influence, strict=True)
        ]
        ways += [-s.rise_sigma_pa * each for s, each in zip(self._shapes, by_rise, strict=True)]
        ways.append(_mean_pressure(self._rest)[1] * np.sum(by_rise, axis=0))
        return ways

    def _on_other_surface(
        self, vector: np.ndarray, near: list[np.ndarray]
    ) -> list[np.ndarray] | None:
        """Changes of range in the same blocks if the rest surface were the other one."""
        mesh, own = self._other_mesh, self._observer
        observer = replace(self._model, mesh=mesh).observer(own.block)
        self._nearest = cKDTree(own.mesh.nodes).query(mesh.nodes)[1]
        start = [mesh.nodes + (x - own.mesh.nodes)[self._nearest] for x in near]
        rubber = _RestRubber(mesh, self._rubber.rim_slack_m)
        found = self._predicted(vector, rubber, observer, start)
        if found is None:
            return None
        common = np.intersect1d(own.block_number, observer.block_number, return_indices=True)
        out = []
        for each in found:
            model = np.full(len(own.block_number), np.nan)
            model[common[1]] = each.model_m[common[2]]
            out.append(model)
        return out

    def _noise(self, found: list[_Predicted], influence: list[np.ndarray]) -> np.ndarray:
        """Covariance (2, 2) by noise of all frames and by what the model leaves, by tiles."""
        nothing = np.zeros(len(influence[0]))
        total = self._scored(self._rest, -np.sum(influence, axis=0), nothing)
        for shape, each, own in zip(self._shapes, found, influence, strict=True):
            missed = np.nan_to_num(shape.change_m - each.model_m)
            total = total + self._scored(shape.samples, own, missed)
        return total

    def _scored(self, samples: Samples, influence: np.ndarray, missed_m: np.ndarray) -> np.ndarray:
        observer, statistics = self._observer, samples.statistics
        used = np.flatnonzero(influence.any(axis=1))
        frames = block_ranges(observer, samples.depth_m)[0][:, used]
        side = tile_side(len(used), statistics.correlation_length_px / observer.block)
        tile = tile_numbers(observer.block_number[used], observer.columns, side)
        mean = np.nan_to_num(np.nanmean(frames, axis=0))
        limit = np.full(len(used), np.inf)
        scores = tile_scores(frames, mean, limit, influence[used], missed_m[used], tile)
        return covariances(*scores, 2, frames_block(statistics)).total


@dataclass(frozen=True)
class _System:
    """The least squares linearised where it ended: rows of ranges, roughness, and G."""

    rows: np.ndarray  # (D, 2 + Z), derivatives of the modelled changes in standard deviations
    missed: np.ndarray  # (D,), measured less modelled
    weight: np.ndarray  # (D,), of the robust loss
    efficiency: float  # mean second derivative of the loss over the mean weight
    smooth: np.ndarray  # (2 + Z, 2 + Z)
    vector: np.ndarray
    prior_sigma: float

    def normal(self, weight: np.ndarray) -> np.ndarray:
        normal: np.ndarray = self.rows.T @ (weight[:, None] * self.rows) + self.smooth
        normal[1, 1] += self.prior_sigma**-2
        return normal

    def gain(self) -> np.ndarray:
        """Change of q and G per change of each row, (D, 2)."""
        weighted = self.weight[:, None] * self.rows
        return np.linalg.solve(self.normal(self.efficiency * self.weight), weighted.T)[:2].T

    @property
    def prior_gain(self) -> np.ndarray:
        """Change of q and G per standard deviation of the G that is known, (2,)."""
        if not np.isfinite(self.prior_sigma):
            return np.zeros(2)
        return np.linalg.inv(self.normal(self.efficiency * self.weight))[:2, 1] / self.prior_sigma

    def white(self) -> np.ndarray:
        """Covariance (2, 2) if residuals were white noise."""
        return np.linalg.inv(self.normal(self.efficiency * self.weight))[:2, :2]

    def left_out(self, parts: list[np.ndarray]) -> list[np.ndarray]:
        """Errors (2,) of a standard deviation each by the jackknife over parts (D,) of the view.

        Uneven rubber, and a surface that is wrong where it is not seen, show as parts that ask for
        different rubber.
        """
        out: list[np.ndarray] = []
        for part in parts:
            count = int(part.max()) + 1
            steps = np.stack([self._step(self.weight * (part != k)) for k in range(count)])
            share = np.sqrt((count - 1) / count / len(parts)) * student(count - 1)
            out += list(share * (steps - steps.mean(axis=0)))
        return out

    def _step(self, weight: np.ndarray) -> np.ndarray:
        """Step of q and G, (2,), under other weights of the rows of ranges."""
        right = self.rows.T @ (weight * self.missed) - self.smooth @ self.vector
        right[1] -= (self.vector[1] - 1.0) / self.prior_sigma**2
        return np.linalg.solve(self.normal(weight), right)[:2]


def block_ranges(observer: RangeObserver, images_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Change of every block's range in z-depth images (F, H, W), (F, B), and its weight."""
    seen = [observer.observe(image) for image in images_m]
    weight = np.stack([each.weight for each in seen])
    change = np.stack([each.residual_m for each in seen])
    return np.where(weight > 0.0, change, np.nan), weight


def _mean_pressure(samples: Samples) -> tuple[float, float]:
    """Mean absolute gas pressure and its standard error, Pa."""
    gas = samples.gas_pressure_pa
    if gas is None:
        raise InputError(
            f"{samples.source_name}: not every frame has its gas pressure recorded; λ needs that of"
            " every level and press"
        )
    return float(np.mean(gas)), error_of_mean(gas)
