"""Least-squares problem for pre-stretch and gauge pressure, from inflation levels or a press.

The rest surface S0 and its gauge pressure G determine the stress at rest by statics, except for a
difference of the tensions along x and y, and their shear, which only the rim holds: a sheet
stretched unequally over its rim has them. q = λ⁻⁶ = 1 − γ0/μh determines the rubber, whose
stiffness μh may change linearly with x and y, and from middle to rim. When the gas pressure changes
by a measured Δp, the shape depends on q, on (G + Δp)/G, on that unequal tension and the gradient,
and in a press on the contact pressures and friction. The unknowns are q, G, the unequal tension,
the gradient, the contact pressures of the nodes in the dent (an inflation level has none), the
amplitudes of friction (see `contact_friction`), and the errors of the gas pressures. The residuals,
each over its standard deviation, are the changes of range from rest, in which fixed errors of
camera and mesh cancel; the differences of G from the sensor file or open chamber, and of unequal
tension, gradient and friction from their prior means; and the pressure errors.

The noise of a hundred thousand pixels averages out, but model errors do not, so the ranges would
outweigh the prior knowledge. So their residuals are tempered: their weight is divided by the ratio
of the variance of G with model errors to that due to noise alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from itertools import pairwise
from typing import TypeVar

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from bubbleviz.calibration.fit_errors import height_rings, jackknife_errors, tile_errors
from bubbleviz.calibration.identification import PRESSURE_ERROR, Identification
from bubbleviz.calibration.rest_frames import FrameSamples, collect
from bubbleviz.calibration.surface import Quantity
from bubbleviz.camera import BlockSquares, RangeObserver, ShapeRanges
from bubbleviz.errors import InputError
from bubbleviz.inverse import FRICTION, PRESSURE_SCALE, RIM_SLACK_M, contact_friction
from bubbleviz.membrane import (
    RUBBER_PARAMETERS,
    STRESS_DEGREE,
    Factor,
    Factoriser,
    MembraneMesh,
    Prestress,
    RubberMembrane,
    cotangent_laplacian,
    mean_curvature,
    prestressed,
    settled,
    stiffness_changes,
)
from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import (
    LAG,
    MIN_FRAMES,
    SIGNIFICANT,
    FrameSource,
    error_of_mean,
    robust_sigma,
    tukey_loss,
    tukey_slopes,
    tukey_weights,
)
from bubbleviz.result import HALF_95
from bubbleviz.sensor import Sensor

SMALLEST_Q, LARGEST_Q = 1e-3, 0.97
"""Range of q: λ from 3.2, which differs little from constant tension, to 1.005."""
_INITIAL_Q = (0.35, 0.7, 0.05)
"""λ of 1.19; then 1.06 and 1.65, if the shapes have no equilibrium or the fit runs to constant
tension, as it may if the gauge pressure is far too low."""
_MIN_GAUGE = 0.1  # over the initial or the found gauge pressure
_UNEQUAL_SIGMA = 1.0 / 6.0
"""Standard deviation of both parts of the unequal tension of a flat sheet. One stretched by small
e₁ and e₂ has (T₁ − T₂)/(T₁ + T₂) = (e₁ − e₂)/(3 (e₁ + e₂)). It is slack nowhere, so e₁, e₂ ≥ 0, and
both parts lie in a circle of radius 1/3; the distribution over it is taken as uniform. At λ of 1.2,
σ is a difference of 11 % between the stretches. How equally hands stretch a sheet is not known."""
_GRADIENT_SIGMA = 0.1
"""Standard deviation of a gradient, which is half the range of stiffness over the membrane. In ISO
3302-1 a moulded thickness of 1 mm has a tolerance of ±0.10 (M1), ±0.15 (M2) or ±0.40 mm (M3); ±0.2
is taken as the 95 % interval."""
_RUBBER, _MATERIAL = [0, 2, 3, 4, 5, 6], 7
"""Indices of q, unequal tension and gradient among the unknowns, and number of unknowns before the
contact pressures; index 1 is G over its initial value."""
_UNEQUAL = [2, 3]
_NAMES = [name for name in RUBBER_PARAMETERS if name != "sheet_share"]
"""Parameters in the sensor file of the unknowns `_RUBBER`."""
_FRICTIONS = 4  # amplitudes of `contact_friction`
_NO_NODES = np.zeros(0, int)
_STEP = 1e-3  # of q, relative, of unequal tension and gradient, for derivatives of the forces
_MIN_RISE = 0.01  # smallest relative change of the gauge pressure that determines anything
_EDGE_OF_DENT = 0.25
"""Share of a dent's largest depth beyond which nodes may be in contact. The contact edge of a flat
plate that covers a dome to 0.85 of its radius is at this depth; that of smaller or rounder objects
is deeper."""
_TOLERANCE = 3e-4  # relative change of the sum of squares that ends the fit, far below its noise
_MAX_EVALUATIONS = 60
_PRESSURE_STEP = 10.0
"""Scale of contact pressures in the trust region's norm, in gauge pressures: the first step, from
no contact to some hundred nodes with up to a few gauge pressures, is then not shortened."""
_OUTLIER = 10.0  # residual, in standard deviations, of a block whose ray misses the membrane

T = TypeVar("T")
Rubber = Callable[..., RubberMembrane]
"""The membrane at a gauge pressure of 1 Pa as a function of q, unequal tension in x, xy, and
gradient in x, y, r."""


def _rest_rubber(
    mesh: MembraneMesh,
    slack_m: float | None,  # as in `RubberMembrane`
    # stress at rest of a film, as of `Prestress.on`, and of unequal tension
    film: np.ndarray,
    unequal: np.ndarray,
) -> Rubber:
    tension, changes = 1.0 / mean_curvature(mesh), stiffness_changes(mesh)  # γ0, m

    def rubber(q: float, *values: float) -> RubberMembrane:
        mu_h = tension / (1.0 - q) * (1.0 + changes @ values[2:])
        stress = film + np.tensordot(values[:2], unequal, 1)
        return prestressed(mesh, 1.0, mu_h, stress, slack_m)

    return rubber


def _film_stress(mesh: MembraneMesh, degree: int = STRESS_DEGREE) -> np.ndarray:
    """The stress in equilibrium that is closest to a film of uniform tension."""
    return Prestress.of(mesh, 1.0, degree).on(mesh)


Shape = tuple[ShapeRanges, Factor]
"""Ranges of a shape in equilibrium, and the factor of its tangent stiffness."""


class RubberProblem:
    """Least squares in q, G, unequal tension, gradient, contact, friction, gas pressure errors.

    G is relative to its initial value, contact pressures to G, and the errors of the gas pressures
    of rest and shapes to their standard deviations.

    Raises InputError: a shape without gas pressure, with too small a change of it, or without dent.
    """

    def __init__(
        self,
        found: Identification,  # without rubber
        shapes: Sequence[FrameSamples],  # levels, or one press
        level_sigma_pa: float | None,  # of gas pressure differences between recordings
        *,
        pressed: bool,
    ) -> None:
        # the rectification is itself fitted to the levels
        model = replace(found.model, pixels=replace(found.pixels, line=None))
        self._observer = observer = model.observer()
        self._surfaces, self._rest, self._mesh = found.surfaces, found.samples, found.mesh
        rest, mesh = self._rest, self._mesh
        self._gauge_pa = gauge_pa = found.gauge.value
        self._stress_sigma = found.surfaces.stress_sigma
        # a press bends the membrane at its clamped rim
        self._slack_m = RIM_SLACK_M if pressed else None
        film, sheet = Prestress.of(mesh, 1.0), self._surfaces.flat_sheet
        fields = self._surfaces.unequal.values()
        self._unequal = np.stack([each.on(mesh) for each in fields])
        # an equally stretched sheet, inflated over an oval rim, is tighter across the oval
        self._of_sheet = np.zeros(2)
        if sheet is not None:
            basis = np.stack([each.weights.ravel() for each in fields], axis=1)
            excess = (sheet[0].weights - film.weights).ravel()
            self._of_sheet = np.linalg.lstsq(basis, excess, rcond=None)[0]
        # prior means of G to gradient; those of the unequal tension are between film and sheet
        self._means = np.array([1.0, *0.5 * self._of_sheet, 0.0, 0.0, 0.0])
        rubber = _rest_rubber(mesh, self._slack_m, film.on(mesh), self._unequal)
        self._rubber = lru_cache(maxsize=1 + len(_RUBBER))(rubber)
        self._shapes, self._pressed = shapes, pressed
        pressures = np.array([_mean_pressure(each) for each in (rest, *shapes)])
        self.rises_pa = tuple((pressures[1:, 0] - pressures[0, 0]).tolist())
        for each, rise_pa in zip(shapes, self.rises_pa, strict=True):
            _check_rise(each.source_name, rise_pa, gauge_pa, pressed=pressed)
        # (S, B), change of the range of each block in every shape, m, and its 1/σ²
        measured = [_change(observer, rest, each) for each in shapes]
        self._change_m, weight = (np.stack(each) for each in zip(*measured, strict=True))
        self._root = np.sqrt(np.where(weight > 0.0, weight, np.nan))  # 1/σ of each block
        # nodes of every shape that may be in contact
        self._zones = [
            _dent_nodes(observer, change, precision, each.source_name) if pressed else _NO_NODES
            for change, precision, each in zip(self._change_m, weight, shapes, strict=True)
        ]
        ends = _MATERIAL + np.cumsum([0, *map(len, self._zones)])
        self._places = [slice(*pair) for pair in pairwise(ends.tolist())]
        self._friction = slice(int(ends[-1]), int(ends[-1]) + (_FRICTIONS if pressed else 0))
        self._errors = slice(self._friction.stop, self._friction.stop + 1 + len(shapes))
        self._size = self._errors.stop
        if level_sigma_pa is None:
            level_sigma_pa = PRESSURE_ERROR * (gauge_pa + max(0.0, *self.rises_pa))
        self._pressure_sigma_pa = np.hypot(pressures[:, 1], 0.0 if pressed else level_sigma_pa)
        # residuals that penalise rough contact pressures
        self._smooth = np.zeros((self._friction.start - _MATERIAL, self._size))
        laplacian = cotangent_laplacian(mesh).tocsr()
        for zone, place in zip(self._zones, self._places, strict=True):
            if len(zone):
                root = np.linalg.cholesky(laplacian[zone][:, zone].toarray()).T
                self._smooth[place.start - _MATERIAL :][: len(zone), place] = root / PRESSURE_SCALE
        self._start_from_rest()
        tangent = self._rubber(_INITIAL_Q[0], *self._means[1:]).tangent(mesh.nodes, 1.0)
        self._factoriser = Factoriser(tangent)
        # shapes, None where the rubber has no equilibrium, and slopes of the last vector
        self._shapes_at, self._slopes = _kept(self._solved), _kept(self._differentiated)

    def _start_from_rest(self) -> None:
        """Start the next equilibrium solve at rest, without friction."""
        self._initial: Sequence[Shape | None] = [None] * len(self._shapes)
        count = self._friction.stop - self._friction.start
        # at amplitudes of 1, over G; 0 until a contact pressure is found
        self._friction_forces = np.zeros((len(self._mesh.nodes), 3, count))

    @property
    def change_rms_m(self) -> float:
        """Robust rms of the measured changes of range, m."""
        return robust_sigma(self._change_m[np.isfinite(self._root)], center=0.0)

    # -- model ----------------------------------------------------------------------------------

    def _solved(self, vector: np.ndarray) -> list[Shape] | None:
        found = self._predicted(vector, self._rubber(*vector[_RUBBER].tolist()))
        if found is not None:
            self._initial = found
        return found

    def _predicted(self, vector: np.ndarray, membrane: RubberMembrane) -> list[Shape] | None:
        moved, out = membrane.mesh.nodes - self._mesh.nodes, []
        added = -self._friction_forces @ vector[self._friction]
        for pressure, last in zip(self._pressures(vector), self._initial, strict=True):
            x, factor = (self._mesh.nodes, None) if last is None else (last[0].nodes_m, last[1])
            own = self._factoriser, pressure, x + moved, factor, added
            equilibrium = settled(membrane, *own)
            if equilibrium is None:
                return None
            x, factor = equilibrium
            out.append((self._observer.around(x, last and last[0]), factor))
        return out

    def _changes(self, found: Sequence[Shape], at_rest_m: float | np.ndarray = 0.0) -> np.ndarray:
        """Changes of range from rest, (S, B), m; NaN: block not visible."""
        change = np.full(self._change_m.shape, np.nan)
        for row, (view, _) in zip(change, found, strict=True):
            row[view.block] = (view.model_m - at_rest_m)[view.block]
        return change

    def _pressures(self, vector: np.ndarray) -> list[float | np.ndarray]:
        """Pressure inside minus outside over G of each shape, per node where it is in contact."""
        gauge_pa, out = self._gauge_pa * float(vector[1]), []
        for zone, place, rise_pa in zip(
            self._zones, self._places, self._rises_pa(vector), strict=True
        ):
            pressure: float | np.ndarray = 1.0 + rise_pa / gauge_pa
            if len(zone):
                pressure = np.full(len(self._mesh.nodes), pressure)
                pressure[zone] -= vector[place]
            out.append(pressure)
        return out

    def _rises_pa(self, vector: np.ndarray) -> list[float]:
        """Gas pressures of the shapes minus that at rest, corrected by their errors."""
        off = self._pressure_sigma_pa * vector[self._errors]
        return [rise + error - off[0] for rise, error in zip(self.rises_pa, off[1:], strict=True)]

    def _differentiated(self, vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the changes by the unknowns (S·B, N), and by the stress at rest (S·B,)."""
        found, values = self._shapes_at(vector), vector[_RUBBER]
        assert found is not None
        rubber = self._rubber(*values.tolist())
        steps = _STEP * np.where(np.arange(len(values)) == 0, values, 1.0)
        stepped = [self._rubber(*(values + step).tolist()) for step in np.diag(steps)]
        # columns by the pressure, and after those by friction, by contact pressures
        last = 1 + len(stepped)
        first = last + 1 + self._friction_forces.shape[2]  # by contact pressures
        rest_force, slopes, by_stress = rubber.force(rubber.mesh.nodes), [], []
        gauge_pa, rises_pa = self._gauge_pa * vector[1], self._rises_pa(vector)
        error, moving = np.arange(self._size)[self._errors], rubber.moving
        for k, (zone, place, pressure, (view, factor)) in enumerate(
            zip(self._zones, self._places, self._pressures(vector), found, strict=True)
        ):
            x = view.nodes_m
            area = rubber.volume_gradient(x)
            residual = rubber.residual(x, pressure)
            forces = np.zeros((*x.shape, first + len(zone)))
            forces[..., 0] = rest_force - rubber.force(x)
            for j, (other, step) in enumerate(zip(stepped, steps, strict=True), start=1):
                forces[..., j] = (residual - other.residual(x, pressure)) / step
            forces[..., last] = area / gauge_pa
            forces[..., last + 1 : first] = self._friction_forces
            forces[zone, :, first + np.arange(len(zone))] = -area[zone]
            motions = np.zeros_like(forces)
            right = np.ascontiguousarray(forces[moving].reshape(3 * len(moving), -1))
            motions[moving] = factor.solve(right).reshape(len(moving), 3, -1)
            rows = np.zeros((self._observer.blocks, motions.shape[2]))
            rows[view.block] = view.jacobian @ motions.reshape(3 * len(x), -1)
            of_shape = np.zeros((len(rows), self._size))
            by_rise = rows[:, last]  # per pascal
            of_shape[:, _RUBBER] = rows[:, 1:last]
            of_shape[:, 1] = -rises_pa[k] / vector[1] * by_rise
            of_shape[:, self._friction] = rows[:, last + 1 : first]
            of_shape[:, place] = rows[:, first:]
            of_shape[:, error[0]] = -self._pressure_sigma_pa[0] * by_rise
            of_shape[:, error[1 + k]] = self._pressure_sigma_pa[1 + k] * by_rise
            slopes.append(of_shape)
            by_stress.append(rows[:, 0])
        return np.concatenate(slopes), np.concatenate(by_stress)

    def _residuals(self, vector: np.ndarray) -> np.ndarray:
        """Measured minus modelled change, (S, B), m; NaN: not visible, inf: no equilibrium."""
        found = self._shapes_at(vector)
        if found is None:
            return np.full(self._change_m.shape, np.inf)
        return self._change_m - self._changes(found)

    # -- least squares --------------------------------------------------------------------------

    def fit(self, gauge_sigma: float) -> tuple[np.ndarray, np.ndarray, float] | None:
        """Least squares over the shapes alone, and with a prior of relative σ on G.

        Returns for both fits q, G over its initial value, unequal tension and gradient, (2, 7), and
        covariances with model errors, (2, 7, 7); and the robust rms residual of the second, m.
        None: no rubber has an equilibrium at these pressures.
        """
        if (start := self._alone()) is None:
            return None
        alone, others_m, temper = start
        covariance, _ = self._covariance(alone, others_m, np.inf, temper)
        gain = covariance[0, 1] / (covariance[1, 1] + gauge_sigma**2)  # of q by the prior on G
        square = covariance[0, 0] - gain * covariance[0, 1]
        # by the largest stretch in the interval
        self._expect(alone[0] + gain * (1.0 - alone[1]) - HALF_95 * np.sqrt(max(square, 0.0)))
        vector = self._minimise(alone, self._scale(alone), gauge_sigma, temper)
        both = np.stack([alone[:_MATERIAL], vector[:_MATERIAL]])
        with_prior, _ = self._covariance(vector, others_m, gauge_sigma, temper)
        unexplained = robust_sigma(self._residuals(vector), center=0.0)
        return both, np.stack([covariance, with_prior]), unexplained

    def _alone(self) -> tuple[np.ndarray, list[np.ndarray], float] | None:
        """Fit without a prior on G, errors by other models near it, and the tempering.

        None: no equilibrium.
        """
        found: tuple[np.ndarray, list[np.ndarray], float] | None = None
        for q in _INITIAL_Q:
            start = np.zeros(self._size)
            start[:_MATERIAL] = q, *self._means
            self._expect(q)
            self._start_from_rest()
            if self._shapes_at(start) is None:
                continue
            vector = self._minimise(start, None, np.inf, 1.0)
            others_m = self._other_models(vector)
            temper = self._covariance(vector, others_m, np.inf, 1.0)[1]
            expected = vector[0]
            self._expect(expected)
            if self._pressed:
                self._add_friction(vector)
            vector = self._minimise(vector, self._scale(vector), np.inf, temper)
            found = vector, others_m, temper
            kept = self._friction_forces, expected
            if found[0][0] > 1.01 * SMALLEST_Q:
                break
        if found is not None:  # a later start may have had no equilibrium
            self._friction_forces, expected = kept
            self._expect(expected)
            self._shapes_at, self._slopes = _kept(self._solved), _kept(self._differentiated)
        return found

    def _add_friction(self, vector: np.ndarray) -> None:
        """Set the forces of friction to those of a press found without it.

        On simulated presses, setting them again from the next fit changes λ by 0.002.
        """
        found, ((zone,), (place,)) = self._shapes_at(vector), (self._zones, self._places)
        assert found is not None
        x, touching = found[0][0].nodes_m, vector[place] > 0.0
        nodes, pressure = zone[touching], vector[place][touching]
        area = self._rubber(*vector[_RUBBER].tolist()).volume_gradient(x)
        if len(nodes):
            self._friction_forces[nodes] = contact_friction(x[nodes], area[nodes], pressure)
        self._shapes_at, self._slopes = _kept(self._solved), _kept(self._differentiated)

    def _expect(self, q: float) -> None:
        """Set the standard deviation of the unequal tension by the stretch λ = q^(−1/6).

        A flat sheet may be stretched unequally before it is inflated, not by inflation, and a
        moulded dome has no such stretch: its λ is less than a flat sheet needs for its area.
        """
        stretch = np.clip(q, SMALLEST_Q, LARGEST_Q) ** (-1.0 / 6.0)
        by_inflation = np.sqrt(self._mesh.facet_areas.sum() / self._mesh.facet_vectors[:, 2].sum())
        part = np.clip((stretch - by_inflation) / (stretch - 1.0), 0.01, 1.0)  # 0 is singular
        self._unequal_sigma = np.hypot(part * _UNEQUAL_SIGMA, self._of_sheet / np.sqrt(12.0))

    def _priors(self, gauge_sigma: float) -> tuple[np.ndarray, np.ndarray]:
        """Rows and right sides of the priors on all but q and contact pressures."""
        sigma, mean = np.ones(self._size), np.zeros(self._size)
        sigma[1:_MATERIAL] = gauge_sigma, *self._unequal_sigma, *3 * [_GRADIENT_SIGMA]
        mean[1:_MATERIAL] = self._means
        known = [*range(1, _MATERIAL), *range(self._size)[self._friction.start :]]
        sigma[self._friction] = FRICTION
        rows = np.diag(1.0 / sigma)[known]
        return rows, rows @ mean

    def _scale(self, vector: np.ndarray) -> float:
        return max(robust_sigma(self._residuals(vector) * self._root, center=0.0), 1e-9)

    def _minimise(
        self,
        vector: np.ndarray,
        scale: float | None,  # of residuals, for Tukey's loss; None: plain least squares
        gauge_sigma: float,
        temper: float,  # divides the weight of all rows but the priors
    ) -> np.ndarray:
        from scipy.optimize import least_squares  # 0.1 s: not at the window's start

        root, data = self._root / (scale or self._scale(vector)), self._root.size
        tolerance = _TOLERANCE if scale else 1e-2  # plain least squares are a start for Tukey's
        priors, prior_values = self._priors(gauge_sigma)

        # In q and log G the curved valley of shapes that fit almost as well is straight.
        def of(u: np.ndarray) -> np.ndarray:
            return np.concatenate([u[:1], np.exp(u[1:2]), u[2:]])

        def residuals(u: np.ndarray) -> np.ndarray:
            v = of(u)
            z = np.nan_to_num(self._residuals(v) * root, nan=_OUTLIER, posinf=np.inf)
            return np.concatenate([z.ravel(), self._smooth @ v, priors @ v - prior_values])

        def jacobian(u: np.ndarray) -> np.ndarray:
            v = of(u)
            rows = -np.nan_to_num(root).reshape(-1, 1) * self._slopes(v)[0]
            slopes = np.concatenate([rows, self._smooth, priors])
            slopes[:, 1] *= v[1]
            return slopes

        def loss(squares: np.ndarray) -> np.ndarray:
            rho = np.stack([squares, np.ones_like(squares), np.zeros_like(squares)])
            if scale is not None:
                rho[:, :data] = tukey_loss(squares[:data])
            rho[:, : -len(priors)] /= temper
            return rho

        low, high = np.full(self._size, -np.inf), np.full(self._size, np.inf)
        low[:2], high[0] = (SMALLEST_Q, np.log(_MIN_GAUGE)), LARGEST_Q
        limits = np.array([RUBBER_PARAMETERS[name] for name in _NAMES[1:]])
        low[2:_MATERIAL], high[2:_MATERIAL] = limits.T
        start, x_scale = vector.copy(), np.ones(self._size)
        start[0] = np.clip(start[0], 1.001 * SMALLEST_Q, 0.999 * LARGEST_Q)
        start[1] = np.log(start[1])
        x_scale[:_MATERIAL] = 0.1, 0.1, *2 * [_UNEQUAL_SIGMA], *3 * [_GRADIENT_SIGMA]
        x_scale[_MATERIAL : self._friction.start] = _PRESSURE_STEP
        found = least_squares(
            residuals, start, jacobian, (low, high), x_scale=x_scale, max_nfev=_MAX_EVALUATIONS,
            loss=loss, xtol=tolerance, ftol=tolerance,  # type: ignore[arg-type]  # loss's name in stubs
        ).x  # fmt: skip
        return of(found)

    # -- errors ---------------------------------------------------------------------------------

    def _covariance(
        self,
        vector: np.ndarray,
        others_m: list[np.ndarray],  # as of `_other_models`, of a vector near it
        gauge_sigma: float,
        temper: float,
    ) -> tuple[np.ndarray, float]:
        """Covariance of the material, and variance of G by the shapes over that by white noise."""
        (slopes, by_stress), residuals = self._slopes(vector), self._residuals(vector).ravel()
        root, change_m = self._root.ravel() / self._scale(vector), self._change_m.ravel()
        root, z = np.nan_to_num(root), residuals * root
        rows, z_known = slopes * root[:, None], np.nan_to_num(z)
        weight = tukey_weights(z, 1.0) / temper
        efficiency = float(np.nan_to_num(tukey_slopes(z, 1.0)).sum() / weight.sum() / temper)
        priors, prior_values = self._priors(gauge_sigma)
        smooth = self._smooth.T @ self._smooth / temper
        prior = smooth + priors.T @ priors
        # Friction acts in one part of the view, and without that part it would be unknown.
        common = np.delete(np.arange(self._size), self._friction)

        def step(weight: np.ndarray) -> np.ndarray:
            """Step of the material under other weights of the range residuals, friction held."""
            right = rows.T @ (weight * z_known) - prior @ vector + priors.T @ prior_values
            normal = rows.T @ (weight[:, None] * rows) + prior
            return np.linalg.solve(normal[common][:, common], right[common])[:_MATERIAL]

        by_data = rows.T @ (efficiency * weight[:, None] * rows) + smooth
        inverse = np.linalg.inv(by_data + priors.T @ priors)[:_MATERIAL]
        influence = (inverse @ (weight * root * slopes.T * root)).T  # of each change, (D, 7)
        known = np.nan_to_num(residuals)
        errors = [  # (7,) each, of the material, by one source of error
            (self._mesh.edge_length * 0.5 * mean_curvature(self._mesh)) ** 2
            * (influence.T @ (change_m - known)),
            -self._stress_sigma * (influence.T @ by_stress),
            # shapes determine μh, so an error of γ0 = (1 − q) μh is one of q
            (1.0 - vector[0]) * self._stress_sigma * np.eye(_MATERIAL)[0],
            *(influence.T @ other for other in others_m),
        ]
        # With uneven rubber, or a wrong surface where it is hidden, parts of the view are fitted
        # best by different rubber: the jackknife over them estimates this error.
        rings, squares = (
            np.tile(part, len(self._shapes))
            for part in (
                height_rings(self._observer),
                BlockSquares(self._observer.block_number, self._observer.columns).of_block,
            )
        )
        errors += list(jackknife_errors(lambda kept: step(weight * kept), rings))
        errors += list(tile_errors(influence, known, squares, _MATERIAL))
        # of the shapes with their model errors, for the tempering; then with the priors' errors
        covariance = np.transpose(errors) @ errors
        white = inverse[1] @ by_data @ inverse[1]
        temper = float(covariance[1, 1] / white)
        covariance = covariance + inverse @ priors.T @ priors @ inverse.T
        # model errors may count more in the unequal tension than what is expected of it
        both, most = (_UNEQUAL, _UNEQUAL), self._unequal_sigma**2
        covariance[both] = np.minimum(covariance[both], most)
        return covariance, temper

    def _other_models(self, vector: np.ndarray) -> list[np.ndarray]:
        """Errors of the modelled changes, (S·B,), m, due to errors of stress and surface."""
        # Stress at rest follows from curvature. On simulated round sheets and domes a fitted cap
        # moves G by −2 %, and the free form by +2 and −4 % (by 0 without noise).
        mesh, other = self._mesh, self._surfaces.other_mesh
        at_rest_m = self._observer.around(other.nodes).model_m
        rubber = partial(_rest_rubber, slack_m=self._slack_m, unequal=self._unequal)
        modelled_m = self._change_m - self._residuals(vector)
        found = (
            (self._predicted(vector, of_film(*vector[_RUBBER].tolist())), at_rest_m)
            for of_film, at_rest_m in (
                (rubber(mesh, film=_film_stress(mesh, STRESS_DEGREE - 2)), 0.0),
                (rubber(other, film=_film_stress(other)), at_rest_m),
            )
        )
        return [
            np.nan_to_num(modelled_m - self._changes(shapes, at_rest_m)).ravel()
            for shapes, at_rest_m in found
            if shapes is not None
        ]


