"""The names of `import bubbleviz`, on small simulated presses and on the real one."""

import gc
import pickle
import re
import shutil
import sys
import warnings
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh
from small_press import HEIGHTS, record, small_source, write_press
from trimesh.viewer.notebook import scene_to_html

import bubbleviz as bv
from bubbleviz.api.simulating import Simulation
from bubbleviz.files import parse_pose
from bubbleviz.inverse import mean_pressure
from bubbleviz.processes import check_cluster
from bubbleviz.recordings import Recording
from bubbleviz.result import Pose
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor import changed, with_colour_delay
from bubbleviz.shear import OpticalFlow
from bubbleviz.simulation import SyntheticSource
from bubbleviz.wording import plus_minus
from tests.program import output_of, python

TOUCHING = [k for k, height in enumerate(HEIGHTS) if height < 0.05]


@pytest.fixture(scope="module")
def frames(press):
    return bv.open(press)


@pytest.fixture(scope="module")
def estimated(frames, sensor):
    """The run of all frames."""
    return bv.estimate(frames, sensor)


def test_a_notebook_kernel_estimates(press, sensor):
    """Open3D detects a Jupyter kernel by the class of its shell, and then loads more."""
    code = (
        "import builtins; builtins.get_ipython = type('ZMQInteractiveShell', (), {})\n"
        "import bubbleviz as bv\n"
        f"print(bv.estimate(bv.open({str(press)!r})[2:3], {str(sensor)!r}).status[0])"
    )
    assert python(code).strip() == "ok"


def test_every_public_name_exists_and_has_a_docstring():
    assert set(bv.__all__) <= set(dir(bv))
    for name in bv.__all__:
        assert getattr(bv, name).__doc__
    with pytest.raises(AttributeError, match="fly"):
        bv.fly  # noqa: B018


def test_type_information_is_shipped():
    assert (Path(bv.__file__).parent / "py.typed").is_file()


POSE = "0 0 0.044 0 0 0 1"
INIT = "0.005 0 0.044 0 0 0 1"
"""Of the cylinder in the press, so that its pose is not searched for."""


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda f, s: bv.estimate(f, s, friction=-1.0), "--friction -1.0: .* number of 0 or more"),
        (lambda f, s: bv.estimate(f, s, kappa="2"), "--kappa 2: give a finite number"),
        (lambda f, s: bv.estimate(f, s, out=3), "output: expected str or PathLike, not int"),
        (lambda f, s: bv.estimate(None, s), "not a NoneType"),
        (lambda f, s: bv.estimate("", s), "recording: the path is empty"),
        (lambda f, s: bv.estimate([np.ones((3, 4))], s), "ndarray; use bv.Estimator for arrays"),
        (lambda f, s: bv.estimate(["press.mcap"], s), "not a str"),
        (lambda f, s: bv.estimate(iter(()), s), "not a tuple_iterator"),
        (lambda f, s: bv.estimate(f[3:3], s), "no frames were given"),
        (lambda f, s: bv.track(f, "cylinder", s, init=np.eye(3)), "not a finite 4×4 matrix"),
        (lambda f, s: bv.track(f, None, s), "object: expected str or PathLike, not NoneType"),
        (lambda f, s: bv.Estimator(s, init=POSE), "the pose of an object, which is not given"),
        (lambda f, s: bv.Estimator(s, intrinsics={}), "intrinsics: expected Intrinsics .*not dict"),
        (lambda f, s: bv.Estimator("auto"), "a recording to choose the sensor by; give Estimator"),
        (lambda f, s: bv.Estimator(s, solver="magic"), "no such solver"),
        (lambda f, s: bv.Estimator(None), "sensor file: expected str or PathLike, not NoneType"),
        (lambda f, s: bv.identify(f, s, surface="cone"), "--surface cone: .* one of .*ellipsoid"),
        (lambda f, s: bv.identify(f, s, level_sigma=-1.0), "--level-sigma -1.0"),
        (lambda f, s: bv.identify(f, s, nodes="a"), "--nodes a: .* whole number from 30 to 20000"),
        (lambda f, s: bv.identify(f, s, contact_free=[0.5]), "frame: expected int .*not float"),
        (lambda f, s: bv.identify(f[0], s), "frames: expected Frames .*not Frame"),
        (lambda f, s: bv.compare(f, "a.mcap", align="size"), "--align size: .* one of time, con"),
        (lambda f, s: bv.info(f[0]), "recording: expected .*not Frame"),
        (lambda f, s: bv.export(f, "x.csv", s, what=3), "what: expected str or Sequence, not int"),
        (lambda f, s: bv.convert("x", "y", rate_hz=0), "--rate 0: .* from 0.01 to 10000"),
        (lambda f, s: bv.convert("x", "y", metres_per_unit=np.nan), "--metres-per-unit nan: give"),
        (lambda f, s: bv.batch("x", "y", jobs=True), "--jobs True: give a whole number"),
        (lambda f, s: bv.batch("x", "y", jobs=0), "--jobs 0: give a whole number of 1 or more"),
        (lambda f, s: bv.save_sensor("auto", "x.toml"), "sensor: expected Sensor, not str"),
        (lambda f, s: bv.simulate(s, "cylinder", np.diag([1, 1, -1, 1])), "3×3 part is not a rota"),
        (lambda f, s: bv.simulate(s, "cylinder", POSE, model="wood"), "--model wood: choose one"),
        (
            lambda f, s: bv.simulate(s, "cylinder", POSE, frames=2.5),
            "--frames 2.5: .* whole number",
        ),
        (
            lambda f, s: bv.simulate(s, "cylinder", POSE, friction=5.1),
            "--friction 5.1: .* from 0 to 5",
        ),
        (
            lambda f, s: bv.simulate(s, "cylinder", POSE, seed=-1),
            "--seed -1: .* number of 0 or more",
        ),
        (lambda f, s: bv.simulate(s, "cylinder", POSE, rate_hz=0.0), "--rate 0.0: .* from 0.01 to"),
        (
            lambda f, s: bv.simulate(s, "cylinder", POSE, noise_relative=50),
            "relative = 50: .*below 1",
        ),
        (lambda f, s: bv.publish("synthetic:", duration_s=-1), "--duration -1: give a finite"),
        (lambda f, s: bv.publish("synthetic:", domain=-1), "-1: give a whole number from 0 to 232"),
        (lambda f, s: bv.watch("synthetic:", s, duration_s=-1), "--duration -1: give a finite"),
        (
            lambda f, s: bv.watch("synthetic:", s, duration_s=1, ca="x"),
            "--ca: for results that are",
        ),
        (lambda f, s: bv.connect("synthetic:", s, timeout_s=-1), "timeout_s -1: give a finite"),
    ],
)
def test_arguments_are_checked_as_options_are(call, words, frames, sensor):
    with pytest.raises(bv.InputError, match=words):
        call(frames, sensor)


