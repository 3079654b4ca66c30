"""Traction with friction against membranes that stick to known objects, on another, finer mesh."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.shear import along_error_m
from bubbleviz.api.estimator import FrameSolver
from bubbleviz.camera import ColourImage
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import NO_COLOUR, Recording
from bubbleviz.sensor import load_sensor
from bubbleviz.shear import watch_recorded_texture
from bubbleviz.simulation import DepthNoise
from tests.shear.drag import Eyes, sensor, stuck


def test_traction_of_an_object_that_is_dragged_and_twisted():
    truth, eyes = stuck("puck", 0.004, 0.001, 8.0), Eyes(1000)
    result = eyes.pipeline.process(eyes.see(truth), frozenset({"traction"}))
    (estimate, patch), traction = result.solution, result.traction
    assert traction.status == "ok", traction.reason
    force, true = estimate.force_n, truth.force_n
    size = np.linalg.norm(true)
    assert np.linalg.norm(force - true) < 0.03 * size
    cosine = force @ true / (np.linalg.norm(force) * size)
    assert np.degrees(np.arccos(min(1.0, cosine))) < 3.0
    along = force / np.linalg.norm(force)
    sigma = np.sqrt(along @ estimate.wrench_covariance[:3, :3] @ along)
    assert abs(along @ (force - true)) < 2.0 * sigma < 0.06 * size
    about = truth.center_m
    torque = patch.torque_nm + np.cross(patch.center_of_pressure_m - about, force)
    assert torque[2] == pytest.approx(truth.torque_nm(about)[2], rel=0.05)
    assert along_error_m(estimate, truth, eyes.pipeline.mesh) < 5e-5
    assert np.linalg.norm(patch.center_of_pressure_m - truth.center_m) < 1e-3


@pytest.fixture(scope="module")
def dragged():
    """The truth of a puck that was dragged and twisted, and its frame as both cameras solve it."""
    truth, eyes = stuck("puck", 0.004, 0.001, 8.0), Eyes()
    frame = eyes.see(truth)
    return truth, eyes, frame, eyes.pipeline.process(frame, frozenset({"traction", "slip"}))


def test_a_press_without_friction_has_no_shear():
    """The shear found is noise of the flow, within its uncertainty."""
    truth, eyes = stuck("puck", 0.004, 0.0, 0.0), Eyes()
    shear = eyes.solve(eyes.see(truth))[0].friction_n.sum(axis=0)
    assert np.linalg.norm(shear) < 0.01 * np.linalg.norm(truth.force_n)


def test_a_frame_has_one_force_and_flow_improves_it(dragged):
    truth, _, frame, both = dragged
    for_patch = {"fine_contact", "patch"}
    assert both.times_ms.keys() == {"estimate", "flow", "traction", "slip", "total"} | for_patch
    alone = Pipeline.of(sensor(600))
    by_depth = alone.process(frame, frozenset({"estimate"})).estimate
    assert set(alone.counts) == {"estimate", "total"}
    size = np.linalg.norm(truth.force_n)
    by_both, without = (
        np.linalg.norm(found.force_n - truth.force_n) / size for found in (both.estimate, by_depth)
    )
    assert by_both < min(0.02, without)


def test_a_contact_of_a_single_node_is_solved_with_flow():
    truth, eyes = stuck("puck", 0.0006, 0.0, 0.0), Eyes(150)
    frame = eyes.see(truth)
    alone = eyes.pipeline.process(frame, frozenset({"estimate"})).estimate
    assert np.count_nonzero(alone.contact_pressure_pa) == 1
    eyes.pipeline.restart()
    estimate, traction = eyes.solve(frame)
    assert traction.status == "ok", traction.reason
    error = estimate.force_n - truth.force_n
    assert np.linalg.norm(error) < 0.05 * np.linalg.norm(truth.force_n)


def test_flow_shows_that_a_rim_is_held_better_than_was_assumed():
    """That of the simulated membrane does not move; 1 mm of slack costs the force 2.6 % else."""
    truth, eyes = stuck("puck", 0.004, 0.001, 8.0), Eyes(rim_slack_m=1e-3)
    estimate, _ = eyes.solve(eyes.see(truth))
    error = estimate.force_n - truth.force_n
    assert np.linalg.norm(error) < 0.01 * np.linalg.norm(truth.force_n)


def test_a_force_by_flow_that_differs_from_that_by_depth_has_a_larger_sigma():
    """It shows another moment, by some standard deviations."""
    now, later = stuck("sphere", 0.006, 0.0, 0.0), stuck("sphere", 0.006, 2e-4, 0.0)
    eyes = Eyes()
    frames = [eyes.see(each) for each in (now, later)]
    in_time = eyes.solve(frames[0])[0]
    eyes.flows[0] = eyes.flows[0]._replace(flow=eyes.flows[1].flow)
    early = eyes.solve(frames[0])[0]
    assert (np.abs(early.force_n - now.force_n) < 1.96 * early.force_sigma_n).all()
    assert early.force_sigma_n[0] > 1.5 * in_time.force_sigma_n[0]


def test_a_second_frame_starts_warm_or_from_rest(dragged):
    _, eyes, frame, both = dragged
    first = both.solution[0]
    eyes.pipeline.restart()
    again, second = (eyes.solve(frame)[0] for _ in range(2))
    np.testing.assert_array_equal(again.nodal_force_n, first.nodal_force_n)
    np.testing.assert_allclose(second.force_n, first.force_n, rtol=0.01, atol=0.01)


def test_a_contact_without_texture_is_solved_by_depth_only():
    truth, eyes = stuck("puck", 0.004, 0.0, 0.0), Eyes()
    frame, wanted = eyes.see(truth), frozenset({"traction", "slip"})
    flow = eyes.flows[0].flow
    middle = np.divmod(flow.pixel, 400)[1] < 100  # far from the contact
    eyes.flows[0] = eyes.flows[0]._replace(
        flow=replace(
            flow,
            pixel=flow.pixel[middle],
            moved_px=flow.moved_px[middle],
            sigma_px=flow.sigma_px[middle],
        )
    )
    bare = eyes.pipeline.process(frame, wanted)
    eyes.pipeline.use_optical_flow(None)
    blind = eyes.pipeline.process(frame, wanted)
    seen = replace(frame, find_colour=lambda _: ColourImage(lambda: None, time_s=0.0))
    unlearned = eyes.pipeline.process(seen, wanted)
    for result, reason in (
        (bare, "no flow on most of the contact"),
        (blind, NO_COLOUR),
        (unlearned, "no contact-free reference images"),
    ):
        assert result.traction.status == "depth_alone"
        assert reason in result.traction.reason
        assert result.slip is None


def test_colour_that_contradicts_depth_is_not_used_and_told():
    """Of a ball that is dragged by 0.6 mm afterwards, at 1 % of depth noise; none if in time."""
    now, later = stuck("sphere", 0.006, 0.0, 0.0), stuck("sphere", 0.006, 6e-4, 0.0)
    eyes, noise = Eyes(), DepthNoise(absolute_m=7e-4)
    frames = [eyes.see(each, noise=noise) for each in (now, later)]
    solver = FrameSolver(eyes.pipeline, frozenset({"patch", "traction", "slip"}))
    assert [solver.solve(each).traction.status for each in frames] == ["ok", "ok"]
    assert solver.warnings() == []
    eyes.flows[0] = eyes.flows[0]._replace(flow=eyes.flows[1].flow)
    eyes.pipeline.restart()
    led = solver.solve(frames[0])
    assert led.traction.status == "depth_alone"
    assert "--colour-delay" in led.traction.reason
    assert led.slip is None
    error, sigma = led.estimate.force_n - now.force_n, led.estimate.force_sigma_n
    assert (np.abs(error) < 1.96 * sigma).all()
    (warning,) = solver.warnings()
    assert warning.startswith("colour contradicts depth in 1 frame,")


@pytest.mark.long  # in short: slower, above
def test_fast_colour_of_another_moment_hardly_moves_the_force():
    """Most of it is noise of the flow then, by the shape that depth alone has."""
    now, later = stuck("puck", 0.004, 0.0, 0.0), stuck("puck", 0.004, 0.002, 0.0)
    eyes = Eyes()
    frames = [eyes.see(each) for each in (now, later)]
    eyes.flows[0] = eyes.flows[0]._replace(flow=eyes.flows[1].flow)
    estimate, _ = eyes.solve(frames[0])
    assert np.linalg.norm(estimate.force_n - now.force_n) < 0.02 * np.linalg.norm(now.force_n)


def test_without_friction_colour_is_not_used():
    """Only friction could explain motion along the membrane."""
    truth, eyes = stuck("puck", 0.004, 0.0, 0.0), Eyes(friction=0.0)
    estimate, traction = eyes.solve(eyes.see(truth))
    assert traction.status == "depth_alone"
    assert traction.reason == "the expected coefficient of friction is 0"
    assert not traction.tangential_pa.any()
    np.testing.assert_allclose(estimate.force_n, truth.force_n, atol=0.05)


def test_flow_that_is_less_precise_than_it_says_loses_no_frame():
    """From rest, and after the same frame by depth alone: its noise factor is not known yet."""
    truth, eyes = stuck("puck", 0.004, 0.001, 8.0), Eyes()
    frame = eyes.see(truth, flow_px=0.3)
    flow = eyes.flows[0].flow
    sure = replace(flow, sigma_px=flow.sigma_px / 30.0)
    eyes.flows[0] = eyes.flows[0]._replace(flow=sure)
    for warm in (False, True):
        eyes.pipeline.restart()
        if warm:
            eyes.pipeline.process(frame, frozenset({"estimate"}))
        estimate, traction = eyes.solve(frame)
        assert traction.status == "ok", traction.reason
        error = np.linalg.norm(estimate.force_n - truth.force_n)
        assert error < 0.05 * np.linalg.norm(truth.force_n)


@pytest.mark.long  # in short: of the puck, above
def test_frames_of_the_real_press_are_solved_alone_as_in_order(punyo_press_colour):
    """Their flow is some fifteen times less precise than it says."""
    with Recording(punyo_press_colour) as press:
        pipeline = Pipeline.of(load_sensor("punyo_oval_d405"), press.intrinsics)
        watch_recorded_texture(pipeline, press, lambda: range(45, 55))
        wanted, chosen = frozenset({"traction"}), (67, 70)
        in_order = {k: pipeline.process(press[k], wanted) for k in range(62, 71)}
        for k in chosen:
            pipeline.restart()
            alone = pipeline.process(press[k], wanted)
            assert alone.traction.status == "ok", alone.traction.reason
            force = in_order[k].estimate.force_n
            np.testing.assert_allclose(alone.estimate.force_n, force, atol=0.1)


def test_sigma_of_the_torque_grows_with_the_lever(dragged):
    """As forces and their covariance move it."""
    truth, estimate = dragged[0], dragged[-1].solution[0]
    far = estimate.torque_sigma_about(truth.center_m - np.array([0.0, 0.0, 10.0]))
    np.testing.assert_allclose(far[:2], 10.0 * estimate.force_sigma_n[1::-1], rtol=0.05)
    assert far[2] == pytest.approx(estimate.torque_sigma_about(truth.center_m)[2])