def _kept(compute: Callable[[np.ndarray], T]) -> Callable[[np.ndarray], T]:
    """The same function of a vector of floats, keeping its last result."""
    last = lru_cache(maxsize=1)(lambda key: compute(np.frombuffer(key)))
    return lambda vector: last(vector.tobytes())


def _change(
    observer: RangeObserver, rest: FrameSamples, samples: FrameSamples
) -> tuple[np.ndarray, np.ndarray]:
    """Change of the range of each block from rest, (B,), m, and its 1/σ², 0 where unknown."""
    if samples.statistics.range_m.shape != rest.statistics.range_m.shape:
        raise InputError(
            f"{samples.source_name}: image size differs from that of the frames at rest; record "
            "all with one resolution"
        )
    steady = samples.statistics.validity >= samples.statistics.regular_validity
    ranges = np.where(steady, samples.statistics.range_m, np.nan)
    found = observer.observe(ranges / samples.camera.range_per_depth)
    return found.residual_m, found.weight


def _dent_nodes(
    observer: RangeObserver, change_m: np.ndarray, weight: np.ndarray, name: str
) -> np.ndarray:
    """Nodes deep enough in a dent to be in contact, by the change of each block (B,)."""
    mesh, view = observer.mesh, observer.around(observer.mesh.nodes)
    n = len(mesh.nodes)
    outward = sparse.csr_array(
        (mesh.normals.ravel(), np.arange(3 * n), 3 * np.arange(n + 1)), shape=(n, 3 * n)
    )
    by_node = (view.jacobian @ outward.T).tocsr()
    weight, change = weight[view.block], change_m[view.block]
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
        raise InputError(
            f"{name}: no dent in the depth images while the gas pressure is high; press in view "
            "of the camera, or check the pressure topic"
        )
    adjacent = abs(laplacian) @ zone.astype(float) > 0.0
    hidden = total == 0.0
    return np.flatnonzero(zone | (adjacent & hidden & ~mesh.rim))