def test_an_empty_run_has_no_table_and_no_file(estimated, tmp_path):
    empty = estimated[3:3]
    for read in (empty.table, empty.dataset, empty.plot, lambda: empty.save(tmp_path / "r.npz")):
        with pytest.raises(bv.InputError, match="no frames were given"):
            read()
    assert not list(tmp_path.iterdir())


def test_the_time_out_of_a_loop_over_a_stream_is_checked(sensor):
    with (
        bv.connect("synthetic:", sensor) as stream,
        pytest.raises(bv.InputError, match="timeout_s nan"),
    ):
        bv.estimate(stream, timeout_s=np.nan)


def test_a_slice_of_a_simulation_is_saved_alone(sensor, tmp_path):
    press = Simulation(small_source(sensor, HEIGHTS))
    press[2:4].save(tmp_path / "some.mcap", tmp_path / "some.npz")
    with bv.open(tmp_path / "some.mcap") as saved, np.load(tmp_path / "some.npz") as truth:
        np.testing.assert_array_equal([f.depth_m for f in saved], [f.depth_m for f in press[2:4]])
        np.testing.assert_allclose(truth["time_s"], saved.times_s, atol=1e-6)
        np.testing.assert_array_equal(truth["T_B_O"], press.source.poses[2:4])
        np.testing.assert_array_equal(truth["force_n"], [press.truth(k).force_n for k in (2, 3)])


def test_summary_says_that_the_linear_model_is_not_that_of_rubber(frames, sensor, estimated):
    rubber = changed(bv.load_sensor(sensor), membrane={"prestretch": 1.3})
    said = "constant tension (the sensor file has no prestretch, or the solver is linear): "
    assert said in estimated.to_text()
    assert said not in bv.estimate(frames[:1], rubber).to_text()
    assert said in bv.estimate(frames[:1], rubber, solver="fast").to_text()
    for solver in ("fast", "linear", "paper"):
        assert said in bv.Estimator(rubber, solver=solver).update(frames[0]).caveat
    assert not bv.Estimator(rubber).update(frames[0]).caveat


def farther(frame, k):
    """A frame that shows the membrane half as far again from the camera."""
    return replace(frame, index=k, time_s=k / 30.0, depth_m=np.float32(1.5) * frame.depth_m)


