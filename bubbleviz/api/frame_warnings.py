"""Warnings about solved frames: sensor file, camera, gas pressure or settings that do not fit."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterator

import numpy as np

from bubbleviz.camera import UPPER_95
from bubbleviz.inverse import LINEAR, PAPER
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import Frame, gas_warning
from bubbleviz.result import Result
from bubbleviz.wording import count_of
from bubbleviz.zeros import Zeros, camera_moved, drift_warning

NO_FRAME_FITS = (
    "no frame looks like the membrane of this sensor; choose the sensor file of this camera, and "
    "check the gas pressure and the unit of depth (m in 32FC1, mm in 16UC1)"
)
_DRIFT_IMAGES = 10_000
"""Most recent images used for the drift warning: five minutes of a stream."""
_CHANCE = 0.02  # share of images that contradict their known errors by chance


class FrameWarnings:
    """Counts the frames of a recording or stream that contradict what is assumed about them."""

    def __init__(self, pipeline: Pipeline, zeros: Zeros) -> None:
        self._pipeline, self._zeros = pipeline, zeros
        self._measured_pa: float | None = None
        self._image_errors: deque[np.ndarray] = deque(maxlen=_DRIFT_IMAGES)
        self._errors_known = False  # from frames without contact
        self._frames_over, self._most_friction = 0, 0.0  # with more friction than expected
        self._statuses: Counter[str] = Counter()
        # frames with contact whose image contradicts its known errors, and the time of the first;
        # times of frames without contact, and whether theirs does
        self._moved, self._first_moved_s = 0, math.inf
        self._free: deque[tuple[float, bool]] = deque(maxlen=_DRIFT_IMAGES)
        self._by_depth_only = 0  # frames in which colour contradicts depth
        self._partly_seen, self._least_seen = 0, 1.0  # frames; smallest share of a contact seen

    def take(self, frame: Frame, result: Result) -> None:
        """Count a frame, as it was measured, and its result."""
        self._measured_pa = self._measured_pa or frame.gas_pressure_pa
        estimate = result.estimate
        if estimate is None:
            return
        self._statuses[estimate.status] += 1
        self._by_depth_only += estimate.flow_contradicts
        if estimate.image_errors is not None:
            known = result.frame.image_errors
            # with contact, those found in the image are mixed up with it
            errors = estimate.image_errors if estimate.status == "no_contact" else known
            if errors is not None:
                self._image_errors.append(errors.mean)
                self._errors_known = self._errors_known or known is not None
            moved, time_s = camera_moved(result), result.frame.time_s
            if estimate.status == "ok" and moved:
                self._moved += 1
                self._first_moved_s = min(self._first_moved_s, time_s)
            if estimate.status == "no_contact":
                self._free.append((time_s, moved))
        if estimate.seen_share < 1.0:
            self._partly_seen += 1
            self._least_seen = min(self._least_seen, estimate.seen_share)
        friction = _least_friction(result)
        if friction > self._pipeline.options.friction:
            self._frames_over += 1
            self._most_friction = max(self._most_friction, friction)

    def texts(self, where: str) -> dict[str, str]:
        """Warnings about the frames so far, by subject.

        `where`: what the frames are from, the word recording or source.
        """
        return {subject: text for subject, text in self._found(where) if text}

    def _found(self, where: str) -> Iterator[tuple[str, str]]:
        yield "file", self._pipeline.model.contradiction
        yield "gas", self._gas_warning(where)
        yield "camera", _camera_warning(self._pipeline, where)
        misfits = self._statuses["implausible"]
        if misfits and misfits == self._statuses.total():
            yield "fit", NO_FRAME_FITS
        elif misfits and not self._statuses["no_contact"]:
            yield (
                "unconfirmed",
                f"{count_of(misfits, 'frame')} did not fit the sensor file, and no contact-free "
                "frame confirms the file, so forces in the other frames may be wrong: check the "
                "file against contact-free frames (bubbleviz check)",
            )
        if (noise := self._zeros.image.noise) > UPPER_95:  # which weakens the evidence of contact
            yield (
                "noise",
                f"depth averaged over neighbouring pixels has {noise:.1f} times the noise of the "
                "sensor file (it is larger, or correlated), so light contacts may not be found: "
                "identify the sensor again, or turn off spatial filters of the camera",
            )
        yield "depth", self._contact_warning() or self._drift_warning()
        friction = self._pipeline.options.friction
        frictionless = self._pipeline.estimator.solver_name in (LINEAR, PAPER)
        if frictionless and friction and self._pipeline.options.friction_given:
            yield (
                "friction",
                f"the linear membrane has no friction, so --friction {friction:g} changes nothing; "
                "leave it out, or choose a sensor file with a pre-stretch (and no --solver)",
            )
        elif self._frames_over:
            yield (
                "friction",
                f"friction in {count_of(self._frames_over, 'frame')} is at least "
                f"{self._most_friction:.2g} of the normal force, more than the expected "
                f"coefficient of {friction:.2g}, so the estimate of "
                "friction is too small: expect more (--friction)",
            )
        if self._partly_seen:
            yield (
                "view",
                "the camera sees only a part of the contact in "
                f"{count_of(self._partly_seen, 'frame')} (at least {100 * self._least_seen:.0f} % "
                "of its area); the force on the unseen part is inferred from the membrane around "
                "it and less certain. Press nearer to the middle of the image",
            )
        if self._by_depth_only:
            yield (
                "colour",
                f"colour contradicts depth in {count_of(self._by_depth_only, 'frame')}, which were "
                "solved by depth alone; their stamps may be of different moments. Give the delay "
                "of colour (--colour-delay)",
            )

    def _contact_warning(self) -> str:
        """Warning if more images with contact than by chance contradict those without; else empty.

        A difference that ends with the contact is not drift of the camera.
        """
        if self._moved <= max(1, _CHANCE * self._statuses["ok"]):
            return ""
        causes, remedies = list[str](), list[str]()
        later = [moved for time_s, moved in self._free if time_s >= self._first_moved_s]
        if not later or sum(later) > _CHANCE * len(later):
            causes.append("the camera drifted")
            remedies.append("let the camera warm up, check that it is fixed")
        gas = self._zeros.gas
        if self._measured_pa is None or (gas is not None and gas.frozen):
            causes.append("the gas pressure, which is not measured, does not follow the gas law")
            remedies.append("record the gas pressure, check chamber_volume_m3")
        else:
            causes.append("the measured gas pressure is wrong or late")
            remedies.append("check values and stamps of the gas pressure")
        remedy = ", ".join(remedies)
        return (
            f"depth in {count_of(self._moved, 'frame')} with contact contradicts depth in the "
            f"contact-free ones: {', '.join(causes)}, or shape or rubber of the membrane "
            "differ from the sensor file; forces in these frames are less certain. "
            f"{remedy[0].upper()}{remedy[1:]}, or identify the sensor again"
        )

    def _drift_warning(self) -> str:
        """Warning if depth drifted by more than three σ since the calibration; else empty."""
        # one image alone may show an object too shallow to be found
        if len(self._image_errors) < (1 if self._errors_known else 2):
            return ""
        errors, measured = np.median(self._image_errors, axis=0), self._measured_pa is not None
        return drift_warning(errors, self._pipeline, gas_measured=measured)

    def _gas_warning(self, where: str) -> str:
        """Warning if the gas pressure contradicts the sensor file, or never changes; else empty."""
        known_pa, zero = self._pipeline.model.gas.P0, self._zeros.gas
        if zero is not None and zero.frozen:
            return zero.frozen_warning(where) if self._statuses["ok"] else ""
        if zero is None or zero.rest_pa is None:
            return gas_warning(self._measured_pa, known_pa, f"in the {where}")
        return gas_warning(zero.rest_pa, known_pa, f"without contact in the {where}")


def _least_friction(result: Result) -> float:
    """Lower bound of friction over normal force, by the interval of the force; NaN if unknown."""
    estimate, patch = result.trusted_estimate, result.trusted_patch
    if estimate is None or patch is None or estimate.status == "no_contact":
        return math.nan
    normal = float(np.linalg.norm(patch.force_n - patch.tangential_force_n))
    friction = float(np.linalg.norm(patch.tangential_force_n))
    return (friction - estimate.force_half_width_n) / normal if normal else math.nan


def _camera_warning(pipeline: Pipeline, where: str) -> str:
    """Warning where the intrinsics differ from the calibrated ones by more than the noise."""
    model, moved = pipeline.model, pipeline.model.camera_change_m
    if model.pixels is None or moved == 0.0:
        return ""
    weight = pipeline.estimator.observer.observe_everything().weight
    if moved < 1.0 / np.sqrt(np.median(weight[weight > 0.0])):
        return ""
    return (
        f"the {where}'s camera info differs from the intrinsics in the sensor file, which shifts "
        f"depth by {1e3 * moved:.2f} mm rms; choose the sensor file of this camera, or identify "
        "the sensor again"
    )
