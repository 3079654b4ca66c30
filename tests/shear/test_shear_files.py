"""Files and output of `estimate --shear`."""

import numpy as np
import pytest

import bubbleviz as bv
from bubbleviz.files import write_rows
from bubbleviz.output import FrameTable, ResultWriter, csv_row
from bubbleviz.sensor import load_sensor, save_sensor, with_colour_delay
from tests.colour.colour_bag import encoded
from tests.program import facts_of, output_of, refusal, rows_of
from tests.recordings.bagmaker import PERIOD, SECOND
from tests.shear.drag import Eyes, stuck
from tests.shear.texture_bag import FRAMES, HELD, TOUCHED, image, write_texture_press


def test_a_result_has_traction_and_slip(tmp_path):
    eyes, wanted = Eyes(300), frozenset({"pixel_mask", "traction", "slip"})
    truth = stuck("puck", 0.004, 0.001, 8.0)
    results = [eyes.pipeline.process(eyes.rest(), wanted)]
    results += [eyes.pipeline.process(eyes.see(truth, k), wanted) for k in range(2)]
    path, mesh, table = tmp_path / "result.npz", eyes.pipeline.mesh, FrameTable("dome")
    with ResultWriter(path, mesh, 3, (320, 400), shear=True) as writer:
        for result in results:
            writer.add(result)
            table.add(result)
        writer.finish(table.rows())
    write_rows(tmp_path / "result.csv", [csv_row(row, "dome") for row in table.rows()])
    with np.load(path) as found:
        n = len(mesh.nodes)
        assert found["traction_pa"].shape == found["tangential_displacement_m"].shape == (3, n, 3)
        assert found["traction_status"].tolist() == ["no_contact", "ok", "ok"]
        assert not found["traction_pa"][0].any()
        force, torque = found["traction_force_n"], found["traction_torque_nm"]
        assert (found["traction_force_sigma_n"][1:] > 0.0).all()
        assert (found["traction_torque_sigma_nm"][1:] > 0.0).all()
        np.testing.assert_array_equal(np.isnan(found["slip"]), [True, True, False])
        slip = results[2].slip
        assert (found["slip"][2], found["slip_sigma"][2]) == (slip.share, slip.share_sigma)
        assert slip.share_sigma > 0.0
    np.testing.assert_allclose(force[2], truth.force_n, atol=0.05 * np.linalg.norm(truth.force_n))
    rows = rows_of(tmp_path / "result.csv")
    assert float(rows[2]["traction_torque_z_nm"]) == torque[2, 2]
    assert rows[1]["traction_status"] == "ok"


@pytest.fixture(scope="module")
def texture_press(tmp_path_factory):
    """Recording with every colour image as it should be, and sensor file."""
    return write_texture_press(tmp_path_factory.mktemp("texture"), {})


def test_no_light_touch_is_lost_by_colour(texture_press, tmp_path):
    """Tractions at all of its nodes could explain it without pressure."""
    pytest.importorskip("cv2", reason="OpenCV, an extra, is not installed")
    press, sensor = texture_press
    words = ("--sensor", sensor, "--shear", "--out", tmp_path / "r.npz")
    output_of("estimate", press, *words, "--frames", f"{TOUCHED - 1}:{TOUCHED + 1}")
    with np.load(tmp_path / "r.npz") as result:
        assert result["status"].tolist() == ["no_contact", "ok"]


def jpeg(k, step=1):
    """Colour image of a frame, smaller by a step."""
    return encoded(image(k)[1][::step, ::step], "jpeg")