def test_a_wrong_sensor_file_is_refused_before_every_frame_is_tried(frames, sensor):
    bad, begun = [farther(frames[0], k) for k in range(40)], []
    words = "no frame looks like the membrane .* \\(20 of 40 frames were tried; --frames"
    for solve in (bv.estimate, partial(bv.track, object="cylinder")):
        with pytest.raises(bv.InputError, match=words):
            solve(bad, sensor=sensor, progress=lambda *done: begun.append(done))
    assert not begun
    some = [*bad[:37], *(replace(frames[0], index=k, time_s=k / 30.0) for k in (37, 38, 39))]
    run = bv.estimate(some, sensor)
    assert run.status.tolist() == 37 * ["implausible"] + 3 * ["no_contact"]


def test_a_contact_that_the_camera_sees_in_part_gives_a_warning(frames, sensor, estimated):
    _, column = np.unravel_index(
        np.nanargmax(frames[0].depth_m - frames[TOUCHING[0]].depth_m), frames[0].depth_m.shape
    )
    cut = [replace(each, depth_m=each.depth_m.copy()) for each in frames]
    for each in cut:
        each.depth_m[:, column:] = np.nan
    warning = bv.estimate(cut, sensor).warning or ""
    assert f"only a part of the contact in {len(TOUCHING)} frames" in warning
    assert "part of the contact" not in (estimated.warning or "")


@pytest.fixture(scope="module")
def deepening(sensor):
    """Frames at rest, and of a press that goes ever deeper."""
    heights = [0.060] * 18 + np.linspace(0.049, 0.036, 10).tolist()
    return list(small_source(sensor, heights))


def test_wrong_chamber_volume_is_named_where_gas_pressure_is_not_measured(deepening, sensor):
    """The gas law then predicts another shape, which looks like a drift of the camera."""
    frames = [replace(each, gas_pressure_pa=None) for each in deepening[6:]]
    given = bv.load_sensor(sensor)
    warning = bv.estimate(frames, changed(given, pneumatics={"chamber_volume_m3": 5e-4})).warning
    assert "does not follow the gas law" in warning and "check chamber_volume_m3" in warning
    assert bv.estimate(frames, given).warning is None


def test_wrong_gas_pressure_is_named_where_it_is_measured(deepening, sensor):
    """The images contradict it as they would after a drift of the camera."""
    measured = np.array([each.gas_pressure_pa for each in deepening])
    for wrong in (0.5 * (measured + measured[0]), np.roll(measured, 5)):  # a share of it, late
        pressures = np.where(np.arange(len(measured)) < 18, measured, wrong)
        frames = [
            replace(each, gas_pressure_pa=float(pa))
            for each, pa in zip(deepening, pressures, strict=True)
        ]
        warning = bv.estimate(frames, sensor).warning
        assert "the measured gas pressure is wrong or late" in warning and "check values" in warning
    assert bv.estimate(deepening, sensor).warning is None


def test_friction_that_the_linear_membrane_ignores_gives_a_warning(frames, sensor):
    rubber = changed(bv.load_sensor(sensor), membrane={"prestretch": 1.2})
    for solver, friction in (("linear", 0.5), ("fast", 1.0), ("paper", 0.5)):
        warning = bv.estimate(frames[:2], sensor, friction=friction, solver=solver).warning
        assert f"(--friction {friction:g}) changes nothing" in warning
    said = "(--friction 0.5) changes nothing"
    assert said in bv.track(frames[2:3], "cylinder", sensor, init=INIT, friction=0.5).warning
    for other, friction in ((sensor, None), (sensor, 0.0), (rubber, 0.5)):
        assert said not in (bv.estimate(frames[:2], other, friction=friction).warning or "")


@pytest.fixture(scope="module")
def rested(sensor):
    """Recording of the press after enough frames at rest."""
    source = small_source(sensor, [*20 * (0.060,), *HEIGHTS])
    return record(sensor.with_name("rested.mcap"), source)


@pytest.mark.parametrize(
    "call",
    [
        bv.estimate,
        bv.check,
        lambda path, sensor: bv.track(path, "cylinder", sensor, init=INIT),
        lambda path, sensor: bv.compare(path, path, sensor),
        lambda path, sensor: bv.export(path, path.with_suffix(".csv"), sensor),
        lambda path, sensor: bv.identify(path, sensor, out=path.with_suffix(".toml")),
        lambda path, sensor: bv.estimate(path, "punyo_oval_d405"),
    ],
    ids=["estimate", "check", "track", "compare", "export", "identify", "refused"],
)
def test_a_recording_opened_by_a_function_is_closed_by_it(rested, tmp_path, sensor, call):
    path = Path(shutil.copy(rested, tmp_path))
    gc.collect()  # what other tests left
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with suppress(bv.InputError):
            call(path, sensor)
        gc.collect()
    assert not [each for each in caught if each.category is ResourceWarning]


