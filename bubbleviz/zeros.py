"""Zeros of gas pressure, depth image and wrench sensor, from frames without contact.

The zero of the gas pressure removes changes of ambient pressure and the sensor's offset, the zero
of the depth image removes changes of the camera since calibration.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain, takewhile
from typing import NamedTuple

import numpy as np

from bubbleviz.averaging import StillFrames
from bubbleviz.camera import IMAGE_ERRORS, SHIFTS, ImageErrors
from bubbleviz.errors import InputError
from bubbleviz.inverse import GAS_LAG, LINEAR, RUBBER
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import LAG, Frame, FrameSource, HeldFrames, Recording, force_of
from bubbleviz.result import HALF_95, Result
from bubbleviz.sensor import ATMOSPHERES, WEATHER_SIGMA_PA, Pneumatics

ZERO_FRAMES = 15  # contact-free frames for a zero, which is their median: half a second at 30 Hz
MIN_FRAMES = 3
"""Fewest consecutive contact-free frames for the zero of a recording: a single one may be a failed
image."""
WRENCH_FRAMES = 100  # contact-free frames for the bias of a wrench sensor, which is their median
SEARCH_POINTS = 20
"""Positions in a recording where contact-free frames, or any that fit the sensor file, are
searched: no stretch of frames that is longer than 1/19 of it is missed."""
SKIPPED = 6  # live frames after one with contact that are not tested
_DRIFT_S = 600.0
"""Time after which the errors of the depth image may differ by as much as since the calibration: a
depth camera warms up in about ten minutes."""
_JITTER = 0.1
"""Standard deviation of errors of single images, relative to errors since calibration. Measured on
the real press, without contact: 0.01 mm."""
_RENEWED_S = 60.0  # time after which live frames without contact determine these errors again


def camera_moved(result: Result) -> bool:
    """Whether an image contradicted the known errors, and was solved without them."""
    known, found = result.frame.image_errors, _image_errors(result)
    if known is None or found is None or found.prior is None:
        return False
    return not np.array_equal(found.prior.mean, known.mean)


def _image_errors(result: Result) -> ImageErrors | None:
    """Errors of an image as estimated from it; None if they were not."""
    found = None if result.estimate is None else result.estimate.image_errors
    return None if found is None or found.prior is None else found


def drift_warning(errors: np.ndarray, pipeline: Pipeline, *, gas_measured: bool) -> str:
    """Warning if errors of the depth image (e,) exceed three standard deviations; else empty."""
    estimator = pipeline.estimator
    units = estimator.observer.image_errors.mean(axis=0)
    by_offset, by_scale = (units[IMAGE_ERRORS.index(name)] for name in ("offset", "scale"))
    limit = 3.0 * estimator.options.image_error
    drift_m, limit_m = float(units @ errors / by_offset), limit * by_scale / by_offset
    by_name = dict(zip(IMAGE_ERRORS, np.abs(errors), strict=True))
    of_depth = by_name["offset"] > limit_m or by_name["scale"] > limit
    shift_m = float(np.linalg.norm(errors[SHIFTS]))
    if shift_m > limit_m and not of_depth:
        return (
            f"the camera has moved sideways by about {1e3 * shift_m:.1f} mm, or turned; forces are "
            "corrected, but positions are off if it has turned. Check its mounting, and identify "
            "the sensor again"
        )
    if abs(drift_m) <= limit_m:
        return ""
    advice = "; forces are corrected for it. Let the camera warm up, or identify the sensor again"
    if not gas_measured:
        advice = (
            ", or the gas pressure, which was not recorded, has changed; forces are corrected for "
            "drift. Record the pressure, or let the camera warm up"
        )
    return f"depth has drifted by {1e3 * drift_m:+.2f} mm since the calibration{advice}"


class ImageZero:
    """Errors of the depth image, from frames without contact.

    A camera's errors change while it warms, not while an object touches the membrane for a second.
    During contact they are therefore taken from the frames without contact: estimated anew, they
    would imitate friction and deformations that the model of the membrane lacks. They follow a
    random walk, and errors of single images scatter around it. As a contact is found some frames
    after it began, the last `MIN_FRAMES` of consecutive frames are not used for them. Changes
    between all of these frames determine the noise, which may be larger than in the sensor file, or
    correlated between pixels. `fixed`: not to be renewed.
    """

    def __init__(self) -> None:
        self.fixed = False
        self.noise = 1.0  # see `Frame.noise`
        self._drift: ImageErrors | None = None  # since the calibration; None: no frame seen
        self._known: ImageErrors | None = None
        self._time_s = 0.0
        self._rest: list[Result] = []
        self._last: deque[Frame] = deque(maxlen=2 + LAG)

    def applied(self, frame: Frame) -> Frame:
        """The frame with the noise and the known errors, if any."""
        known = frame.image_errors if self._known is None else self._at(frame.time_s)
        return replace(frame, image_errors=known, noise=max(self.noise, frame.noise))

    def follow(self, result: Result, pipeline: Pipeline) -> None:
        """Use a solved frame if it belongs to consecutive frames without contact."""
        time_s = result.frame.time_s
        self._last.append(result.frame)
        recent = self._known is not None and abs(time_s - self._time_s) < _RENEWED_S
        again = bool(self._rest) and time_s <= self._rest[-1].frame.time_s
        if self.fixed or recent or again:
            return
        touched = not (_is_contact_free(result) or self._is_noise(result, pipeline))
        if not touched:
            self._rest.append(result)
        if touched or len(self._rest) == ZERO_FRAMES:
            if len(self._rest) > 1:
                self.noise, inflation = pipeline.image_noise([each.frame for each in self._rest])
                self.take(self._rest, pipeline, inflation)
            self._rest = []

    def _is_noise(self, result: Result, pipeline: Pipeline) -> bool:
        """Whether noise explains an implausible image, by changes of the images before it."""
        implausible = result.estimate is not None and result.estimate.status == "implausible"
        if not implausible or len(self._last) <= 1 + LAG:
            return False
        noise, _ = pipeline.image_noise([self._last[0], self._last[LAG]])
        noisy = replace(result.frame, noise=noise)
        return noise > result.frame.noise and pipeline.is_untouched(noisy)

    def take(self, rest: Sequence[Result], pipeline: Pipeline, inflation: float) -> None:
        """Determine the errors from consecutive solved frames without contact.

        `inflation` of the variance of their mean, as noise is correlated in time.
        """
        used = [each for each in rest[:-MIN_FRAMES] if _image_errors(each) is not None]
        moved = 2 * sum(map(camera_moved, used)) > len(used)
        if used and (moved or self._known is None):
            self._drift, self._known = pipeline.estimator.image_priors
            self._time_s = used[0].frame.time_s
        for result in used:
            self._add(result, inflation)

    def _add(self, result: Result, inflation: float) -> None:
        """Update by an image: a step of a Kalman filter, in terms of inverse covariances."""
        known, drift, found = self._known, self._drift, _image_errors(result)
        assert known is not None and drift is not None and found is not None
        prior, time_s = found.prior, result.frame.time_s
        assert prior is not None
        # the image's estimate without its prior, widened by the scatter of single images
        precision = np.linalg.inv(found.covariance) - np.linalg.inv(prior.covariance)
        weighted = np.linalg.solve(found.covariance, found.mean)
        weighted -= np.linalg.solve(prior.covariance, prior.mean)
        precision, weighted = precision / inflation, weighted / inflation
        scatter = np.eye(len(precision)) + _JITTER**2 * precision @ drift.covariance
        before = np.linalg.inv(self._walk(time_s))
        covariance = np.linalg.inv(before + np.linalg.solve(scatter, precision))
        mean = covariance @ (before @ known.mean + np.linalg.solve(scatter, weighted))
        self._known = ImageErrors(mean, covariance, by_model=found.by_model)
        self._time_s = time_s

    def _at(self, time_s: float) -> ImageErrors:
        """Errors expected in an image at a time."""
        known, drift = self._known, self._drift
        assert known is not None and drift is not None
        return replace(known, covariance=self._walk(time_s) + _JITTER**2 * drift.covariance)

    def _walk(self, time_s: float) -> np.ndarray:
        """Covariance (e, e) of the errors at a time, without the scatter of its image."""
        known, drift = self._known, self._drift
        assert known is not None and drift is not None
        walked: np.ndarray = min(abs(time_s - self._time_s) / _DRIFT_S, 1.0) * drift.covariance
        return known.covariance + walked


class PressureZero:
    """Shifts the measured gas pressure so that it equals the sensor file's without contact.

    The sensor file has gauge and atmospheric pressure of the day it was made. The weather of
    another day (±2 kPa), the altitude (±10 kPa where the file has the standard atmosphere) and the
    offset of a pressure sensor would look like contact, so they are subtracted. Until they are
    known, frames have the standard deviation of weather and altitude in `gas_sigma_pa`.
    """

    def __init__(self, pneumatics: Pneumatics) -> None:
        self._pneumatics = pneumatics
        self.offset_pa: float | None = None  # of the measured pressure; None: unknown
        self.frames = 0  # contact-free frames used for the offset
        self.frozen = False  # whether the sensor repeats one value
        self._free: list[float] = []
        self._collecting = True
        self._to_skip = 0
        # first pressure of live frames, whether another came, and counts of those without and with
        # contact
        self._first_pa: float | None = None
        self._changed, self._followed = False, [0, 0]

    @property
    def reference_pa(self) -> float:
        """Absolute pressure of the inflated, untouched bubble in the sensor file, Pa."""
        return self._pneumatics.reference_pressure_pa

    @property
    def used(self) -> bool:
        """Whether measured pressures are used.

        Not if the sensor repeats one value, or if without contact they can be neither an absolute
        pressure in Pa nor the gauge pressure, whose changes are right as well.
        """
        rest_pa, gauge_pa = self.rest_pa, self._pneumatics.gauge_pressure_pa
        possible = rest_pa is None or rest_pa > ATMOSPHERES[0] or 0.5 < rest_pa / gauge_pa < 2.0
        return possible and not self.frozen

    @property
    def waiting(self) -> bool:
        """Whether contact-free frames are still being collected."""
        return self._collecting

    def refer_to(self, pneumatics: Pneumatics) -> None:
        """Use another sensor file.

        The pressure measured at rest is kept, so the offset changes with the reference. A new zero
        is collected, as frames without contact by one sensor file may have contact by the other.
        """
        rest_pa, before_pa = self.rest_pa, self.reference_pa
        self._pneumatics = pneumatics
        if self.reference_pa != before_pa:
            self.restore(rest_pa, waiting=True)

    def zero_now(self) -> None:
        """Collect a new zero from the next contact-free frames; keep the offset until then."""
        self._free, self._collecting = [], True

    @property
    def rest_pa(self) -> float | None:
        """Pressure measured without contact, Pa; None if unknown."""
        return None if self.offset_pa is None else self.offset_pa + self.reference_pa

    def restore(self, rest_pa: float | None, *, waiting: bool) -> None:
        """Restore an earlier state of `rest_pa` and `waiting`."""
        self.offset_pa = None if rest_pa is None else rest_pa - self.reference_pa
        self._free, self._collecting = [], waiting

    def learn(
        self,
        raw_pressure_pa: float | None,
        *,
        contact_free: bool,  # by the depth image alone
    ) -> None:
        """Add the measured pressure of a frame, Pa, before correction."""
        if not self._collecting or raw_pressure_pa is None:
            return
        if not contact_free:
            self._free.clear()  # a zero comes from consecutive frames
            self._to_skip = SKIPPED
            return
        self._free.append(raw_pressure_pa)
        if len(self._free) >= ZERO_FRAMES:
            self.take(self._free)

    def watch(self, raw_pressure_pa: float, *, contact: bool) -> None:
        """Detect a live sensor that repeats one value, Pa, with and without contact."""
        if self._first_pa is None:
            self._first_pa = raw_pressure_pa
        self._changed = self._changed or raw_pressure_pa != self._first_pa
        self._followed[contact] += 1
        self.frozen = not self._changed and min(self._followed) >= ZERO_FRAMES

    def frozen_warning(self, where: str) -> str:
        """Warning about a sensor in a recording or source that repeats one value; else empty."""
        if not self.frozen:
            return ""
        return (
            f"the gas pressure in the {where} never changes, not even by contact, so it is not "
            "used and forces are less certain; check the pressure sensor"
        )

    def take(self, pressures_pa: Sequence[float]) -> None:
        """Compute the zero from the measured pressures of contact-free frames, Pa."""
        self.offset_pa = float(np.median(pressures_pa)) - self.reference_pa
        self.frames = len(pressures_pa)
        self._free, self._collecting = [], False

    @property
    def words(self) -> str:
        """Description in one line."""
        if self.frozen:
            return "gas pressure zero: none, as the recorded pressure never changes; it is not used"
        if self.offset_pa is None:
            sigma_pa = self._pneumatics.atmospheric_sigma_pa
            causes = "weather" if sigma_pa == WEATHER_SIGMA_PA else "weather and altitude"
            return (
                f"gas pressure zero: unknown (±{1e-3 * HALF_95 * sigma_pa:.0f} kPa of "
                f"{causes}, 95 %), as fewer than {MIN_FRAMES} contact-free frames in a row fit the "
                "sensor file; the gas law of the chamber is used instead"
            )
        return f"gas pressure zero: {self.offset_pa:+.0f} Pa from {self.frames} contact-free frames"

    def wants_next(self) -> bool:
        """Whether to test the next frame for contact; during contact only every sixth is."""
        self._to_skip = max(self._to_skip - 1, 0)
        return self._collecting and self._to_skip == 0

    def applied(self, frame: Frame) -> Frame:
        """The frame with corrected gas pressure, or with its standard deviation."""
        if frame.gas_pressure_pa is None:
            return frame
        if not self.used:
            return replace(frame, gas_pressure_pa=None)
        if self.offset_pa is None:
            return replace(frame, gas_sigma_pa=self._pneumatics.atmospheric_sigma_pa)
        return replace(frame, gas_pressure_pa=frame.gas_pressure_pa - self.offset_pa)


class Zeros(NamedTuple):
    """Zeros of one sensor, and the means of images that show the same."""

    gas: PressureZero | None  # None: its gas pressure is not measured, or not corrected
    image: ImageZero
    still: StillFrames | None = None  # None: each frame by its own image
    rest_frames: int | None = None  # frames of a recording without contact; None: of a stream

    @classmethod
    def of_stream(
        cls,
        gas: PressureZero | None,
        pipeline: Pipeline,
        kept: FrameSource | None = None,  # its last frames, by number; None: as given one by one
    ) -> Zeros:
        """Zeros of a stream, which are updated by its frames (`follow`)."""
        image, still = ImageZero(), None
        if _knows_errors(pipeline):
            still = StillFrames(pipeline, kept, both_sides=False)
        image.fixed = still is None
        return cls(gas, image, still)

    def of_copy(self, source: FrameSource, pipeline: Pipeline) -> Zeros:
        """Zeros of the same recording that was opened again, for an equal pipeline."""
        still = None if self.still is None else StillFrames(pipeline, source)
        return self._replace(still=still)

    def applied(self, frame: Frame) -> Frame:
        """The frame with corrected gas pressure, known errors and mean of the depth image."""
        frame = self.image.applied(frame if self.gas is None else self.gas.applied(frame))
        return frame if self.still is None else self.still.applied(frame)

    def zeroed(self, frame: Frame, pipeline: Pipeline) -> Frame:
        """The same, after use of the frame for the zero of the gas pressure if it is collected."""
        gas, measured_pa = self.gas, frame.gas_pressure_pa
        if gas is not None and measured_pa is not None and gas.wants_next():
            frame = replace(frame, noise=self.image.noise)
            gas.learn(measured_pa, contact_free=pipeline.is_untouched(frame))
        return self.applied(frame)

    def follow(self, raw: Frame, result: Result, pipeline: Pipeline) -> None:
        """Use a solved live frame, given too as it was measured; zeros of recordings are fixed."""
        self.image.follow(result, pipeline)
        if not self.image.fixed and self.gas is not None and raw.gas_pressure_pa is not None:
            contact = result.estimate is not None and result.estimate.status == "ok"
            self.gas.watch(raw.gas_pressure_pa, contact=contact)


def zeros_of(source: FrameSource, pipeline: Pipeline) -> Zeros:
    """Zeros of a recording, the same for all of its frames, from some without contact.

    They are searched at the start, then at positions spread over the recording. The zeros are
    unknown if there are none. Frames held one by one are not averaged with their neighbours.
    """
    rest, image, still = _rest_of(source, pipeline), ImageZero(), None
    if _knows_errors(pipeline):
        if rest:
            image.noise, inflation = pipeline.image_noise(rest)
            image.take(_solved_alone(rest, image.noise, pipeline), pipeline, inflation)
        if not isinstance(source, HeldFrames):  # their frames are not neighbours
            still = StillFrames(pipeline, source)
    image.fixed = True
    if all(each.gas_pressure_pa is None for each in chain(rest, _samples(source))):
        return Zeros(None, image, still, len(rest))
    gas = PressureZero(pipeline.model.sensor.pneumatics)
    measured = [each.gas_pressure_pa for each in rest if each.gas_pressure_pa is not None]
    if len(measured) >= MIN_FRAMES:
        gas.frozen = len(set(measured)) == 1 and _is_frozen(source)
        if not gas.frozen:
            gas.take(measured)
    gas.restore(gas.rest_pa, waiting=False)
    return Zeros(gas, image, still, len(rest))


def _knows_errors(pipeline: Pipeline) -> bool:
    """Whether the estimator models errors of the whole depth image, unlike the paper's."""
    return pipeline.estimator.solver_name in (RUBBER, LINEAR)


