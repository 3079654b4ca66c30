"""Pre-stretch and gauge pressure from a held press whose gas pressure was measured.

Where nothing touches, the membrane is in equilibrium: its shape depends on q = λ⁻⁶ and, as that
of an inflation level does, on the ratio (G + Δp)/G, with a measured Δp. In the dent any contact
pressure is allowed, which is fitted along. What is left to q and G is the membrane around it: how
wide the dent is tells of q, how far the gas bulges the rest of it of G. Fitted is how the range
changes from the contact-free frames, in which fixed errors of the camera cancel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.special import ndtri, stdtrit

from bubbleviz.calibration.bootstrap import (
    DRAWS,
    draw_errors,
    frames_block,
    score_table,
    tile_numbers,
    tile_side,
)
from bubbleviz.calibration.contact_free import SIGNIFICANT
from bubbleviz.calibration.rest_frames import Samples
from bubbleviz.calibration.rubber_fit import LARGEST_Q, LEAST_RISE, SMALLEST_Q, STEP_OF_Q, RubberFit
from bubbleviz.camera import RangeObserver
from bubbleviz.errors import InputError
from bubbleviz.inverse import PRESSURE_SCALE, RIM_SLACK_M, LinearisedRubber
from bubbleviz.membrane import (
    Factoriser,
    Prestress,
    RubberMembrane,
    cotangent_laplacian,
    mean_curvature,
    prestressed,
)
from bubbleviz.recordings import error_of_mean, robust_sigma, tukey_weights
from bubbleviz.sensor_model import SensorModel

_EDGE_OF_DENT = 0.25
"""Share of a dent's depth beyond which something may touch. The membrane leaves a flat plate that
covers a dome to 0.85 of its radius there; anything smaller or rounder it leaves deeper."""
_START = 0.35  # q to begin with: λ of 1.19
_STEPS, _LONGEST, _NEAR = 100, 1.0, 0.25
"""Gauss–Newton steps; in mesh edges the longest, and the one from which on q and G move too."""
_SLOW, _LEAST = 0.7, 0.25
"""A step longer than this share of the one before oscillates: the next is halved,
down to the second."""
_LARGEST_STEP = 0.2  # largest step of q and of ln G
_SMALL = 5e-4  # step of q and ln G that ends it: far below their intervals
_SECTORS = 8  # around the dent: each large against what errors of the model are alike over


@dataclass(frozen=True)
class PressFit(RubberFit):
    """What a press says."""

    # gauge pressure from each third of the frames, and from each half of the membrane at the λ of
    # all of it
    gauge_by_part_pa: dict[str, float]


@dataclass(frozen=True)
class _State:
    """Shape, pressures and rubber on the way to the fit."""

    x: np.ndarray  # (n, 3), m
    pressure: np.ndarray  # (n,), contact pressure over G
    q: float
    gauge_pa: float


@dataclass(frozen=True)
class _Linear:
    """The fit linearised at a state, over the pressures of the zone and then q and ln G."""

    seen: np.ndarray  # (k,) int, blocks
    rows: np.ndarray  # (k, z + 2), derivatives of their range change, m
    missed_m: np.ndarray  # (k,), measured less modelled change, the latter at equilibrium
    weight: np.ndarray  # (k,), 1/m²
    motions: np.ndarray  # (3n, z + 2)
    relaxing: np.ndarray  # (3n,), motion to equilibrium, m
    by_stress_m: np.ndarray  # (k,), change of the ranges per relative change of the stress at rest


class HeldPress:
    """A press, and the contact-free frames before it."""

    def __init__(
        self,
        model: SensorModel,  # as identified from those
        # rest, held: with gas pressures
        rest: Samples,
        held: Samples,
    ) -> None:
        if rest.gas_pressure_pa is None or held.gas_pressure_pa is None:
            raise InputError(f"{held.source_name}: not every frame of the press has a gas pressure")
        self.source_name = held.source_name
        self._model, self._mesh, self._rest, self._held = model, model.mesh, rest, held
        self._gas = rest.gas_pressure_pa, held.gas_pressure_pa
        self._rise = float(np.mean(self._gas[1]) - np.mean(self._gas[0]))
        self._observer = model.observer()
        self._rest_m, self._held_m = (
            _ranges(self._observer, each.depth_m)[0] for each in (rest, held)
        )
        mean_depth = held.statistics.range_m / held.camera.range_per_depth
        change, weight = _ranges(self._observer, mean_depth[None])
        self._change_m, self._weight = np.nan_to_num(change[0]), weight[0]
        self._laplacian = cotangent_laplacian(model.mesh).tocsr()
        self._zone = self._dents()
        self._tension = 1.0 / mean_curvature(model.mesh)  # over the gauge pressure, 1 Pa here
        self._stress = Prestress.of(model.mesh, 1.0)
        self._factoriser = Factoriser(self._rubber(_START).tangent(model.mesh.nodes, 1.0))
        smooth = self._laplacian[self._zone][:, self._zone].toarray() / PRESSURE_SCALE**2
        self._prior = np.zeros((len(self._zone) + 2,) * 2)
        self._prior[:-2, :-2] = smooth

    def fit(
        self,
        gauge_pressure_pa: float,  # G, or where to begin
        gauge_sigma_pa: float | None = None,  # its standard deviation where it is known
        # relative standard deviation of the stress that shape and gauge pressure give
        stress_sigma: float = 0.0,
    ) -> PressFit:
        """Fit λ⁻⁶ and, where it is not known, the gauge pressure.

        Raises InputError: the gas pressure fell, which no press of a closed chamber does, or rose
        too little, or no rubber is near the press.
        """
        if self._rise < 0.0:
            raise InputError(
                f"{self.source_name}: the gas pressure falls by {-self._rise:.0f} Pa in the press,"
                " which a closed chamber's cannot; check its topic, and the chamber for leaks"
            )
        if self._rise < LEAST_RISE * gauge_pressure_pa:
            raise InputError(
                f"{self.source_name}: the press changes the gas pressure by {self._rise:.0f} Pa"
                " only; press deeper"
            )
        free = np.ones(len(self._zone) + 2, bool)
        free[-1] = gauge_sigma_pa is None
        state, linear = self._solve(gauge_pressure_pa, free)
        influence = self._influence(linear, free)
        halves = self._by_half(linear, state, free)
        thirds = self._by_third(linear, influence)
        ways = self._systematic(linear, influence, state.q, stress_sigma)
        ways = np.concatenate([ways, self._by_sector(linear, state, free)])
        rng = np.random.default_rng([0, 2])
        errors = self._noise(linear, influence)
        errors += rng.standard_normal((DRAWS, len(ways))) @ ways
        if gauge_sigma_pa is not None:
            errors[:, 1] = gauge_sigma_pa / state.gauge_pa * rng.standard_normal(DRAWS)
            errors[:, 0] -= errors[:, 1] * (influence[:, 0] @ linear.rows[:, -1])
        return PressFit(
            q=state.q,
            gauge_pressure_pa=state.gauge_pa,
            q_errors=errors[:, 0],
            gauge_errors_pa=state.gauge_pa * errors[:, 1],
            rms_m=robust_sigma(linear.missed_m, center=0.0),
            change_rms_m=robust_sigma(self._change_m[linear.seen], center=0.0),
            rises_pa=(self._rise,),
            gauge_by_part_pa={
                name: state.gauge_pa * float(np.exp(moved[1]))
                for name, moved in (thirds | halves).items()
            },
        )

    # -- the fit --------------------------------------------------------------------------------

    def _solve(self, gauge_pa: float, free: np.ndarray) -> tuple[_State, _Linear]:
        mesh = self._mesh
        state = _State(mesh.nodes, np.zeros(len(mesh.nodes)), _START, gauge_pa)
        contact = free & (np.arange(len(free)) < len(self._zone))
        settled, before, share = False, np.inf, 1.0
        try:
            for _ in range(_STEPS):
                linear = self._linearised(state, settled)
                step = self._step(linear, state, free if settled else contact)
                motion = (linear.relaxing + linear.motions @ step).reshape(-1, 3)
                moved = float(np.abs(motion).max())
                if settled and np.abs(step[-2:]).max() < _SMALL:
                    return state, linear
                share = max(_LEAST, 0.5 * share) if moved > _SLOW * before else 1.0
                state = self._moved(state, share * step, share * motion)
                before = moved
                settled = settled or moved < _NEAR * mesh.edge_length
        except RuntimeError:  # a singular tangent
            pass
        raise InputError(
            f"{self.source_name}: no rubber of this shape explains the press; check the gas"
            " pressures and the atmospheric pressure"
        )

    def _moved(self, state: _State, step: np.ndarray, motion: np.ndarray) -> _State:
        longest = max(float(np.abs(motion).max()), 1e-300)
        share = min(1.0, _LONGEST * self._mesh.edge_length / longest)
        share = min(share, _LARGEST_STEP / max(float(np.abs(step[-2:]).max()), 1e-300))
        pressure = state.pressure.copy()
        pressure[self._zone] += share * step[:-2]
        q = float(np.clip(state.q + share * step[-2], SMALLEST_Q, LARGEST_Q))
        gauge = state.gauge_pa * float(np.exp(share * step[-1]))
        return _State(state.x + share * motion, pressure, q, gauge)

    def _linearised(self, state: _State, robust: bool) -> _Linear:
        """Ranges and equilibrium at a state; robust weights where the shape is near already."""
        membrane, ahead = self._rubber(state.q), self._rubber((1.0 + STEP_OF_Q) * state.q)
        tighter = self._rubber(state.q, 1.0 + STEP_OF_Q)
        x, rise = state.x, self._rise / state.gauge_pa
        inside = 1.0 + rise - state.pressure
        rubber = LinearisedRubber(membrane, self._factoriser, x, inside, 0.0)
        left = membrane.residual(x, inside)
        by_q, by_stress = (
            (left - other.residual(x, inside)) / STEP_OF_Q for other in (ahead, tighter)
        )
        forces = np.stack([-left, by_q / state.q, -rise * rubber.area_vectors, by_stress], axis=2)
        relaxing, *others = rubber.motion(forces).reshape(-1, 4).T
        motions = np.column_stack([-rubber.responses(self._zone), *others[:2]])
        view = self._observer.around(x)
        weight = self._weight[view.block]
        missed = self._change_m[view.block] - view.model_m[view.block]
        missed -= view.jacobian @ relaxing
        z = missed * np.sqrt(weight)
        scale = max(robust_sigma(z[weight > 0.0], center=0.0), 1e-9)
        if robust:
            weight = weight * tukey_weights(z, scale)
        return _Linear(
            seen=view.block,
            rows=view.jacobian @ motions,
            missed_m=missed,
            weight=weight / scale**2,
            motions=motions,
            relaxing=relaxing,
            by_stress_m=view.jacobian @ others[2],
        )

    def _step(
        self, linear: _Linear, state: _State, free: np.ndarray, part: np.ndarray | None = None
    ) -> np.ndarray:
        """Gauss–Newton step of pressures, q and ln G, 0 for what is not free; by a part (k,)."""
        weight = linear.weight if part is None else linear.weight * part
        right = linear.rows.T @ (weight * linear.missed_m)
        right[:-2] -= self._prior[:-2, :-2] @ state.pressure[self._zone]
        step = np.zeros(len(free))
        step[free] = np.linalg.solve(self._normal(linear, weight, free), right[free])
        return step

    def _normal(self, linear: _Linear, weight: np.ndarray, free: np.ndarray) -> np.ndarray:
        rows = linear.rows[:, free]
        normal: np.ndarray = rows.T @ (weight[:, None] * rows) + self._prior[np.ix_(free, free)]
        return normal

    def _rubber(self, q: float, tighter: float = 1.0) -> RubberMembrane:
        stress = Prestress(tighter * self._stress.weights)
        mu_h = tighter * self._tension / (1.0 - q)
        return prestressed(self._mesh, 1.0, mu_h, stress, RIM_SLACK_M)

    # -- where something may touch --------------------------------------------------------------

    def _dents(self) -> np.ndarray:
        """Nodes that are pressed in, as far as something may touch them."""
        mesh, view = self._mesh, self._observer.around(self._mesh.nodes)
        n = len(mesh.nodes)
        outward = sparse.csr_array(
            (mesh.normals.ravel(), np.arange(3 * n), 3 * np.arange(n + 1)), shape=(n, 3 * n)
        )
        by_node = (view.jacobian @ outward.T).tocsr()
        weight, change = self._weight[view.block], self._change_m[view.block]
        certainty = (by_node**2).T @ weight
        total = by_node.T @ weight
        moved = np.divide(by_node.T @ (weight * change), total, out=np.zeros(n), where=total > 0.0)
        deviations = moved * np.sqrt(certainty)
        inward = np.flatnonzero((moved < 0.0) & ~mesh.rim)
        _, part = connected_components(self._laplacian[inward][:, inward], directed=False)
        zone = np.zeros(n, bool)
        for k in np.unique(part):
            nodes = inward[part == k]
            if deviations[nodes].min() < -SIGNIFICANT:
                zone[nodes] = moved[nodes] < _EDGE_OF_DENT * moved[nodes].min()
        if not zone.any():
            raise InputError(f"{self.source_name}: no dent is seen while the gas pressure is high")
        beside = abs(self._laplacian) @ zone.astype(float) > 0.0
        return np.flatnonzero(zone | (beside & (total == 0.0) & ~mesh.rim))

    # -- errors ---------------------------------------------------------------------------------

    def _influence(self, linear: _Linear, free: np.ndarray) -> np.ndarray:
        """Change of q and ln G per change of every block's range, (k, 2), 1/m."""
        influence = np.zeros((len(free), len(linear.seen)))
        weighted = (linear.weight[:, None] * linear.rows[:, free]).T
        influence[free] = np.linalg.solve(self._normal(linear, linear.weight, free), weighted)
        return influence[-2:].T

    def _noise(self, linear: _Linear, influence: np.ndarray) -> np.ndarray:
        """Errors (R, 2) by noise of all frames and by what the model leaves, by tiles."""
        none = np.zeros(len(linear.seen))
        held = self._drawn(self._held, self._held_m, linear.seen, influence, linear.missed_m, 0)
        return held + self._drawn(self._rest, self._rest_m, linear.seen, -influence, none, 1)

    def _drawn(
        self,
        samples: Samples,
        frames_m: np.ndarray,
        seen: np.ndarray,
        influence: np.ndarray,
        missed_m: np.ndarray,
        seed: int,
    ) -> np.ndarray:
        frames_m = frames_m[:, seen]
        side = tile_side(len(seen), samples.statistics.correlation_length_px / self._observer.block)
        tile = tile_numbers(self._observer.block_number[seen], self._observer.columns, side)
        mean, limit = np.nanmean(frames_m, axis=0), np.full(len(seen), np.inf)
        table = score_table(frames_m, mean, limit, influence, missed_m, tile, parameters=2)
        return draw_errors(table, frames_block(samples.statistics), seed).total

    def _systematic(
        self, linear: _Linear, influence: np.ndarray, q: float, stress_sigma: float
    ) -> np.ndarray:
        """Errors (4, 2) of a standard deviation each: gas pressure, stress at rest, γ0, facets.

        Shapes tell of μh, whatever share of it is taken for γ0 = (1 − q) μh.
        """
        mesh = self._mesh
        gas = float(np.linalg.norm([error_of_mean(each) for each in self._gas])) / self._rise
        facets = (mesh.edge_length * 0.5 * mean_curvature(mesh)) ** 2
        modelled = self._change_m[linear.seen] - linear.missed_m
        return np.stack(
            [
                gas * (influence.T @ linear.rows[:, -1]),
                stress_sigma * (influence.T @ linear.by_stress_m),
                np.array([(1.0 - q) * stress_sigma, 0.0]),
                facets * (influence.T @ modelled),
            ]
        )

    def _by_sector(self, linear: _Linear, state: _State, free: np.ndarray) -> np.ndarray:
        """Errors (s, 2) of a standard deviation each by whatever the model gets wrong.

        The jackknife over sectors around the dent, each of which leaves the others dent and bulge
        enough to tell q from G; over two sets of sectors, turned by half of one.
        """
        row, column = self._places(linear)
        deepest = int(np.argmin(self._change_m[linear.seen]))
        angle = np.arctan2(row - row[deepest], column - column[deepest]) / (2.0 * np.pi)
        left_out = [
            np.floor((angle + k / (2.0 * _SECTORS)) * _SECTORS) % _SECTORS == 0.0
            for k in range(2 * _SECTORS)
        ]
        moved = np.stack([self._step(linear, state, free, ~each)[-2:] for each in left_out])
        spread = np.sqrt(0.5 * (_SECTORS - 1) / _SECTORS) * moved
        return spread * float(stdtrit(_SECTORS - 1, 0.975) / ndtri(0.975))

    def _by_half(self, linear: _Linear, state: _State, free: np.ndarray) -> dict[str, np.ndarray]:
        """By how much ln G of half of the membrane alone differs from that of all, at its λ."""
        row, column = self._places(linear)
        free = free & (np.arange(len(free)) != len(free) - 2)
        out = {}
        for where, names in ((column, ("left", "right")), (row, ("upper", "lower"))):
            second = where > np.median(where)
            for name, part in zip(names, (~second, second), strict=True):
                out[f"{name} half"] = self._step(linear, state, free, part)[-2:]
        return out

    def _places(self, linear: _Linear) -> tuple[np.ndarray, np.ndarray]:
        """Row and column of the blocks that are seen, (k,)."""
        row, column = np.divmod(self._observer.block_number[linear.seen], self._observer.columns)
        return row, column

    def _by_third(self, linear: _Linear, influence: np.ndarray) -> dict[str, np.ndarray]:
        """By how much (q, ln G) of a third of the frames differ from those of all of them."""
        usual = np.nanmean(self._held_m, axis=0)
        thirds = np.array_split(np.arange(len(self._held_m)), 3)
        out = {}
        for name, frames in zip(("first", "second", "last"), thirds, strict=True):
            change = np.nan_to_num(np.nanmean(self._held_m[frames], axis=0) - usual)
            rise = float(np.mean(self._gas[1][frames]) - np.mean(self._gas[0]))
            change = change[linear.seen] + (rise / self._rise - 1.0) * linear.rows[:, -1]
            out[f"{name} third"] = influence.T @ change
        return out


def _ranges(observer: RangeObserver, images_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Change of every block's range in z-depth images (F, H, W), (F, B), and its weight."""
    seen = [observer.observe(image) for image in images_m]
    weight = np.stack([each.weight for each in seen])
    change = np.stack([each.residual_m for each in seen])
    return np.where(weight > 0.0, change, np.nan), weight
