"""Dual-stage registration of one frame, from a prediction or the best of several initial poses."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation
from scipy.special import chdtrc

from bubbleviz.inverse import Estimator
from bubbleviz.membrane import ObjectSurface, RubberMembrane, area_vectors
from bubbleviz.pose.image_fit import ImageFit
from bubbleviz.pose.motion import (
    SEARCH_DEVIATION,
    SEARCH_INFORMATION,
    Motion,
    about,
    motion_between,
    moved,
    turning,
    way_at,
)
from bubbleviz.pose.pressed_membrane import PressedMembrane
from bubbleviz.pose.registration import ContactPoints, Directions, Fit, Registration, directions
from bubbleviz.recordings import Frame
from bubbleviz.result import Pose

_PREDICTION_ERROR_M, _START_ERROR_M = 2e-3, 5e-3  # possible error of a prediction; of a first pose
_TRACKING_ITERATIONS, _FIRST_ITERATIONS, _SEARCH_ITERATIONS = 1, 12, 6
"""Iterations of each stage: while tracking, as the fit to the depth image follows; from an initial
pose; and to compare initial poses."""
_STEP_M = 1.5e-3
"""Longest step of the patch's edge, and its largest motion within a frame from the linear model of
the last frame: the membrane around an edge is curved over a few mm, and derivatives are valid over
half of that."""
_VALID_M, _CONVERGED_M = 1e-3, 2e-4
"""Motion of the patch's edge up to which a linear model is reused from frame to frame, and step up
to which the first pose of an object has converged. At two thirds of the longest step the error of
the derivatives is less than half."""
_NEXT_STEPS, _FIRST_STEPS = 3, 10  # at most, in a frame that follows another, and in a first one
FOUND_FITNESS = 0.7  # share of the patch that must lie on an object found by search
_FINALISTS = 2  # unlike poses of a search, which are refined
_AS_LIKELY = 2.0 * np.log(20.0)
"""Difference of χ² at which one of two poses is 20 times as likely as the other, which is then
refuted."""
_DOUBTED, _REFUTED = 0.3, 0.05
"""Significances at which the contact doubts and refutes a pose found by the depth image. χ² of the
true pose exceeds the least by more with this probability; its degrees of freedom are the directions
that the contact determines. The way from a doubted pose to the contact's is part of its covariance.
Chosen on a cylinder that tilts onto its edge: without it, half of the seeds are 4 σ off. Where the
edge of a puck touches, the image is doubted as much, but is nearer to the truth."""


class Solution(NamedTuple):
    """A pose of one frame."""

    pose: Pose
    fit: Fit  # of stage two
    motion: Motion  # pose and velocity after this frame


class _ByImage(NamedTuple):
    """A pose by the depth image."""

    motion: Motion
    persistent: np.ndarray  # (6, 6), covariance by model errors
    fit: Fit  # of stage two, at that pose
    chance: float  # that χ² of the contact exceeds its least by more at the true pose

    def undetermined(self, by_contact: Directions) -> np.ndarray:
        """Information (6, 6) in the directions that the contact does not determine."""
        free, across = ~by_contact.determined, np.linalg.inv(by_contact.motions)
        along = across[free]
        covariance = along @ (self.motion.covariance[:6, :6] + self.persistent) @ along.T
        information: np.ndarray = along.T @ np.linalg.solve(covariance, along)
        return information


class Solver:
    """Runs the stages."""

    def __init__(
        self,
        registration: Registration,
        estimator: Estimator,
        membrane: RubberMembrane,  # that the object presses into
    ) -> None:
        self._registration, self._observer = registration, estimator.observer
        # now, so that the first frame is not delayed
        pressed = PressedMembrane(membrane, estimator.bubble.gas, registration.model)
        self._image = ImageFit(self._observer, pressed)

    def reset(self) -> None:
        """Forget the previous pose."""
        self._image.reset()

    def solve(
        self, frame: Frame, contact: ContactPoints, predicted: Motion, *, tracking: bool
    ) -> Solution:
        """Both stages from a prediction; while `tracking` it is close, without rivals."""
        iterations = _TRACKING_ITERATIONS if tracking else _FIRST_ITERATIONS
        began = time.perf_counter()
        first = self._registration.stage_one(
            contact,
            predicted,
            widest_m=_PREDICTION_ERROR_M if tracking else _START_ERROR_M,
            iterations=iterations,
        )
        between = time.perf_counter()
        fit = self._registration.stage_two(contact, first, predicted, iterations=iterations)
        by_image = self._image_fit(frame, contact, fit, predicted, tracking)
        if by_image is None or by_image.chance < _REFUTED:
            # A membrane that fits worse than its errors allow, as at a tip, which the estimate
            # rounds off, has larger ones (Birge 1932).
            misfit = fit.rmse_m / self._registration.deviation_m(contact)
            information = fit.surface / max(1.0, misfit**2)
            motion = predicted.corrected(fit.T_B_O, information)
            persistent = np.linalg.inv(information + SEARCH_INFORMATION)
        else:
            motion, persistent = by_image.motion, by_image.persistent
            if by_image.chance < _DOUBTED:
                apart = self._from_contact(contact, fit, by_image)
                persistent = persistent + np.outer(apart, apart)
            fit = by_image.fit
        unknown = motion.covariance[:6, :6] + persistent
        if contact.image_errors is not None:
            T_B_C = self._observer.camera.T_B_C
            unknown[:3, :3] += contact.image_errors.displacement_covariance(T_B_C)
        found, count = directions(fit.surface, contact.radius_m), len(contact.points)
        at_origin = about(motion.center, fit.T_B_O[:3, 3])
        pose = Pose(
            status="ok",
            T_B_O=fit.T_B_O,
            stage_one=replace(first, ms=1e3 * (between - began)),
            stage_two=replace(fit, ms=1e3 * (time.perf_counter() - between)),
            center_m=contact.center,
            covariance=at_origin @ unknown @ at_origin.T,
            motions=found.motions,
            deviation_m=found.deviation_m,
            determined=found.determined,
            points_m=contact.points,
            places_m=fit.distance.place[:count],
            distance_m=fit.distance.signed_m[:count],
            distance_rms_m=contact.rms_distance_m(fit.distance.signed_m[:count]),
            distance_limit_m=self._registration.distance_limit_m(contact),
        )
        return Solution(pose, fit, motion)

    def _from_contact(self, contact: ContactPoints, fit: Fit, by_image: _ByImage) -> np.ndarray:
        """Motion (6,) of a pose by the depth image to the one that the contact determines.

        In the directions that the contact does not determine, the image determines that, too.
        """
        known = by_image.undetermined(directions(fit.surface, contact.radius_m))
        prior = Motion.known(by_image.fit.T_B_O, known, contact.center)
        nearby = self._registration.stage_two(contact, by_image.fit, prior)
        return motion_between(by_image.fit.T_B_O, nearby.T_B_O, by_image.motion.center)

    def best(
        self,
        frame: Frame,
        contact: ContactPoints,
        starts: np.ndarray,
        known: Solution | None = None,  # kept unless another solution is more likely
        *,
        refine: bool = False,  # compare it with refined solutions, and list it if one is better
    ) -> Solution:
        """Both stages from the best of initial poses (s, 4, 4), which may not fit.

        The pose lists the other poses that fit as well.
        """
        model, center = self._registration.model, contact.center
        motions = [Motion.at_rest(start, SEARCH_DEVIATION, center) for start in starts]
        coarse = [
            self._registration.stage_one(contact, motion, iterations=_SEARCH_ITERATIONS)
            for motion in motions
        ]
        coarse.sort(key=lambda fit: fit.cost)
        least, refined_most = coarse[0].cost, _FINALISTS
        if known is not None and not refine and least > known.fit.cost - _AS_LIKELY:
            least, refined_most = known.fit.cost, 0  # none of them refutes it
        likely = [
            fit for fit in coarse if fit.cost < least + _AS_LIKELY and fit.fitness >= FOUND_FITNESS
        ]
        if known is None and not likely:
            likely = coarse[:1]
        candidates = looking_different(model, [fit.T_B_O for fit in likely])
        motions = [Motion.at_rest(T, SEARCH_DEVIATION, center) for T in candidates[:refined_most]]
        refined = [self.solve(frame, contact, each, tracking=False) for each in motions]
        good = [one for one in refined if one.fit.fitness >= FOUND_FITNESS]
        good += [] if known is None else [known]
        good = sorted(good or refined, key=lambda one: one.fit.cost)
        limit = good[0].fit.cost + _AS_LIKELY
        # with `refine`, one frame does not refute a pose that was followed to it from others
        fitting = [
            one.fit.T_B_O for one in good if one.fit.cost < limit or (refine and one is known)
        ]
        others = looking_different(model, [*fitting, *candidates[refined_most:]])[1:]
        return good[0]._replace(pose=replace(good[0].pose, others=others))

    def _image_fit(
        self, frame: Frame, contact: ContactPoints, fit: Fit, predicted: Motion, tracking: bool
    ) -> _ByImage | None:
        """The pose by the depth image; None if no press is found.

        The contact may refute it: at an edge of the object the press's flat triangles are 0.2 mm
        off, and derivatives by turns about it as wrong as they are large. So a contact narrower
        than a triangle is not tried; while tracking, nor is one narrower than two rows of them,
        which may hold no whole one, if it determines a direction.
        """
        directed, T = directions(fit.surface, contact.radius_m), fit.T_B_O
        narrowest = np.sqrt(3.0) if tracking and directed.determined.any() else 1.0
        if contact.width_m < narrowest * self._observer.mesh.edge_length:
            return None
        if tracking:  # the depth image, not the blurred patch, determines the other directions
            way = motion_between(predicted.T_B_O, T, contact.center)
            way = np.linalg.solve(directed.motions, way) * directed.determined
            T = moved(predicted.T_B_O, directed.motions @ way, contact.center)
        change = self._observer.pixel_residuals(frame.steady_depth_m)
        valid_m = _VALID_M if tracking else _CONVERGED_M
        self._image.load(contact, frame.gas_pressure_pa)
        for k in range(_NEXT_STEPS if tracking else _FIRST_STEPS):
            from_predicted = motion_between(predicted.T_B_O, T, contact.center)
            center = contact.center + from_predicted[:3]
            step = self._image.step(
                change, replace(contact, center=center), T, directed,
                valid_m=valid_m if k or not tracking else _STEP_M,
                gas_pressure_pa=frame.gas_pressure_pa,
            )  # fmt: skip
            if step is None:
                return None
            A = turning(from_predicted)
            information, gradient = A.T @ step.information @ A, A.T @ step.gradient
            known = predicted.information
            motion = A @ np.linalg.solve(information + known, gradient - known @ from_predicted)
            way_m = way_at(contact.radius_m, motion)
            T = moved(T, motion * min(1.0, _STEP_M / max(way_m, 1e-300)), center)
            if self._image.covers(T, contact, valid_m):
                break
        assert step is not None  # there is at least one
        seen = self._registration.at(contact, fit, T)
        count = max(float(np.count_nonzero(directed.determined)), 1.0)
        chance = float(chdtrc(count, max(seen.cost - fit.cost, 0.0)))
        return _ByImage(predicted.corrected(T, information), step.persistent, seen, chance)


# Search for initial poses: each face on the patch, at each of several angles about its normal.


TURNS = 12
"""Angles about the patch's normal: 30° apart, within the convergence range of registration."""

