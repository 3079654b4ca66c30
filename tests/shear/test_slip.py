"""Slip is detected soon after its onset, and not while everything sticks."""

from dataclasses import replace

import numpy as np
import pytest

from tests.oracles.stuck_press import Motion
from tests.shear.drag import Eyes, press, slides

STEP_M = 2.5e-4
STICKING = 3


def slips(name, depth_m, frames, sliding_beyond):
    """Of every frame of a drag; after some of them an outer ring of the contact stays behind."""
    path, away = press(name, depth_m)
    radius = sliding_beyond * away[path.touching].max()
    motions = []
    for k in range(frames):
        drag = k * STEP_M
        late = max(0, k - STICKING) / max(k, 1)
        lost = np.where(away > radius, late, 0.0)
        motions.append(Motion(np.array([drag, 0.3 * drag, 0.0]), 10.0 * drag, lost))
    eyes, found = Eyes(1000), []
    for seed, truth in enumerate(path.along(motions)):
        frame = eyes.see(truth, seed)
        found.append(eyes.pipeline.process(frame, frozenset({"slip"})).slip)
    return found


@pytest.mark.parametrize(
    ("name", "depth_m", "poses"),
    [
        ("puck", 0.005, [(k * 4e-4, 0.0) for k in range(9)]),
        *(
            pytest.param(name, depth_m, poses, marks=pytest.mark.long)
            for name, depth_m, poses in (
                ("sphere", 0.008, [(k * 4e-4, 0.0) for k in range(11)]),
                ("puck", 0.005, [(k * 4e-4, 0.0) for k in (*range(6), *range(4, -7, -1))]),
                ("puck", 0.005, [(0.0, 0.03 * k) for k in range(12)]),
            )
        ),
    ],
)
def test_slip_by_coulombs_law_until_all_of_the_patch_slides(name, depth_m, poses):
    """A part of it still seems rigid then, and would be taken for one that sticks."""
    eyes, told, true, longest_m = Eyes(1000), [], [], []
    for seed, (truth, share, slid_m) in enumerate(slides(name, depth_m, 0.5, poses)):
        told.append(eyes.pipeline.process(eyes.see(truth, seed), frozenset({"slip"})).slip)
        true.append(share)
        longest_m.append(slid_m)
    for slip, share in zip(told, true, strict=True):
        assert slip is None or abs(slip.share - share) < 2.0 * slip.share_sigma + 0.05
    assert told[0] is None  # nothing to compare with
    assert [slip.share for slip in told[1:3]] == [0.0, 0.0]
    begun = np.argmax(np.array(true) > 0.2) + 1
    assert told[begun].share > 0.0
    slipped_m = np.linalg.norm(told[begun].slip_m, axis=1)
    assert 5e-5 < slipped_m.max() < longest_m[begun]  # which is at the edge
    whole = np.argmax(np.array(true) > 0.95)
    assert whole and told[whole + 1 :] == [None] * (len(poses) - whole - 1)


@pytest.mark.long
def test_slip_of_a_contact_of_few_nodes_is_told_or_unknown():
    """A ball touches a circle 11 mm across, on a mesh with edges of 3 mm; 4 mm of it stick."""
    found = slips("sphere", 0.004, STICKING + 2, 0.4)
    assert all(slip is not None and slip.share == 0.0 for slip in found[1:-1])
    assert found[-1] is None or found[-1].share > 2.0 * found[-1].share_sigma


@pytest.mark.long  # in short: the first frames above, and below
def test_no_alarm_while_everything_sticks():
    found = [slip for slip in slips("puck", 0.005, 10, 10.0) if slip is not None]
    assert len(found) == 9
    assert np.mean([slip.share > 0.0 for slip in found]) < 0.05