def _check_rise(name: str, rise: float, gauge_pa: float, *, pressed: bool) -> None:
    if pressed and rise < 0.0:
        raise InputError(
            f"{name}: the gas pressure falls by {-rise:.0f} Pa during the press, impossible in a "
            "closed chamber; check the pressure topic, and the chamber for leaks"
        )
    if abs(rise) < _MIN_RISE * gauge_pa:
        kind = "press" if pressed else "level"
        raise InputError(
            f"{name}: the gas pressure of the {kind} differs by only {rise:.0f} Pa from that at "
            f"rest, less than {100 * _MIN_RISE:.0f} % of the gauge pressure"
        )


def _mean_pressure(samples: FrameSamples) -> tuple[float, float]:
    """Mean absolute gas pressure and its standard error, Pa."""
    gas = samples.gas_pressure_pa
    if gas is None:
        raise InputError(
            f"{samples.source_name}: some frames lack the gas pressure, which λ needs; record it "
            "in all frames at rest, of levels and of the press"
        )
    return float(np.mean(gas)), error_of_mean(gas)


# Pre-stretch and gauge pressure from inflation levels, a press and the open chamber.


_MAX_UNEXPLAINED = 0.25  # largest share of the change of range that the rubber model may not fit


_HOLD_SHARE = 0.9  # of the largest rise of the gas pressure: above it, a press counts as held
_PRESS_RISE = 10.0  # of the gas pressure by a press, in standard deviations