_FACES = 8  # of the convex hull, the largest: an object seldom rests on others
_SAME_FACE = np.cos(np.radians(20.0))  # faces within the convergence range of registration
_ALIKE = 0.02  # distance over an object's size within which it looks the same; chosen
_POINTS = 40  # of contact and as many free ones: enough to rank starts
_CLIPPED_M = 5e-3  # larger distances are clipped
_SAMPLES = 2_000  # points of an object: on a face of 60 × 60 mm they are some 3 mm apart


def looking_different(
    model: ObjectSurface,
    poses: Iterable[np.ndarray],
    known: Iterable[np.ndarray] = (),  # (4, 4), which look different from each other
) -> np.ndarray:
    """The known poses, and those (4, 4) in which the object looks different from all before.

    Shape (r, 4, 4). Shifts do not count, as a flat face slides.
    """
    kept = list(known)
    for pose in poses:
        if not any(looks_alike(model, other, pose) for other in kept):
            kept.append(pose)
    return np.reshape(kept, (-1, 4, 4))


def looks_alike(model: ObjectSurface, one: np.ndarray, other: np.ndarray) -> bool:
    """Whether the turn between two poses (4, 4), or one close to it, is a symmetry.

    Close is half the angle between starts.
    """
    turn, close = Rotation.from_matrix(one[:3, :3].T @ other[:3, :3]), np.pi / TURNS
    if turn.magnitude() < close:
        return True
    return model.nearest_symmetry(turn.as_matrix(), _ALIKE, close) is not None