def test_frames_with_damaged_or_small_colour_images_use_depth_only(tmp_path):
    """Damaged contact-free frames are excluded."""
    pytest.importorskip("cv2", reason="OpenCV, an extra, is not installed")
    damaged, small, out = HELD + 1, HELD + 2, tmp_path / "r.npz"
    changed = {k: jpeg(k)[: len(jpeg(k)) // 2] for k in (5, damaged)}
    changed |= {k: jpeg(k, 2) for k in (8, small)}
    press, sensor = write_texture_press(tmp_path, changed)
    words = ("--sensor", sensor, "--shear", "--out", out, "--frames", f"{HELD}:{HELD + 4}")
    summary = facts_of("estimate", press, *words)
    with np.load(out) as result:
        assert result["traction_status"].tolist() == ["ok", "depth_alone", "depth_alone", "ok"]
        said = result["traction_reason"].tolist()
        force, alone = result["traction_force_n"][1:3], result["force_n"][1:3]
        np.testing.assert_allclose(force, alone, rtol=0.1)
        sigma, alone_sigma = result["traction_force_sigma_n"], result["force_sigma_n"]
        np.testing.assert_allclose(sigma[1:3], alone_sigma[1:3])
    assert said[0] == said[3] == ""
    assert f"colour image at {damaged / 30:.3f} s: cannot be decoded" in said[1]
    assert "200×160 pixels, the contact-free ones have 400×320" in said[2]
    assert summary["traction_status"]["depth_alone"] == 2
    assert "contact-free frames 0–" in summary["texture"]
    assert "; using the depth camera's" in summary["texture"]
    loaded = bv.load_run(out)
    assert loaded.status.tolist() == ["ok"] * 4
    np.testing.assert_array_equal(loaded.force_n[1:3], alone)
    assert "traction and slip in the file are not loaded" in loaded.warning


def estimated(press, sensor, out, *options):
    """Force with friction of pressed and dragged frames, estimated with these options."""
    words = ("--sensor", sensor, "--shear", "--out", out, "--frames", f"{HELD - 4}:{HELD}:2")
    output_of("estimate", press, *words, *options)
    with np.load(out) as result:
        return {name: result[name] for name in ("traction_force_n", "sensor_toml")}


@pytest.mark.long  # in short: in test_colour_pairing.py
def test_colour_that_leads_by_frames_is_paired_by_the_given_delay(texture_press, tmp_path):
    """By the option, which wins, or the sensor file; without either frames are paired by stamps."""
    pytest.importorskip("cv2", reason="OpenCV, an extra, is not installed")
    press, sensor = write_texture_press(tmp_path, {}, lead=2)
    delay_s = -2.0 * PERIOD / SECOND
    wanted = estimated(texture_press[0], sensor, tmp_path / "wanted.npz")["traction_force_n"]
    own = with_colour_delay(load_sensor(sensor), delay_s)
    save_sensor(own, tmp_path / "own.toml")
    by_file = estimated(press, tmp_path / "own.toml", tmp_path / "file.npz")
    option = ("--colour-delay", f"{delay_s}")
    by_option = estimated(press, sensor, tmp_path / "option.npz", *option)
    np.testing.assert_array_equal(by_file["traction_force_n"], by_option["traction_force_n"])
    size = np.linalg.norm(wanted, axis=1).max()
    assert np.abs(by_option["traction_force_n"] - wanted).max() < 0.01 * size
    assert f"colour_delay_s = {delay_s}" in str(by_option["sensor_toml"])
    by_stamp = estimated(press, tmp_path / "own.toml", tmp_path / "s.npz", "--colour-delay", "0")
    assert np.abs(by_stamp["traction_force_n"] - wanted).max() > 0.03 * size


def test_colour_images_of_another_size_without_camera_info_are_refused(tmp_path):
    changed = {k: jpeg(k, 2) for k in range(FRAMES)}
    press, sensor = write_texture_press(tmp_path, changed)
    words = ("--sensor", sensor, "--shear", "--out", tmp_path / "r.npz")
    said = refusal("estimate", press, *words)
    assert f"{press}: no intrinsics for colour images" in said


@pytest.mark.long
def test_the_real_press(tmp_path, punyo_press_colour):
    """Friction makes the force a tenth larger; no contact before."""
    pytest.importorskip("cv2", reason="OpenCV, an extra, is not installed")
    words = ("--shear", "--out", tmp_path / "r.npz", "--frames", "50:90:3")
    summary = facts_of("estimate", punyo_press_colour, "--sensor", "punyo_oval_d405", *words)
    assert set(summary["traction_status"]) == {"no_contact", "ok"}
    with np.load(tmp_path / "r.npz") as result:
        hold = result["frame"] >= 75
        force = np.linalg.norm(result["traction_force_n"][hold], axis=1)
        assert ((force > 2.85) & (force < 3.1)).all()
        assert (result["flow_rms_px"][hold] < 0.5).all()