def collect_press(
    source: FrameSource, samples: FrameSamples, sensor: Sensor, progress: Progress = quiet
) -> FrameSamples | None:
    """Frames of the highest gas pressure after the contact-free ones.

    None if there are fewer than five, or if no press raises the pressure by ten times its noise.
    The first frames are left out: a camera's temporal filter still mixes earlier images into them.
    """
    free, pressures = samples.gas_pressure_pa, []
    if free is None:
        return None
    later = range(max(samples.frames) + 1, len(source))
    for k in later:
        pressures.append(source[k].gas_pressure_pa)
        progress("finding the press", (k - later.start) / len(later))
    rise = np.array(pressures, float) - np.median(free)  # NaN: not measured
    highest = np.nanmax(rise, initial=-np.inf)
    if highest < _PRESS_RISE * max(robust_sigma(free), 1e-9):
        return None
    held = rise > _HOLD_SHARE * highest
    frames = [later[k] for k in np.flatnonzero(held[LAG:] & held[:-LAG]) + LAG]
    return collect(source, sensor, frames, progress) if len(frames) >= MIN_FRAMES else None


def with_rubber(
    found: Identification,
    levels: Sequence[FrameSamples],  # of the untouched sensor at other pressures
    press: FrameSamples | None = None,  # used where there are no levels
    # standard deviation of gas pressure differences between recordings, Pa; None: of a typical
    # pressure sensor
    level_sigma_pa: float | None = None,
) -> Identification:
    """Identification with λ and gauge pressure from levels or a press."""
    shapes = levels or ([] if press is None else [press])
    if not shapes:
        return found
    found = replace(found, shapes_kind="levels" if levels else "press")
    try:
        return _fitted(found, shapes, level_sigma_pa)
    except InputError as error:
        return replace(found, why_not=str(error))