def _rest_of(source: FrameSource, pipeline: Pipeline) -> list[Frame]:
    """Longest run of frames without contact that was found, at least `MIN_FRAMES`, or none."""
    longest: list[Frame] = []
    starts = np.unique(np.linspace(0, len(source) - MIN_FRAMES, SEARCH_POINTS).astype(int))
    examined = -1
    for start in starts[starts >= 0].tolist():
        if start <= examined:  # in a short recording: within a run, or at the contact after it
            continue
        rest = _rest_from(source, start, pipeline)
        longest, examined = max(longest, rest, key=len), start + len(rest)
        if len(longest) == ZERO_FRAMES:
            break
    return longest if len(longest) >= MIN_FRAMES else []


def _rest_from(source: FrameSource, start: int, pipeline: Pipeline) -> list[Frame]:
    """Consecutive frames without contact by their depth alone, from `start` on."""
    rest: list[Frame] = []
    for index in range(start, min(start + ZERO_FRAMES, len(source))):
        frame = _contact_free(source, index, pipeline)
        if frame is None:
            break
        rest.append(frame)
    return rest


def _solved_alone(rest: Sequence[Frame], noise: float, pipeline: Pipeline) -> list[Result]:
    """Results of frames by their depth alone, up to the first one with contact."""
    alone = [replace(frame, gas_pressure_pa=None, noise=noise) for frame in rest]
    results = [Result(each, estimate=pipeline.estimate_once(each)) for each in alone]
    return list(takewhile(_is_contact_free, results))