def touching_directions(model: ObjectSurface) -> np.ndarray:
    """Directions (d, 3) in O in which the object may lie on the membrane.

    The largest faces of its convex hull, on which it rests stably, and those of its axes, in both
    directions, without such a face.
    """
    hull = _hull(model.obj.vertices)
    candidates = list(np.concatenate([np.eye(3), -np.eye(3)]))
    if hull is not None:
        areas = np.linalg.norm(area_vectors(model.obj.vertices, hull.simplices), axis=1)
        normals = hull.equations[:, :3]
        faces, which = np.unique(np.round(normals, 3), axis=0, return_inverse=True)
        total = np.bincount(which.ravel(), areas)
        candidates = list(faces[np.argsort(-total, kind="stable")[:_FACES]]) + candidates
    chosen: list[np.ndarray] = []
    for direction in candidates:
        unit = direction / np.linalg.norm(direction)
        if all(unit @ other < _SAME_FACE for other in chosen):
            chosen.append(unit)
    return np.array(chosen)


def _hull(vertices: np.ndarray) -> ConvexHull | None:
    try:
        return ConvexHull(vertices)
    except (QhullError, ValueError):  # flat
        return None


class InitialPoseFinder:
    """Lists coarse initial poses of one object, best first."""

    def __init__(
        self,
        model: ObjectSurface,
        *,
        only_middles: bool = False,  # of the faces: fewer to rank, for live frames
    ) -> None:
        self._model = model
        self._directions = touching_directions(model)
        points = model.sample(0 if only_middles else _SAMPLES)[0]
        self._supports = [self._of_face(direction, points) for direction in self._directions]

    def _of_face(self, direction: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Points (s, 3) in O on a face: its middle, then more, until all of it is near one."""
        vertices, size_m = self._model.obj.vertices, self._model.size_m
        lowest = (vertices @ direction).max() - 0.02 * size_m
        face, corners = points[points @ direction > lowest], vertices[vertices @ direction > lowest]
        chosen = [0.5 * (corners.min(axis=0) + corners.max(axis=0))]
        away_m = np.full(len(face), np.inf)
        while True:
            away_m = np.minimum(away_m, np.linalg.norm(face - chosen[-1], axis=1))
            if away_m.max(initial=0.0) < max(_START_ERROR_M, 0.1 * size_m):
                return np.array(chosen)
            chosen.append(face[away_m.argmax()])

    def starts(self, contact: ContactPoints) -> np.ndarray:
        """Poses T_B_O (s, 4, 4) with the object on the patch, best first.

        Their number, and so the computing time, depends only on the object.
        """
        normal = contact.areas_m2 @ contact.normals
        normal /= np.linalg.norm(normal)
        best, scores = [], []
        for direction, supports in zip(self._directions, self._supports, strict=True):
            poses = _on_patch(direction, supports, contact.center, normal)
            score = self._scores(poses.reshape(-1, 4, 4), contact).reshape(-1, TURNS)
            best.append(poses[score.argmin(axis=0), np.arange(TURNS)])
            scores.append(score.min(axis=0))
        return np.concatenate(best)[np.argsort(np.concatenate(scores), kind="stable")]

    def _scores(self, poses: np.ndarray, contact: ContactPoints) -> np.ndarray:
        """Mean squared misfit of each pose for some of the points; distances clipped at 5 mm."""
        on = contact.points[:: -(-len(contact.points) // _POINTS)]
        free = contact.free[:: max(1, -(-len(contact.free) // _POINTS))]
        points = np.concatenate([on, free])
        local = np.einsum("spj,sjk->spk", points - poses[:, None, :3, 3], poses[:, :3, :3])
        found = self._model.closest(local.reshape(-1, 3))
        way = local.reshape(-1, 3) - found.place
        length = np.minimum(np.linalg.norm(way, axis=1), _CLIPPED_M)
        inside = np.einsum("ij,ij->i", way, found.normal) < -0.5 * np.linalg.norm(way, axis=1)
        squares = (length**2).reshape(len(poses), -1)
        penetrating = squares[:, len(on) :] * inside.reshape(len(poses), -1)[:, len(on) :]
        score = squares[:, : len(on)].mean(axis=1) + penetrating.sum(axis=1) / max(len(free), 1)
        return np.round(score, 9)  # to (0.03 mm)²: of starts that fit alike, the middle comes first


def _on_patch(
    direction: np.ndarray, supports: np.ndarray, center: np.ndarray, normal: np.ndarray
) -> np.ndarray:
    """Poses (s, t, 4, 4) with a direction of O against the membrane, a support at the centre."""
    turned, _ = Rotation.align_vectors(-normal[None], direction[None])
    angles = np.arange(TURNS) * 2.0 * np.pi / TURNS
    rotations = (Rotation.from_rotvec(angles[:, None] * normal) * turned).as_matrix()
    poses = np.tile(np.eye(4), (len(supports), TURNS, 1, 1))
    poses[..., :3, :3] = rotations
    poses[..., :3, 3] = center - np.einsum("tij,sj->sti", rotations, supports)
    return poses