def _fitted(
    found: Identification,
    shapes: Sequence[FrameSamples],  # levels, or a press
    level_sigma_pa: float | None,
) -> Identification:
    """The same with gauge pressure and parameters of the rubber, or why they are not determined.

    Raises InputError: as `RubberProblem`.
    """
    names, kind, file = ", ".join(s.source_name for s in shapes), found.shapes_kind, found.gauge
    source = f"the press in {names}" if kind == "press" else f"inflation levels: {names}"
    problem = RubberProblem(found, shapes, level_sigma_pa, pressed=kind == "press")
    fit = problem.fit(file.sigma / file.value)
    change, rises = problem.change_rms_m, problem.rises_pa
    unexplained = change if fit is None else fit[2]
    known = replace(found, rises_pa=rises, change_rms_m=change, unexplained_rms_m=unexplained)
    if fit is None or unexplained > _MAX_UNEXPLAINED * change:
        misfit = f", misfit {1e3 * unexplained:.2g} of {1e3 * change:.2g} mm rms" if fit else ""
        why_not = f"no rubber of this shape at rest explains the change to {names}{misfit}"
        # where levels are close, noise alone may exceed that limit, but rubber explains the most
        contradict = kind == "levels" and unexplained**2 > 0.5 * change**2
        return replace(known, levels_contradict=contradict, why_not=why_not)
    values, covariances, _ = fit
    if values[1, 1] < 1.01 * _MIN_GAUGE:  # a limit of the fit
        less = f"{_MIN_GAUGE * file.value:.0f} Pa or less"
        return replace(known, why_not=f"the {kind} fit best a gauge pressure at rest of {less}")
    if found.vented is not None:
        source = f"{source}; the gauge pressure from {file.source}"
        return _with_parameters(known, values[1], covariances[1], 1.0, source)
    shapes_alone, both = (
        Quantity.normal(file.value * share, file.value * float(np.sqrt(square)), source)
        for share, square in zip(values[:, 1].tolist(), covariances[:, 1, 1], strict=True)
    )
    known = replace(known, gauge_candidates=(shapes_alone, file))
    sigma = _sigma_of_mean(known, both)
    gauge = Quantity.normal(both.value, sigma, f"{source}; {file.source}")
    wider, known = sigma / both.sigma, replace(known, gauge=gauge)
    return _with_parameters(known, values[1], covariances[1], wider, source)