def _is_contact_free(result: Result) -> bool:
    return result.estimate is not None and result.estimate.status == "no_contact"


def _gas_changes(frames: Iterable[Frame], pipeline: Pipeline) -> bool:
    """Whether gas pressures of frames differ by more than errors of measurement can.

    They do while a press grows or ends quickly.
    """
    known = [each.gas_pressure_pa for each in frames if each.gas_pressure_pa is not None]
    largest = GAS_LAG * pipeline.model.sensor.pneumatics.gauge_pressure_pa
    return bool(known) and max(known) - min(known) > largest


def _explained_by_contact(frame: Frame, pipeline: Pipeline) -> bool:
    """Whether a contact explains most of the residual of an image that noise explains, too.

    Presses that differ in all frames look like noise. But no contact explains three quarters of the
    squares of noise, even in a fit that is implausible, as it has far fewer unknowns than there are
    pixels. And a contact that is found in spite of that noise is one.
    """
    alone = replace(frame, gas_pressure_pa=None)
    noise = pipeline.estimate_once(alone)
    if noise.status == "ok":
        return True
    contact = pipeline.estimate_once(replace(alone, noise=1.0))
    if np.isnan(noise.residual_rms_m):  # the fit by noise failed: no sign of noise
        return contact.trusted
    return contact.residual_rms_m < 0.5 * noise.residual_rms_m  # false without a fit: NaN


