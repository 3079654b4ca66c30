"""Both stages on one frame, from a prediction or from the best of some starts."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bubbleviz.frames.frame import Frame
from bubbleviz.inverse.estimator import Estimator
from bubbleviz.inverse.rubber_estimator import RubberEstimator
from bubbleviz.membrane.rubber_model.rubber_membrane import RubberMembrane
from bubbleviz.pose.contact_points import ContactPoints
from bubbleviz.pose.depth_image.image_fit import ImageFit
from bubbleviz.pose.depth_image.pressed_membrane import PressedMembrane
from bubbleviz.pose.motion_filter import SEARCH_DEVIATION, Motion
from bubbleviz.pose.observability import directions
from bubbleviz.pose.pose_options import PoseOptions
from bubbleviz.pose.registration import Fit, Prior, Registration
from bubbleviz.pose.rigid_motion import motion_between, moved
from bubbleviz.result import Pose, Stage


@dataclass(frozen=True)
class Solution:
    """A pose of one frame."""

    # first, pose: stage one and stage two
    first: Fit
    pose: Fit
    ms: tuple[float, float]  # wall time of the stages
    motion: Motion  # pose and velocity with what this frame adds

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
    """Runs the stages."""

    def __init__(
        self,
        registration: Registration,
        estimator: Estimator | RubberEstimator,
        membrane: RubberMembrane,  # that the object presses into
        options: PoseOptions,
    ) -> None:
        self._registration, self._estimator = registration, estimator
        self._membrane, self._options = membrane, options

    @cached_property
    def _image(self) -> ImageFit:
        """Against the depth image; built when there is a first pose."""
        own, options = self._estimator, self._options.image
        model = self._registration.model
        pressed = PressedMembrane(self._membrane, own.gas, model, options.press)
        return ImageFit(own.observer, pressed, options)

    def forget(self) -> None:
        """Begin anew, with nothing kept of where the object was."""
        if "_image" in vars(self):
            self._image.forget()

    def solve(
        self, frame: Frame, contact: ContactPoints, predicted: Motion, *, settled: bool
    ) -> Solution:
        """Both stages from a prediction, which `settled` says is close."""
        stages = self._options.stages
        iterations = stages.tracking if settled else stages.converging
        prior = Prior(predicted.T_B_O, predicted.information)
        began = time.perf_counter()
        first = self._registration.stage_one(
            contact,
            predicted.T_B_O,
            prior,
            widest_m=stages.close_m if settled else stages.far_m,
            iterations=iterations,
        )
        between = time.perf_counter()
        second = self._registration.stage_two(contact, first.T_B_O, prior, iterations=iterations)
        second, information = self._seen(frame, contact, second, prior, settled)
        motion = predicted.corrected(second.T_B_O, information)
        times = (1e3 * (between - began), 1e3 * (time.perf_counter() - between))
        return Solution(first, second, times, motion)

    def best(
        self, frame: Frame, contact: ContactPoints, starts: np.ndarray, finalists: int
    ) -> Solution | None:
        """Both stages from those of the starts (s, 4, 4) that fit best; None where none does."""
        stages = self._options.stages
        motions = [Motion.at_rest(start, SEARCH_DEVIATION, contact.center) for start in starts]
        looks = [
            self._registration.stage_one(
                contact, m.T_B_O, Prior(m.T_B_O, m.information), iterations=stages.looking
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
        good = [solution for solution in found if solution.pose.fitness >= stages.found_fitness]
        return min(good, key=lambda solution: solution.pose.cost, default=None)

    def _seen(
        self, frame: Frame, contact: ContactPoints, fit: Fit, prior: Prior, settled: bool
    ) -> tuple[Fit, np.ndarray]:
        """The fit moved to where the depth image has the object, and the information of that."""
        options, directed = self._options.image, directions(fit.surface, contact.radius_m)
        start = fit.T_B_O
        if settled:  # where it is on its face is for the depth image to say, not the blurred patch
            way = np.linalg.solve(
                directed.motions, motion_between(prior.T_B_O, start, contact.center)
            )
            way = directed.motions @ (way * directed.determined)
            start = moved(prior.T_B_O, way, contact.center)
        change = self._estimator.observer.pixel_residuals(frame.depth_m)
        valid_m = options.valid_m if settled else options.settled_m
        T, step = start, None
        for _ in range(options.next_steps if settled else options.first_steps):
            pull = prior.information @ motion_between(prior.T_B_O, T, contact.center)
            step = self._image.step(
                change, contact, T, directed, prior.information, pull,
                valid_m=valid_m, gas_pressure_pa=frame.gas_pressure_pa,
            )  # fmt: skip
            if step is None:
                return fit, fit.surface + fit.outline
            T = moved(T, step.motion, contact.center)
            if step.way_m < valid_m:
                break
        assert step is not None
        return self._registration.at(contact, fit, T), step.information