def test_pixels_without_return_may_be_zero(frames, sensor, estimated):
    """As in frames of plug-ins, which the page on them allows."""
    lost = np.random.default_rng(3).random(frames[0].depth_m.shape) < 0.05
    images = [np.where(lost, np.nan, frame.depth_m) for frame in frames]
    as_nan, as_zero = (
        bv.estimate(
            [
                replace(f, depth_m=np.nan_to_num(d, nan=filler))
                for f, d in zip(frames, images, strict=True)
            ],
            sensor,
        )
        for filler in (np.nan, 0.0)
    )
    assert as_zero.status.tolist() == as_nan.status.tolist() == estimated.status.tolist()
    np.testing.assert_array_equal(as_zero.force_n, as_nan.force_n)


def test_contacts_are_doubted_if_untouched_frames_contradict_the_sensor_file(
    frames, sensor, estimated
):
    """Images whose left half is 20 mm too far, and whose right half is as much too near."""
    columns = np.arange(frames[0].depth_m.shape[1])
    step_m = np.where(columns < columns.mean(), np.float32(0.02), np.float32(-0.02))
    untouched = [each.status == "no_contact" for each in estimated]
    run = bv.estimate(
        [
            replace(each, depth_m=each.depth_m + rest * step_m)
            for each, rest in zip(frames, untouched, strict=True)
        ],
        sensor,
    )
    assert set(run.status) == {"implausible", "ok"}
    misfits = list(run.status).count("implausible")
    assert f"{misfits} of {len(run)} frames did not fit the sensor file" in run.warning
    assert "did not fit the sensor file" not in (estimated.warning or "")


def test_a_drifted_camera_gives_a_warning(frames, sensor, estimated):
    drifted = [replace(frame, depth_m=frame.depth_m - 1e-3) for frame in frames]
    run = bv.estimate(drifted, sensor)
    told = re.match(r"depth has drifted by (\S+) mm since the calibration", run.warning)
    assert float(told[1]) == pytest.approx(-1.0, abs=0.4)  # its noise hides some
    assert estimated.warning is None
    assert "gas pressure" not in run.warning
    silent = bv.estimate([replace(each, gas_pressure_pa=None) for each in drifted], sensor)
    assert "gas pressure, which was not recorded, has changed" in silent.warning
    followed = bv.track(drifted, "cylinder", sensor, init=INIT)
    assert followed.warning == run.warning


def test_recording_behaves_like_a_list(press):
    with bv.open(press) as frames:
        assert len(frames) == len(HEIGHTS)
        assert frames[-1].index == len(HEIGHTS) - 1
        assert [frame.index for frame in frames[::-2]] == [4, 2, 0]
        assert [frame.index for frame in frames[1:][-2:]] == [3, 4]
        with Recording(press) as plain:
            np.testing.assert_array_equal(frames[3].depth_m, plain[3].depth_m)
            np.testing.assert_allclose(frames[1:3].times_s, plain.times_s[1:3])
        with pytest.raises(IndexError, match="has 5 frames, counted from 0"):
            frames[5]


def test_numbers_equal_those_of_the_command(press, sensor, tmp_path):
    out = tmp_path / "result.npz"
    words = ("--frames", "1:4", "--kappa", 2, "--out", out)
    output_of("estimate", press, "--sensor", sensor, *words)
    run = bv.estimate(bv.open(press)[1:4], sensor, kappa=2.0)
    with np.load(out) as file:
        written = {key: file[key] for key in file.files}
    mean_pa = mean_pressure(run.model.mesh, run[1].contact_pressure_pa)
    assert written["threshold_pa"][1] == pytest.approx(2.0 * mean_pa)
    masks = written.pop("patch_mask")
    arrays = run.arrays()
    assert set(written) - set(arrays) == {"sensor_toml", "version", "solver"}
    for name, array in arrays.items():
        if not name.endswith("_ms"):
            np.testing.assert_array_equal(array, written[name], name)
    for found, mask in zip(run, masks, strict=True):
        np.testing.assert_array_equal(found.pixel_mask, mask)


