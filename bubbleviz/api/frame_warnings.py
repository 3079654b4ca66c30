"""Warnings about solved frames: sensor file, camera, gas pressure or settings that do not fit."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator

import numpy as np

from bubbleviz.camera import IMAGE_ERRORS, UPPER_95, RangeObserver
from bubbleviz.inverse import LINEAR, PAPER
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import Frame, gas_warning
from bubbleviz.result import Result
from bubbleviz.wording import count_of
from bubbleviz.zeros import Zeros, camera_moved, drift_warning

_MISFIT = "no frame looks like the membrane of this sensor"
_OTHER_FILE = (
    "choose the sensor file of this camera, and check the gas pressure, the camera's pose "
    "(quaternion_xyzw) and the unit of depth (m in 32FC1, mm in 16UC1)"
)
NO_FRAME_FITS = f"{_MISFIT}; {_OTHER_FILE}"
RECENT_FRAMES = 10_000
"""Frames of a stream that count, the most recent: five minutes. What was repaired is forgotten."""
_MISSING_GAS = 0.1  # share of frames: recordings begin and end with some
_CHANCE = 0.02  # share of images that contradict their known errors by chance
_FACTS = np.dtype(
    [
        ("number", np.int64),  # -1: not solved
        # by status, as in `Estimate.status`
        ("ok", bool),
        ("no_contact", bool),
        ("implausible", bool),
        ("moved", bool),  # the image contradicts its known errors
        ("by_depth_only", bool),  # colour contradicts depth
        ("errors_known", bool),  # from frames without contact
        ("errors", np.float32, (len(IMAGE_ERRORS),)),  # of the depth image; NaN if unknown
        ("gas_pressure_pa", np.float32),  # NaN if not measured
        ("seen_share", np.float32),  # of the contact, by the camera
        ("friction", np.float32),  # lower bound, over normal force; NaN if unknown
    ]
)
"""What the warnings use of a frame."""
_SPOT_PERIOD_S, _SPOT_IMAGES = 0.3, 10
"""Least time between the contact-free images of which spots are means, and about the largest
number of these, so that a spot that was removed is forgotten."""
_SPOT_SIGMAS, _SPOT_SHARE = 5.0, 0.05
"""Least mean error of a block of pixels, over the noise of that mean: one in a million by chance.
If more than that share of all blocks has it, the sensor file is wrong."""


class _Spots:
    """Pixels whose depth is wrong in the contact-free images, as by dust on the camera's window.

    In a single image, they look like a light touch.
    """

    def __init__(self, observer: RangeObserver) -> None:
        self._observer, self._time_s = observer, -math.inf
        self._images = set[int]()  # hashes; images of a looping source have the same noise again
        self._error = np.zeros(observer.blocks)  # mean, over the noise of one image

    def take(self, frame: Frame, result: Result) -> None:
        """Use a contact-free image, unless it repeats one or follows too soon on the one before."""
        observer, expected_m = self._observer, 0.0
        if result.estimate is None or abs(frame.time_s - self._time_s) < _SPOT_PERIOD_S:
            return
        if (image := hash(frame.depth_m.tobytes())) in self._images:
            return
        if (errors := result.estimate.image_errors) is not None:
            expected_m = observer.image_errors @ errors.mean
        seen = observer.observe(frame.depth_m)
        error = (seen.residual_m - expected_m) * np.sqrt(seen.weight) / result.frame.noise
        self._time_s = frame.time_s
        self._images.add(image)
        self._error += (error - self._error) / min(len(self._images), _SPOT_IMAGES)

    def text(self) -> str:
        """Warning that tells the place of the largest error; empty if there is none."""
        size, observer = np.abs(self._error), self._observer
        images = min(len(self._images), _SPOT_IMAGES)
        wrong = np.count_nonzero(size * math.sqrt(images) > _SPOT_SIGMAS)
        if images < 2 or not 0 < wrong < _SPOT_SHARE * len(size):
            return ""
        worst = int(size.argmax())
        row, column = divmod(int(observer.block_number[worst]), observer.columns)
        noise_m = observer.observe_everything().weight[worst] ** -0.5
        return (
            "depth in frames without contact is wrong by about "
            f"{1e3 * self._error[worst] * noise_m:+.1f} mm around column "
            f"{column * observer.block}, row {row * observer.block}, so light contacts and those "
            "near it are wrong, too: clean the camera's window, and look for reflections and "
            "damage of the membrane there; if it stays, identify the sensor again"
        )


class FrameWarnings:
    """Counts the frames of a recording or stream that contradict what is assumed about them.

    All frames of a recording count, the most recent of a stream.
    """

    def __init__(self, pipeline: Pipeline, zeros: Zeros) -> None:
        self._pipeline, self._zeros = pipeline, zeros
        self._where = "source" if zeros.rest_frames is None else "recording"
        self._most = RECENT_FRAMES if zeros.rest_frames is None else sys.maxsize
        self.restart()

    def restart(self) -> None:
        """Forget all frames."""
        self._facts = np.zeros(0, _FACTS)
        self._spots = _Spots(self._pipeline.estimator.observer)

    def take(self, number: int, frame: Frame, result: Result) -> None:
        """Count a frame, as it was measured, if its result has an estimate.

        A frame that is solved again, with the same `number`, counts once. Numbers are in order of
        time.
        """
        estimate, at = result.estimate, number % self._most
        if at >= len(self._facts):
            facts = np.zeros(min(max(at + 1, 2 * len(self._facts)), self._most), _FACTS)
            facts[: len(self._facts)] = self._facts
            facts["number"][len(self._facts) :] = -1
            self._facts = facts
        if estimate is None or self._facts["number"][at] >= number:
            return
        if estimate.status == "no_contact":
            self._spots.take(frame, result)
        known, found = result.frame.image_errors, estimate.image_errors
        # with contact, those found in the image are mixed up with it
        errors = found if found is None or estimate.status == "no_contact" else known
        pressure_pa = frame.gas_pressure_pa
        self._facts[at] = (
            number,
            *(estimate.status == name for name in ("ok", "no_contact", "implausible")),
            camera_moved(result),
            estimate.flow_contradicts,
            found is not None and known is not None,
            math.nan if errors is None else errors.mean,
            math.nan if pressure_pa is None else pressure_pa,
            estimate.seen_share,
            _least_friction(result),
        )

    def texts(self) -> dict[str, str]:
        """Warnings about the frames so far, by subject."""
        numbers = self._facts["number"]
        oldest = max(0, numbers.max(initial=0) - self._most + 1)
        facts = self._facts[numbers >= oldest]
        return {subject: text for subject, text in self._found(facts) if text}

    def _found(self, facts: np.ndarray) -> Iterator[tuple[str, str]]:
        yield "file", self._pipeline.model.contradiction
        yield "gas", self._gas_warning(facts) or _gas_gaps_warning(facts)
        yield "camera", _camera_warning(self._pipeline, self._where)
        misfits, others = (int(facts[name].sum()) for name in ("implausible", "ok"))
        # Frames without contact confirm the sensor file. Those that were found for the zeros may
        # not have been solved yet, and are too few to outweigh more frames that do not fit.
        confirmed = facts["no_contact"].any() or misfits < (self._zeros.rest_frames or 0)
        if misfits and not confirmed and not others:
            yield "fit", f"{_MISFIT} ({misfits:,} solved); {_OTHER_FILE}"
        elif misfits and not confirmed:
            yield (
                "unconfirmed",
                f"{misfits:,} of {misfits + others:,} frames did not fit the sensor file, and no "
                "contact-free frame confirms it, so forces in the others may be wrong: check the "
                "file against contact-free frames (bubbleviz check; window: Calibration panel), or "
                "identify the sensor again",
            )
        if (noise := self._zeros.image.noise) > UPPER_95:  # which weakens the evidence of contact
            yield (
                "noise",
                f"depth averaged over neighbouring pixels has {noise:.1f} times the noise of the "
                "sensor file (it is larger, or correlated), so light contacts may not be found: "
                "identify the sensor again, or turn off spatial filters of the camera",
            )
        yield "depth", self._contact_warning(facts) or self._drift_warning(facts)
        yield "spots", self._spots.text()
        yield "friction", self._friction_warning(facts["friction"])
        unseen = facts["seen_share"][facts["seen_share"] < 1.0]
        if unseen.size:
            yield (
                "view",
                f"the camera sees only a part of the contact in {count_of(unseen.size, 'frame')} "
                f"(at least {100 * unseen.min():.0f} % of its area); the force on the unseen part "
                "is inferred from the membrane around it and less certain. Press nearer to the "
                "middle of the image",
            )
        if by_depth_only := int(facts["by_depth_only"].sum()):
            yield (
                "colour",
                f"colour contradicts depth in {count_of(by_depth_only, 'frame')}, which were "
                "solved by depth alone; their stamps may be of different moments. Set the colour "
                "delay (--colour-delay; window: Sensor panel)",
            )

    def _friction_warning(self, found: np.ndarray) -> str:
        """Warning if friction (F,) over normal force exceeds the coefficient, or is ignored."""
        friction = self._pipeline.options.friction
        frictionless = self._pipeline.estimator.solver_name in (LINEAR, PAPER)
        if frictionless and friction and self._pipeline.options.friction_given:
            return (
                "the linear membrane has no friction, so the expected coefficient of friction "
                f"(--friction {friction:g}) changes nothing; leave it out, or choose a sensor file "
                "with a pre-stretch and the default solver"
            )
        over = found[found > friction]
        if not over.size:
            return ""
        return (
            f"friction in {count_of(over.size, 'frame')} is at least {over.max():.2g} of the "
            f"normal force, more than the expected coefficient of {friction:.2g}, so the estimate "
            "of friction is too small: expect more (--friction; window: Compare panel)"
        )

    def _contact_warning(self, facts: np.ndarray) -> str:
        """Warning if more images with contact than by chance contradict those without; else empty.

        A difference that ends with the contact is not drift of the camera.
        """
        moved = facts["number"][facts["ok"] & facts["moved"]]
        if moved.size <= max(1, _CHANCE * facts["ok"].sum()):
            return ""
        causes, remedies = list[str](), list[str]()
        later = facts["moved"][facts["no_contact"] & (facts["number"] > moved.min())]
        if not later.size or later.mean() > _CHANCE:
            causes.append("the camera drifted")
            remedies.append("let the camera warm up, check that it is fixed")
        gas = self._zeros.gas
        if not _measured_pa(facts).size or (gas is not None and not gas.used):
            causes.append("the gas pressure, which is not measured, does not follow the gas law")
            remedies.append("record the gas pressure, check chamber_volume_m3")
        else:
            causes.append("the measured gas pressure is wrong or late")
            remedies.append("check values and stamps of the gas pressure")
        remedy = ", ".join(remedies)
        return (
            f"depth in {count_of(moved.size, 'frame')} with contact contradicts depth in the "
            f"contact-free ones: {', '.join(causes)}, or shape or rubber of the membrane "
            "differ from the sensor file; forces in these frames are less certain. "
            f"{remedy[0].upper()}{remedy[1:]}, or identify the sensor again"
        )

    def _drift_warning(self, facts: np.ndarray) -> str:
        """Warning if depth drifted by more than three σ since the calibration; else empty."""
        errors = facts["errors"][~np.isnan(facts["errors"][:, 0])]
        # one image alone may show an object too shallow to be found
        if len(errors) < (1 if facts["errors_known"].any() else 2):
            return ""
        median = np.median(errors, axis=0, overwrite_input=True)
        measured = _measured_pa(facts).size > 0
        return drift_warning(median, self._pipeline, gas_measured=measured)

    def _gas_warning(self, facts: np.ndarray) -> str:
        """Warning if the gas pressure contradicts the sensor file, or never changes; else empty."""
        known_pa, zero, where = self._pipeline.model.gas.P0, self._zeros.gas, self._where
        if zero is not None and zero.frozen:
            return zero.frozen_warning(where) if facts["ok"].any() else ""
        if zero is None or zero.rest_pa is None:
            measured_pa = _measured_pa(facts)
            median_pa = float(np.median(measured_pa)) if measured_pa.size else None
            return gas_warning(median_pa, known_pa, f"in the {where}")
        text = gas_warning(zero.rest_pa, known_pa, f"without contact in the {where}")
        return text if zero.used else f"{text}; it is not used, and forces are less certain"


def _gas_gaps_warning(facts: np.ndarray) -> str:
    """Warning if some frames have a gas pressure and many of the others have none; else empty."""
    missing = len(facts) - len(_measured_pa(facts))
    if not _MISSING_GAS * len(facts) < missing < len(facts):
        return ""
    return (
        f"{missing:,} of {count_of(len(facts), 'frame')} have no gas pressure at their time, and "
        "forces in these frames are less certain: check rate and stamps of the gas pressure"
    )


def _measured_pa(facts: np.ndarray) -> np.ndarray:
    """Measured gas pressures, Pa."""
    pressures_pa: np.ndarray = facts["gas_pressure_pa"]
    return pressures_pa[~np.isnan(pressures_pa)]


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