def _with_parameters(
    known: Identification,  # with the gauge pressure found
    values: np.ndarray,  # (7,), q, G over the initial one, unequal tension and gradient
    covariance: np.ndarray,  # (7, 7)
    wider: float,  # σ of the gauge pressure found over that of the covariance
    source: str,
) -> Identification:
    """The same with the parameters of the rubber, or the reason why λ is not determined.

    An interval that reaches λ = 1 ends there, and one that contains constant tension ends at the
    largest λ: rubber with the best λ is nearer to the truth than either of them. The gauge
    pressure G and q, which determines λ, can change together and fit almost as well, along a curve
    between straight lines in G and in log G (on an oval of uneven thickness, from 3 to 10 kPa,
    dq/dG falls from 0.07 to 0.04 per kPa and dq/dlog G rises from 0.24 to 0.37). So each end of
    the interval of q follows from the line farther away.
    """
    kind, q = known.shapes_kind, float(values[0])
    slope = float(covariance[0, 1] / covariance[1, 1])  # of q over G, along that curve
    at_gauge = HALF_95 * float(np.sqrt(max(covariance[0, 0] - slope * covariance[0, 1], 0.0)))
    if q < 1.01 * SMALLEST_Q:
        return replace(known, why_not=f"the {kind} fit a constant tension best")
    if q > 0.99 * LARGEST_Q:
        return replace(known, why_not=f"the {kind} fit λ = 1 best, a sheet without tension")
    low, high = (end / known.gauge.value for end in (known.gauge.low, known.gauge.high))
    by_gauge = slope * values[1] * np.array([np.log(max(low, _MIN_GAUGE)), high - 1.0])
    least = max(q - float(np.hypot(wider * at_gauge, by_gauge.min())), SMALLEST_Q)
    most = min(q + float(np.hypot(wider * at_gauge, by_gauge.max())), 1.0)
    value, low, high = (x ** (-1.0 / 6.0) for x in (q, most, least))
    sigmas = np.sqrt(np.diag(covariance))
    rubber = {
        name: Quantity.normal(float(values[k]), float(sigmas[k]), source).possible(
            *RUBBER_PARAMETERS[name]
        )
        for name, k in zip(_NAMES, _RUBBER, strict=True)
    } | {"prestretch": Quantity(value, low, high, source)}
    return replace(known, rubber=rubber, why_not="")


def _sigma_of_mean(known: Identification, mean: Quantity) -> float:
    """Standard deviation of the mean of the gauge pressures from shapes and sensor file, Pa.

    Model errors are the same in every recording and may have the sign of the file's error. So in
    the weighted mean the two errors add linearly, not in quadrature. If the two gauge pressures
    differ by more than their standard deviations, the interval is widened as by the Particle Data
    Group. If their 95 % intervals do not overlap, one is wrong, and the interval covers both.
    """
    assert known.gauge_candidates is not None
    shapes, file = known.gauge_candidates
    spread = np.hypot(shapes.sigma, file.sigma)
    apart = abs(shapes.value - file.value) / spread
    mean_sigma = shapes.sigma * file.sigma / spread
    linear_sum = (shapes.sigma + file.sigma) / spread
    sigma = max(mean.sigma, float(mean_sigma * max(linear_sum, apart)))
    if known.contradicts_file:
        ends = (shapes.low, shapes.high, file.low, file.high)
        sigma = max(sigma, *(abs(end - mean.value) / HALF_95 for end in ends))
    return sigma