def test_run_behaves_like_a_list_and_has_arrays(estimated):
    run = estimated
    touched = run.status == "ok"
    assert np.flatnonzero(touched).tolist() == TOUCHING
    assert run.force_n.shape == (5, 3) and (run.force_n[touched, 2] < -1.0).all()
    assert [found.index for found in run[-2:]] == [3, 4]
    np.testing.assert_array_equal(run[2].force_n, run.force_n[2])
    assert not any(found.result.frame.depth_m.size for found in run)  # memory is for numbers
    columns = run.columns()
    assert columns["force_magnitude_n"][2] == pytest.approx(np.linalg.norm(run.force_n[2]))
    half = columns["force_magnitude_half_width_n"]
    assert half.tolist() == [found.force_magnitude_half_width_n for found in run]
    assert (half[touched] > 0.0).all() and not half[~touched].any()
    assert {found.reason for found in run} == {""}
    pressed = run[2].nodes_m - run[0].nodes_m
    deepest = pressed[np.argmax(run[2].contact_pressure_pa)]
    assert deepest[2] == pytest.approx(-0.008, abs=2e-3)  # 50 mm of dome under 42 mm


def test_repr_is_one_line_with_units(frames, estimated):
    pressed, free = estimated[2], estimated[0]
    area, force = 1e6 * pressed.patch_area_m2, np.linalg.norm(pressed.force_n)
    on = f"{plus_minus(force, pressed.force_magnitude_half_width_n, 3)} N on {area:.0f} mm²"
    assert repr(pressed) == f"<frame 2 at {pressed.time_s:.3f} s: ok, {on}>"
    assert repr(free) == "<frame 0 at 0.000 s: no_contact, 0 N on 0 mm²>"
    assert re.fullmatch(
        rf"<5 frames of .*press\.mcap: 2 no_contact, 3 ok, up to {force:.1f}\d* ± 0\.\d+ N>",
        repr(estimated),
    )
    assert repr(estimated[3:3]).startswith("<0 frames of ")
    assert re.fullmatch(
        r"<frame 2 at 0\.\d{3} s: 56×43 pixels, gas 10\d\.\d\d kPa>", repr(frames[2])
    )
    assert re.fullmatch(
        rf"<estimate: ok, {force:.3g} N, misfit 0\.\d+ mm rms>", repr(pressed.estimate)
    )
    assert repr(pressed.patch) == f"<patch: {area:.0f} mm², {force:.3g} N>"
    assert repr(pressed.result) == "<result of frame 2: ok; estimate, patch>"
    nodes = len(pressed.model.mesh.nodes)
    assert repr(pressed.model) == f"<soft-bubble pico flexx: {nodes} nodes, 56×43 pixels>"
    dark = bv.Estimator(estimated.model.sensor).update(np.zeros((43, 56)))
    assert re.fullmatch(r"<frame 0 at 0\.000 s: no_data, .+>", repr(dark))
    assert repr(dark.estimate) == "<estimate: no_data>"
    paper = bv.estimate(frames[2:3], estimated.model.sensor, solver="paper")
    assert re.fullmatch(r"<frame 2 at .* s: ok, \d\.\d+ N on \d+ mm²>", repr(paper[0]))
    T = parse_pose("0.001 -0.002 0.0371 0 0 0 1")
    found = Pose("ok", T, determined=np.arange(6) < 4)
    assert (
        repr(found) == "<pose: ok, origin at 1.00, -2.00, 37.10 mm, 2 of 6 motions not determined>"
    )
    assert repr(Pose("lost", T)) == "<pose: lost>"  # the matrix is of an earlier frame
    name = re.escape(bv.info(frames).path)
    assert re.fullmatch(rf"<{name}: 5 frames in 0\.\d+ s, 56×43 pixels>", repr(bv.info(frames)))


def test_pickled_run_omits_what_can_be_recomputed(estimated):
    """As when sent to another process; the patch was drawn before, so that cached views exist."""
    mask = estimated[2].pixel_mask
    sent = pickle.dumps(estimated)
    arrays = [*estimated.arrays().values(), *vars(estimated.model.mesh).values()]
    assert len(sent) < 4 * sum(array.nbytes for array in arrays if hasattr(array, "nbytes"))
    got = pickle.loads(sent)
    assert got.status.tolist() == estimated.status.tolist()
    np.testing.assert_array_equal(got[2].force_n, estimated[2].force_n)
    np.testing.assert_array_equal(got[2].pixel_mask, mask)


