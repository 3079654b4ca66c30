"""Both stages on one frame, from a prediction or from the best of some starts."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bubbleviz.frames.frame import Frame
from bubbleviz.inverse.estimator import Estimator
from bubbleviz.pose.contact import ContactPoints
from bubbleviz.pose.filter import SEARCH_DEVIATION, Motion
from bubbleviz.pose.motion import moved
from bubbleviz.pose.pressed import PressedMembrane
from bubbleviz.pose.registration import Fit, Prior, Registration
from bubbleviz.pose.sliding import Viewer, slide
from bubbleviz.pose.uncertainty import directions
from bubbleviz.result import Estimate, Pose, Stage

FOUND_FITNESS = 0.7
"""Share of the patch that must lie on an object that nobody said was there."""

_CLOSE_M = 2e-3
_FAR_M = 5e-3
"""How far off a prediction, and a start, may be."""

_TRACKING, _CONVERGING, _LOOKING = 3, 12, 6
"""Iterations of each stage while tracking, from a start, and to compare starts."""


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
    estimator : Estimator
    """

    def __init__(self, registration: Registration, estimator: Estimator) -> None:
        self._registration, self._estimator = registration, estimator

    @cached_property
    def _pressed(self) -> PressedMembrane:
        """The membrane under the object; built when a face first lies flat."""
        own = self._estimator
        return PressedMembrane(own.mesh, own.gas, own.scales, self._registration.model)

    @cached_property
    def _viewer(self) -> Viewer:
        return Viewer(self._estimator.observer)

    def solve(
        self,
        frame: Frame,
        estimate: Estimate,
        contact: ContactPoints,
        predicted: Motion,
        *,
        settled: bool,
        slides: bool = True,
    ) -> Solution:
        """Both stages from a prediction, which `settled` says is close.

        `slides` says whether the whole depth image is asked where a flat face has slid to.
        """
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
        if slides:
            second = self._slid(frame, estimate, contact, second, prior)
        motion = predicted.corrected(second.T_B_O, second.surface + second.outline)
        times = (1e3 * (between - began), 1e3 * (time.perf_counter() - between))
        return Solution(first, second, times, motion)

    def best(
        self,
        frame: Frame,
        estimate: Estimate,
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
                estimate,
                contact,
                Motion.at_rest(looks[k], SEARCH_DEVIATION, contact.center),
                settled=False,
            )
            for k in np.argsort(costs)[:finalists]
        ]
        good = [solution for solution in found if solution.pose.fitness >= FOUND_FITNESS]
        return min(good, key=lambda solution: solution.pose.cost, default=None)

    def _slid(
        self, frame: Frame, estimate: Estimate, contact: ContactPoints, fit: Fit, prior: Prior
    ) -> Fit:
        """The fit, moved in the directions that contact normals leave open."""
        found = directions(fit.surface, contact.radius_m)
        if self._registration.model.creases is None or found.determined.all():
            return fit
        sight = self._viewer.look(frame.depth_m, estimate, contact)
        known = fit.surface + fit.outline + prior.information
        step = slide(self._pressed, sight, contact, fit.T_B_O, found, known)
        T = moved(fit.T_B_O, step.motion, contact.center)
        return self._registration.slid(contact, fit, T, step.information)
