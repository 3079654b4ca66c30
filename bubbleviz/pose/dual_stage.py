"""Both stages on one frame, from a prediction or from the best of some starts."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bubbleviz.frames.frame import Frame
from bubbleviz.inverse.estimator import Estimator
from bubbleviz.inverse.rubber_estimator import RubberEstimator
from bubbleviz.membrane.refine import refine
from bubbleviz.pose.contact_points import ContactPoints
from bubbleviz.pose.motion_filter import SEARCH_DEVIATION, Motion
from bubbleviz.pose.observability import directions
from bubbleviz.pose.pressed_membrane import PressedMembrane
from bubbleviz.pose.registration import Fit, Prior, Registration
from bubbleviz.pose.rigid_motion import motion_between, moved
from bubbleviz.pose.sliding import Sliding
from bubbleviz.result import Pose, Stage

FOUND_FITNESS = 0.7
"""Share of the patch that must lie on an object that nobody said was there."""

_CLOSE_M = 2e-3
_FAR_M = 5e-3
"""How far off a prediction, and a start, may be."""

_TRACKING, _CONVERGING, _LOOKING = 3, 12, 6
"""Iterations of each stage while tracking, from a start, and to compare starts."""

_SLIDES = 3
"""Steps in the directions that contact leaves open, at most."""

_FINE_NODES = 2_500
"""Nodes that follow the outline of an object; a mesh with fewer is refined."""


@dataclass(frozen=True)
class Solution:
    """A pose of one frame.

    Attributes
    ----------
    first, pose : Fit
        Stage one and stage two.
    ms : (float, float)
        Wall time of the stages.
    motion : Motion
        Pose and velocity with what this frame adds.
    """

    first: Fit
    pose: Fit
    ms: tuple[float, float]
    motion: Motion

    def as_pose(self, contact: ContactPoints) -> Pose:
        """What consumers see."""
        found = directions(self.pose.surface, contact.radius_m)
        return Pose(
            status="ok",
            T_B_O=self.pose.T_B_O,
            stage_one=_stage(self.first, self.ms[0]),
            stage_two=_stage(self.pose, self.ms[1]),
            center_m=contact.center,
            covariance=self.motion.covariance[:6, :6],
            motions=found.motions,
            deviation_m=found.deviation_m,
            determined=found.determined,
            points_m=contact.points,
            places_m=self.pose.places_m,
            distance_m=self.pose.distance_m,
        )


def _stage(fit: Fit, ms: float) -> Stage:
    return Stage(fit.T_B_O, fit.fitness, fit.rmse_m, fit.correspondences, fit.history, ms)


class Solver:
    """Runs the stages.

    Parameters
    ----------
    registration : Registration
    estimator : Estimator or RubberEstimator
    """

    def __init__(self, registration: Registration, estimator: Estimator | RubberEstimator) -> None:
        self._registration, self._estimator = registration, estimator

    @cached_property
    def _sliding(self) -> Sliding:
        """The membrane under the object; built when a face first lies flat."""
        own = self._estimator
        mesh = refine(own.mesh) if len(own.mesh.nodes) < _FINE_NODES else own.mesh
        gas = own.gas.behind(mesh)
        pressed = PressedMembrane(mesh, gas, own.scales, self._registration.model)
        return Sliding(own.observer, pressed)

    def forget(self) -> None:
        """Begin anew, with nothing kept of where the object was."""
        if "_sliding" in vars(self):
            self._sliding.forget()

    def solve(
        self,
        frame: Frame,
        contact: ContactPoints,
        predicted: Motion,
        *,
        settled: bool,
    ) -> Solution:
        """Both stages from a prediction, which `settled` says is close."""
        iterations = _TRACKING if settled else _CONVERGING
        prior = Prior(predicted.T_B_O, predicted.information)
        began = time.perf_counter()
        first = self._registration.stage_one(
            contact,
            predicted.T_B_O,
            prior,
            widest_m=_CLOSE_M if settled else _FAR_M,
            iterations=iterations,
        )
        between = time.perf_counter()
        second = self._registration.stage_two(contact, first.T_B_O, prior, iterations=iterations)
        if self._registration.model.creases is not None:
            second = self._slid(frame, contact, second, prior, settled)
        motion = predicted.corrected(second.T_B_O, second.surface + second.outline)
        times = (1e3 * (between - began), 1e3 * (time.perf_counter() - between))
        return Solution(first, second, times, motion)

    def best(
        self,
        frame: Frame,
        contact: ContactPoints,
        starts: np.ndarray,
        finalists: int,
    ) -> Solution | None:
        """Both stages from those of the starts (s, 4, 4) that fit best; None where none does."""
        motions = [Motion.at_rest(start, SEARCH_DEVIATION, contact.center) for start in starts]
        looks = [
            self._registration.stage_one(
                contact, m.T_B_O, Prior(m.T_B_O, m.information), iterations=_LOOKING
            ).T_B_O
            for m in motions
        ]
        costs = [self._registration.misfit(contact, T) for T in looks]
        found = [
            self.solve(
                frame,
                contact,
                Motion.at_rest(looks[k], SEARCH_DEVIATION, contact.center),
                settled=False,
            )
            for k in np.argsort(costs)[:finalists]
        ]
        good = [solution for solution in found if solution.pose.fitness >= FOUND_FITNESS]
        return min(good, key=lambda solution: solution.pose.cost, default=None)

    def _slid(
        self, frame: Frame, contact: ContactPoints, fit: Fit, prior: Prior, settled: bool
    ) -> Fit:
        """The fit, moved in the directions that contact normals leave open."""
        found = directions(fit.surface, contact.radius_m)
        if found.determined.all():
            return fit
        T = fit.T_B_O
        if settled:  # where it is on its face is for the depth image to say, not the blurred patch
            way = np.linalg.solve(found.motions, motion_between(prior.T_B_O, T, contact.center))
            T = moved(prior.T_B_O, found.motions @ (way * found.determined), contact.center)
        for _ in range(_SLIDES):
            pull = prior.information @ motion_between(prior.T_B_O, T, contact.center)
            known = fit.surface + prior.information
            step = self._sliding.step(frame.depth_m, contact, T, found, known, pull)
            T = moved(T, step.motion, contact.center)
            if step.ended:
                break
        return self._registration.slid(contact, fit, T, step.information)