def test_a_saved_run_is_loaded_again(frames, estimated, sensor, tmp_path):
    """In another folder, without the sensor file: the result file contains its content."""
    estimated.save(tmp_path / "press.npz")
    written = bv.estimate(frames[:1], sensor, out=tmp_path / "one.npz")
    assert written.to_text().startswith(f"wrote   {tmp_path / 'one.npz'}")
    with pytest.raises(bv.InputError, match=r"one\.npz: written frame .*; use bv\.load_run"):
        written[0]
    got = bv.load_run(tmp_path / "press.npz")
    assert got.status.tolist() == estimated.status.tolist()
    for name, column in estimated.columns().items():
        np.testing.assert_array_equal(got.columns()[name], column, name)
    for name, array in estimated.arrays().items():
        if array.dtype.kind == "f":  # a sum and a difference: the last digit
            np.testing.assert_allclose(got.arrays()[name], array, rtol=1e-12, atol=1e-15)
    for one, other in zip(got, estimated, strict=True):
        np.testing.assert_array_equal(one.pixel_mask, other.pixel_mask)
    got[1:3].save(tmp_path / "part.npz")
    assert bv.load_run(tmp_path / "part.npz").columns()["frame"].tolist() == [1, 2]
    assert got.model.sensor == bv.load_sensor(sensor).model_copy(
        update={"folder": Path(), "file": ""}
    )
    assert got.facts()["max_force_n"] == estimated.facts()["max_force_n"]
    assert got[2].caveat == got.facts()["model"] == estimated[2].caveat != ""
    force, half = got[2].force_magnitude_n, got[2].force_magnitude_half_width_n
    assert f"{force:.3g} ± {half:.2g} N in contact (medians)" in got[2:3].to_text()


@pytest.mark.parametrize("key", ["force_n", "seen_share", "displacement_3d_m", "patch_mask"])
def test_result_file_with_an_array_of_other_shape_or_numbers_is_refused(estimated, tmp_path, key):
    estimated.save(tmp_path / "press.npz")
    with np.load(tmp_path / "press.npz") as saved:
        arrays = dict(saved)
    twice = np.stack([arrays[key], arrays[key]], axis=-1)
    huge = np.full_like(arrays["force_n"], 1e200)
    for name, array, says in (
        (key, twice, "has shape"),
        ("force_n", huge, r"has numbers beyond ±1e\+15"),
    ):
        np.savez(tmp_path / "other.npz", **arrays | {name: array})
        with pytest.raises(bv.InputError, match=rf"other\.npz: .*{name} {says}.*RESULT\.npz"):
            bv.load_run(tmp_path / "other.npz")


def test_invalid_result_file_is_refused_in_one_sentence(tmp_path):
    (tmp_path / "text.npz").write_text("no archive")
    np.savez(tmp_path / "other.npz", force_n=np.zeros((2, 3)))
    np.savez(tmp_path / "nested.npz", sensor_toml="a = " + "[" * 5000)
    for name in ("text", "other", "missing", "nested"):
        with pytest.raises(bv.InputError, match=rf"{name}\.npz: .* choose a RESULT\.npz") as error:
            bv.load_run(tmp_path / f"{name}.npz")
        assert "\n" not in str(error.value)


def test_object_is_registered_and_tracked(frames, sensor, tmp_path):
    run = bv.track(frames, "cylinder", sensor, init=INIT)
    assert frames.path is not None
    words = ("--object", "cylinder", "--init", INIT, "--out", tmp_path / "poses.csv")
    output_of("pose", frames.path, "--sensor", sensor, *words)
    lines = np.genfromtxt(tmp_path / "poses.csv", delimiter=",", names=True, encoding="utf-8")
    np.testing.assert_allclose(run.columns()["pose_z_m"], lines["z_m"])
    assert run.T_B_O[3, 2, 3] == pytest.approx(0.042, abs=1e-3)
    one = bv.register(frames[2], "cylinder", sensor, init=parse_pose(INIT))
    assert one.T_B_O[2, 3] == pytest.approx(0.042, abs=1e-3)
    with pytest.raises(bv.InputError, match="nothing touches the membrane"):
        bv.register(frames[0], "cylinder", sensor)


def test_a_sensor_is_identified_and_saved(sensor, tmp_path):
    rest = bv.simulate(sensor, "cylinder", "0 0 0.08 0 0 0 1", frames=20, noise_relative=0.002)
    found = bv.identify(rest, sensor, nodes=200, contact_free=range(20))
    low, high = found.tension_interval_n_per_m
    own = bv.load_sensor(sensor).membrane
    assert own.rim_radius_m and own.height_m
    radius = (own.rim_radius_m**2 + own.height_m**2) / (2.0 * own.height_m)
    assert low < 0.5 * found.gauge_pressure_pa * radius < high  # Young–Laplace of a sphere
    assert found.tension_n_per_m == pytest.approx(0.5 * found.gauge_pressure_pa * radius, rel=0.01)
    found.save(tmp_path / "mine.toml")
    assert set(bv.estimate(rest[:2], tmp_path / "mine.toml").status) == {"no_contact"}