def wrench_bias(source: FrameSource, pipeline: Pipeline) -> np.ndarray | None:
    """Bias of the wrench sensor: median force (3,) of the first contact-free frames, N.

    The same for all frames of a recording, whichever are solved; None if none is contact-free.
    """
    *_, bias = search_wrench_bias(source, pipeline)
    return None if bias is None or np.isnan(bias).any() else bias


def search_wrench_bias(source: FrameSource, pipeline: Pipeline) -> Iterator[np.ndarray | None]:
    """Yield None after each examined frame, then the bias; NaN if no frames are contact-free."""
    rest: list[np.ndarray] = []
    measured = any(each.wrench is not None for each in _samples(source))
    for index in range(len(source) if measured else 0):
        free = _contact_free(source, index, pipeline)
        if free is not None:
            rest.append(force_of(free.wrench))
        elif len(rest) < MIN_FRAMES:
            rest.clear()
        if len(rest) == WRENCH_FRAMES or (rest and free is None):
            break
        yield None
    known = [force for force in rest if np.isfinite(force).all()]
    yield np.median(known, axis=0) if known else np.full(3, np.nan)


def _is_frozen(source: FrameSource) -> bool:
    """Whether a recording repeats one gas pressure to the last bit.

    A working sensor varies by noise and by contact, a simulation by contact.
    """
    if not isinstance(source, Recording):
        return False
    pressures = source.gas_pressures_pa(1000)  # of all parts of a long recording
    return len(pressures) > ZERO_FRAMES and len(set(pressures)) == 1


def _samples(source: FrameSource) -> Iterator[Frame]:
    """First and middle frame, if they can be read: sensors may start late."""
    for index in (0, len(source) // 2):
        with suppress(InputError):
            yield source[index]


def _contact_free(source: FrameSource, index: int, pipeline: Pipeline) -> Frame | None:
    """A frame if it can be read and its depth image shows no contact."""
    try:
        frame = source[index]
        if pipeline.is_untouched(frame):
            return frame
        if not _knows_errors(pipeline):
            return None
        # Noise changes images before a frame as much as those from it on, and not the gas pressure.
        # A contact that begins, or a camera that moves, does not.
        spans = (max(index - 1 - LAG, 0), index - 1), (index, min(index + LAG, len(source) - 1))
        pairs = [(source[first], source[last]) for first, last in spans if first < last]
        if _gas_changes(chain(*pairs), pipeline):
            return None
        noises = (pipeline.image_noise(pair)[0] for pair in pairs)
        frame = replace(frame, noise=min(noises, default=1.0))
        untouched = frame.noise > 1.0 and pipeline.is_untouched(frame)
        return frame if untouched and not _explained_by_contact(frame, pipeline) else None
    except InputError:
        return None
