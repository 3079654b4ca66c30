"""Poses in a recording, searched for where the contact is largest.

A light contact fits many poses. Where the pose is to be found, frames wait until their contact has
ended. A pose is followed to its largest patch and compared there with all initial poses; the best
is then followed back to the first frame, and ahead.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from copy import copy
from dataclasses import replace

from bubbleviz.pipeline import Pipeline
from bubbleviz.pose import MAX_GAP_S, UNKNOWN_S, PoseTracker
from bubbleviz.progress import Progress
from bubbleviz.result import Result

_MOST_HELD = 64
"""Most frames that wait, a bound of memory: 2 s at 30 Hz, up to 165 MB of 640 × 480 pixels."""


def with_poses(
    results: Iterable[Result],  # of a recording in order, which have estimate and patch
    pipeline: Pipeline,
    progress: Progress,  # of each search
) -> Iterator[Result]:
    """The results with the pose added."""
    tracker = pipeline.tracker
    assert tracker is not None
    for result in _followed(results, pipeline, tracker, progress):
        assert result.pose is not None
        yield replace(result, pose=tracker.reported(result.pose))


def _followed(
    results: Iterable[Result], pipeline: Pipeline, tracker: PoseTracker, progress: Progress
) -> Iterator[Result]:
    held: list[Result] = []
    for result in results:
        if len(held) == _MOST_HELD or _has_ended(held, result):
            yield from _found(held, pipeline, tracker, progress)
            held = []
        if held or (_contact_area_m2(result) and tracker.is_unknown(result.frame.time_s)):
            held.append(result)
        else:
            yield _with_pose(result, pipeline, tracker)
    yield from _found(held, pipeline, tracker, progress)


def _found(
    held: list[Result], pipeline: Pipeline, tracker: PoseTracker, progress: Progress
) -> Iterator[Result]:
    """Results of one contact, with poses by that of the largest patch in which one is found."""
    largest_first = sorted(range(len(held)), key=lambda k: -_contact_area_m2(held[k]))
    for j in range(largest_first[0] if held else 0):
        held[j] = _with_pose(held[j], pipeline, tracker)
    for count, k in enumerate(largest_first):
        progress("searching for the object", count / len(held))
        held[k] = _with_pose(held[k], pipeline, tracker, search=True)
        if (pose := held[k].pose) is not None and pose.status == "ok":
            break
    else:
        yield from held
        return
    earlier = copy(tracker)
    for j in range(k - 1, -1, -1):
        held[j] = _with_pose(held[j], pipeline, earlier)
    yield from held[: k + 1]
    for result in held[k + 1 :]:
        yield _with_pose(result, pipeline, tracker)


def _with_pose(
    result: Result, pipeline: Pipeline, tracker: PoseTracker, *, search: bool = False
) -> Result:
    def add(result: Result) -> Result:
        return replace(result, pose=tracker.find(result.frame, *result.solution, search=search))

    return pipeline.extended(result, "pose", add)


def _contact_area_m2(result: Result) -> float:
    """Area of the patch; 0 without a trusted estimate."""
    estimate, patch = result.solution
    return patch.area_m2 if estimate.status == "ok" else 0.0


def _has_ended(held: list[Result], result: Result) -> bool:
    """Whether a frame does not belong to the contact of those before it."""
    touched_s = [each.frame.time_s for each in held if _contact_area_m2(each)]
    if not touched_s:
        return False
    longest_s = MAX_GAP_S if _contact_area_m2(result) else UNKNOWN_S
    return not 0.0 <= result.frame.time_s - touched_s[-1] <= longest_s