def test_frames_and_poses_of_a_stream(press, sensor, tmp_path):
    with bv.connect(f"replay:{press}?speed=0.2", sensor) as stream:
        assert [frame.index for frame in stream] == list(range(len(HEIGHTS)))
    path, how = tmp_path / "held.mcap", {"init": INIT}
    write_press(path, sensor, (*HEIGHTS[:-1], HEIGHTS[-2]))
    with bv.connect(f"replay:{path}?speed=0.2", sensor) as stream:
        poses = list(bv.track(stream, "cylinder", **how))
    assert poses[-1].status == "ok" and poses[-1].index == len(HEIGHTS) - 1
    with bv.open(path) as recording:  # of the frames that a slow machine does not leave out
        again = bv.track([recording[each.index] for each in poses], "cylinder", sensor, **how)
    assert [each.status for each in poses] == again.status.tolist()
    single = [each.result.frame.images == 1 for each in poses]  # a list's images are not averaged
    found = np.array([each.T_B_O for each in poses])
    assert np.isfinite(found[single]).any()
    np.testing.assert_allclose(found[single], again.T_B_O[single])
    np.testing.assert_allclose(found[:, 2, 3], again.T_B_O[:, 2, 3], atol=5e-4)


def test_errors_equal_those_of_the_command_line(frames, sensor, tmp_path):
    for given in (frames, frames[0]):
        with pytest.raises(bv.InputError, match="no preset has a camera of 56×43 pixels"):
            bv.estimate(given)
    with pytest.raises(bv.InputError, match="exists already"):
        bv.save_sensor(bv.load_sensor(sensor), sensor)
    with pytest.raises(bv.InputError, match=r"end it in \.toml"):
        bv.save_sensor(bv.load_sensor(sensor), tmp_path / "sensor.json")


def test_saved_sensor_includes_mesh_and_pixels(tmp_path):
    given = bv.load_sensor("punyo_oval_d405")
    bv.save_sensor(given, tmp_path / "mine.toml")
    saved = bv.load_sensor(tmp_path / "mine.toml")
    assert saved.pneumatics == given.pneumatics and saved.camera == given.camera
    assert given.membrane.mesh_file and given.calibration
    for name in (given.membrane.mesh_file, given.calibration.pixels_file):
        copy = (tmp_path / "mine").with_suffix(Path(name).suffix)
        assert copy.read_bytes() == given.resolve(name).read_bytes()
    bv.save_sensor(saved, tmp_path / "second.toml")  # in the same folder
    (tmp_path / "second.npz").unlink()
    with pytest.raises(bv.InputError, match=r"second\.npz: named in"):
        bv.save_sensor(bv.load_sensor(tmp_path / "second.toml"), tmp_path / "third.toml")
    assert not list(tmp_path.glob("third*"))


def test_saved_sensor_keeps_the_colour_delay(tmp_path):
    given = bv.load_sensor("pico_flexx_75mm")
    assert given.camera.colour_delay_s == 0.0  # the file need not have it
    own = with_colour_delay(given, -0.055)
    assert with_colour_delay(own, None) is own and own.pneumatics == given.pneumatics
    bv.save_sensor(own, tmp_path / "mine.toml")
    assert bv.load_sensor(tmp_path / "mine.toml").camera == own.camera
    text = (tmp_path / "mine.toml").read_text(encoding="utf-8")
    assert "colour_delay_s = -0.055" in text
    (tmp_path / "wrong.toml").write_text(text.replace("-0.055", "-55.0"), encoding="utf-8")
    with pytest.raises(
        bv.InputError, match=r"wrong\.toml: camera\.colour_delay_s = -55\.0: .*0\.5"
    ):
        bv.load_sensor(tmp_path / "wrong.toml")


def test_pictures(estimated, tmp_path):
    pytest.importorskip("pyvista", reason="the extra window is not installed")
    from matplotlib.image import imread

    run = estimated[1:4]
    run[1].plot(tmp_path / "frame.png")
    figure = run.plot(tmp_path / "run.svg")
    image = imread(tmp_path / "frame.png")[..., :3]
    red = (image[..., 0] > 0.3) & (image[..., 1:].max(axis=-1) < 0.1)
    assert red.sum() > 100  # the force's arrow
    assert (tmp_path / "run.svg").stat().st_size > 10_000
    assert figure.axes[0].get_ylabel() == "force, N"
    with pytest.raises(bv.InputError, match="exists already"):
        run[1].plot(tmp_path / "frame.png")