def test_no_alarm_by_errors_of_facets():
    """A ball that turns brings other facets to each place; the flow is better than they are."""
    path, _ = press("sphere", 0.010)
    eyes, found = Eyes(), []
    motions = [Motion(np.zeros(3), np.radians(4.0 * k)) for k in range(4)]
    for k, truth in enumerate(path.along(motions)):
        frame = eyes.see(truth, k, flow_px=0.01)
        found.append(eyes.pipeline.process(frame, frozenset({"slip"})).slip)
    assert found[0] is None  # nothing to compare with
    assert [slip is not None and slip.share for slip in found[1:]] == [0.0, 0.0, 0.0]


def test_slip_is_measured_from_the_same_contact_only():
    """A jump or an outage may have led to another contact; frames left out in playback have not."""
    path, _ = press("puck", 0.005)
    eyes = Eyes()
    motions = [Motion(k * STEP_M * np.array([1.0, 0.3, 0.0]), 0.0) for k in range(4)]
    frames = [eyes.see(truth, k) for k, truth in enumerate(path.along(motions))]

    def slip_of(index, time_s):
        frame = replace(frames[index], time_s=time_s)
        return eyes.pipeline.process(frame, frozenset({"slip"})).slip

    assert slip_of(0, 0.0) is None  # nothing to compare with
    assert slip_of(0, 0.0) is None  # nor when the same frame is solved again
    assert slip_of(1, 0.1) is not None
    assert slip_of(3, 0.2) is not None  # a frame was left out
    assert slip_of(3, 0.2) is not None
    assert slip_of(1, 0.1) is None  # back
    assert slip_of(2, 0.2) is not None
    assert slip_of(3, 5.0) is None  # after an outage
    assert slip_of(0, 0.0) is None
    assert slip_of(1, 0.1) is not None
    eyes.pipeline.restart()
    assert slip_of(1, 0.1) is not None  # solved from rest
    eyes.pipeline.use_optical_flow(eyes.pipeline.optical_flow)
    assert slip_of(2, 0.2) is None
    assert slip_of(0, 0.0) is None
    assert slip_of(2, 1.0) is None  # jumped forward
    assert slip_of(3, 2.0) is not None  # the next frame of a slow recording


@pytest.mark.long  # in short: by Coulomb's law, above
def test_slip_is_unknown_after_all_of_a_patch_has_slipped():
    """Its points move together then, as if they stuck; a new contact is compared with itself."""
    path, away = press("puck", 0.005)
    inwards, behind, motions = away / away[path.touching].max(), np.zeros_like(away), []
    for k, sticks in enumerate((1.0, 1.0, 0.6, 0.4, 0.2, 0.0, 0.0)):
        behind += inwards > sticks  # steps that a node did not follow
        drag = max(1, k) * STEP_M * np.array([1.0, 0.3, 0.0])
        motions.append(Motion(drag, lost=behind / max(1, k)))
    eyes = Eyes(1000)

    def found(truth, seed):
        frame = eyes.see(truth, seed)
        return eyes.pipeline.process(frame, frozenset({"slip"})).slip

    shares = [found(truth, seed) for seed, truth in enumerate(path.along(motions))]
    assert shares[2] is not None and shares[2].share > 0.0
    assert shares[-2:] == [None, None]
    eyes.pipeline.process(eyes.rest(), frozenset({"slip"}))
    again = [found(truth, 9) for truth in list(path.along(motions[:1])) * 2]
    assert again[1] is not None and again[1].share == 0.0


def test_slip_is_unknown_after_too_few_points_were_left_to_compare_with():
    """What moves together from then on may stick or slide."""
    wide, _ = press("puck", 0.005)
    narrow, _ = press("sphere", 0.001)
    eyes, still = Eyes(), Motion(np.zeros(3))

    def found(path, seed):
        frame = eyes.see(next(iter(path.along([still]))), seed)
        return eyes.pipeline.process(frame, frozenset({"slip"})).slip

    slips = [found(path, seed) for seed, path in enumerate([wide, wide, narrow, wide, wide, wide])]
    assert slips[1] is not None
    assert slips[2:] == [None] * 4