def test_a_scene_for_notebooks_and_other_programs(estimated, tmp_path):
    found = estimated[2]
    assert found.scene().geometry.keys() == {"membrane", "patch", "force"}
    assert estimated[0].scene().geometry.keys() == {"membrane"}  # nothing touches it
    found.scene().export(tmp_path / "press.glb")
    read = trimesh.load_scene(tmp_path / "press.glb").geometry
    membrane = read["membrane"]
    # the file repeats no node and keeps their order
    np.testing.assert_allclose(membrane.vertices, found.nodes_m, atol=1e-6)
    brightest = membrane.visual.vertex_colors[:, :3].sum(axis=1).argmax()
    assert found.contact_pressure_pa[brightest] > 0.9 * found.contact_pressure_pa.max()
    low, high = read["force"].bounds
    np.testing.assert_allclose(low[2], found.center_of_pressure_m[2], atol=1e-3)  # points down
    assert high[2] > low[2] + 0.05
    # a notebook's view is one page, without the network
    page = scene_to_html(found.scene())
    assert not re.search(r"<(script|link)[^>]+(src|href)=", page) and 1e5 < len(page) < 2e6


def test_a_table_and_a_dataset(estimated):
    pytest.importorskip("pandas", reason="the extra notebook is not installed")
    pytest.importorskip("xarray", reason="the extra notebook is not installed")
    table, data = estimated.table(), estimated.dataset()
    assert table.index.tolist() == [0, 1, 2, 3, 4]
    assert table.force_z_n[2] == estimated.force_n[2, 2]
    pressed = data.contact_pressure_pa.sel(frame=2)
    np.testing.assert_array_equal(pressed, estimated[2].contact_pressure_pa)
    assert data.force_n.dims == ("frame", "axis")
    units = {name: array.attrs.get("units") for name, array in data.variables.items()}
    expected = {"force_n": "N", "torque_nm": "N m", "contact_pressure_pa": "Pa", "time_s": "s"}
    expected |= {"patch_area_m2": "m2", "nodes_m": "m", "status": None, "rim": None}
    assert expected.items() <= units.items()
    assert table.stamp_ns.is_monotonic_increasing


@pytest.mark.parametrize(
    ("name", "extra", "use"),
    [
        ("pandas", "notebook", lambda run: run.table()),
        ("xarray", "notebook", lambda run: run.dataset()),
        ("pyvista", "window", lambda run: run[0].plot()),
        ("pyarrow", "parquet", lambda run: bv.export([run[0].result.frame], "x.parquet")),
        ("distributed", "cluster", lambda _: check_cluster("tcp://127.0.0.1:8786")),
        ("pyrealsense2", "realsense", lambda _: bv.connect("realsense:", "pico_flexx_75mm")),
        ("cv2", "colour", lambda _: OpticalFlow.of(5 * [np.zeros((48, 64), np.uint8)])),
    ],
)
def test_without_a_library_one_sentence_says_what_to_install(
    estimated, monkeypatch, name, extra, use
):
    monkeypatch.setitem(sys.modules, name, None)  # what a missing module looks like
    with pytest.raises(bv.InputError, match=rf"{name} cannot be imported .*; run .*\[{extra}\]"):
        use(estimated)


def blas_threads():
    from threadpoolctl import threadpool_info

    return {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}


class ThreadsSeen(SyntheticSource):
    """A simulation that notes how many threads BLAS has while a frame is made."""

    seen: set[int]

    def contact(self, index):
        self.seen |= blas_threads()
        return super().contact(index)


@pytest.mark.parametrize("call", ["frame", "frame of a slice", "truth", "save", "estimate"])
def test_blas_threads_are_limited_during_a_call_and_restored_after(call, sensor, tmp_path):
    from threadpoolctl import threadpool_limits

    source = ThreadsSeen(
        bv.load_sensor(sensor), load_object("cylinder"), parse_pose("0 0 0.05 0 0 0 1")[None]
    )
    source.seen = set()
    press = Simulation(source)
    with threadpool_limits(2, user_api="blas"):
        if call == "frame":
            press[0]
        elif call == "frame of a slice":
            press[0:][0]
        elif call == "truth":
            press.truth(0)
        elif call == "save":
            press.save(tmp_path / "press.mcap")
        else:
            bv.estimate(press, sensor)
        after = blas_threads()
    assert source.seen == {1} and after == {2}
