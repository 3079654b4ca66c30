"""Bad input: one line that names the file and what is wrong, exit code 2, nothing written."""

import os
import subprocess
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from small_press import record as record_frames, small_source

from bubbleviz.recordings import Recording
from bubbleviz.sensor import load_sensor, sensor_to_toml
from bubbleviz.simulation import resized, with_nodes
from tests.program import COMMAND, refusal, run
from tests.recordings.bagmaker import START, BagMaker, depth_image

SIZE = (32, 24)
"""Width and height of the sensor's camera and of the bags' images."""

COMMANDS = {
    "estimate": ("estimate", "REC", "--sensor", "SENSOR", "--out", "OUT", "--csv", "CSV"),
    "screenshot": ("open", "REC", "--sensor", "SENSOR", "--screenshot", "PNG"),
}


def toml(**changes):
    """Sensor file of a small dome; `section__key=value` changes a value of a valid sensor."""
    text = sensor_to_toml(with_nodes(resized(load_sensor("pico_flexx_75mm"), *SIZE), 60))
    for old, new in changes.get("replace", {}).items():
        assert old in text, "the test changes nothing"
        text = text.replace(old, new)
    return text


def snapshot(folder):
    return {p: p.read_bytes() if p.is_file() else None for p in sorted(folder.rglob("*"))}


class Bench:
    """A folder with a recording and a sensor file, and commands run on them."""

    def __init__(self, folder):
        self.folder = folder
        self.sensor = folder / "sensor.toml"
        self.sensor.write_text(toml())
        self.recording = folder / "rec"

    def names(self):
        files = {"OUT": "result.npz", "CSV": "result.csv", "PNG": "picture.png", "TOML": "new.toml"}
        return {
            "REC": str(self.recording),
            "REPLAY": f"replay:{self.recording}",
            "PART": str(self.recording / f"{self.recording.name}.mcap"),
            "SENSOR": str(self.sensor),
            **{key: str(self.folder / file) for key, file in files.items()},
        }

    def run(self, *words):
        return run(*self.given(words))

    def given(self, words):
        names = self.names()
        return [names.get(word, word) for word in words]

    def refused(self, words, *said):
        """A command that must refuse with these words, and leave the folder alone."""
        before = snapshot(self.folder)
        words = COMMANDS[words] if isinstance(words, str) else words
        told = refusal(*self.given(words))
        for word in said:
            assert word in told
        assert snapshot(self.folder) == before, "something was written"


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path)


def record(bench, images, encoding="32FC1", **more):
    bag = BagMaker("mcap file")
    for k, pixels in enumerate(images):
        bag.image(START + k * 10**8, pixels, encoding)
    if "info_size" in more:
        width, height = more["info_size"]
        bag.camera_info(START, width=width, height=height, topic=more.get("topic", INFO))
    bench.recording = bag.write(bench.folder)


INFO = "/cam/depth/camera_info"
GOOD = [depth_image(k) for k in range(3)]


@pytest.mark.parametrize("solving", COMMANDS)
@pytest.mark.parametrize("info", [{}, {"info_size": (20, 10)}])
def test_image_size_that_differs_from_the_sensors(bench, solving, info):
    """The recording's intrinsics win over the sensor's, but not over its camera being another."""
    record(bench, [depth_image(0, 10, 20)], **info)
    with Recording(bench.recording) as recording:
        assert bool(recording.intrinsics) == bool(info)
    bench.refused(solving, bench.recording.name, "20×10", "32×24", "sensor.toml")


def test_camera_info_of_another_size_than_the_images(bench):
    record(bench, GOOD, info_size=(64, 48))
    bench.refused("estimate", bench.recording.name, INFO, "64×48", "32×24")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("rim_radius_m", "rim_raduis_m", ("rim_raduis_m", "unknown key")),
        ("rim_radius_m = 0.075", "rim_radius_m = -0.075", ("rim_radius_m", "-0.075")),
        ("rim_radius_m = 0.075", "rim_radius_m = 75.0", ("rim_radius_m", "75", "metres")),
        ("-0.104", "nan", ("position_m", "finite")),
        ("quaternion_xyzw = [\n    0.0", "quaternion_xyzw = [\n    nan", ("quaternion", "finite")),
        ("-0.104", "-104.0", ("position_m", "millimetres")),
        ("name = ", "name ", ("the TOML file cannot be read",)),
        ("[camera]", "[[camera]]", ("camera: needs to be one table; begin it with [camera]\n",)),
        ("2585.5", "2.5855", ("gauge_pressure_pa", "2.5855", "pascals")),
    ],
    ids=[
        "misspelt", "negative", "75 m rim", "NaN position", "NaN turn", "mm position", "no TOML",
        "list of cameras", "gauge in kPa",
    ],
)  # fmt: skip
def test_bad_sensor_file(bench, old, new, words):
    record(bench, GOOD)
    bench.sensor.write_text(toml(replace={old: new}))
    bench.refused("estimate", "sensor.toml", *words)


def test_a_folder_in_place_of_a_sensor_file(bench):
    record(bench, GOOD)
    bench.sensor = bench.folder / "sensors"
    bench.sensor.mkdir()
    bench.refused("estimate", f"{bench.sensor}: the TOML file cannot be read (it is a folder)")


@pytest.mark.parametrize("value", [1e-30, 1e30, -1.0, 0.0])
def test_invalid_numbers_in_a_sensor_file_give_no_traceback(bench, value):
    """It is solved or refused, whichever number is absurd."""
    record(bench, GOOD)
    good = tomllib.loads(toml())
    numbers = [
        (section, key)
        for section in ("membrane", "pneumatics", "camera")
        for key, known in good[section].items()
        if isinstance(known, float)
    ]
    assert ("camera", "noise_relative") in numbers and len(numbers) >= 10
    for section, key in numbers:
        bench.sensor.write_text(tomli_w.dumps({**good, section: {**good[section], key: value}}))
        done = bench.run(*COMMANDS["estimate"])
        assert done.exit_code in (0, 2), f"{key} = {value}: {done.output}"
        assert done.exit_code == 0 or done.stderr.count("\n") == 1, f"{key}: {done.stderr}"
        for name in ("result.npz", "result.csv"):
            (bench.folder / name).unlink(missing_ok=True)


@pytest.mark.parametrize(
    ("off_pa", "warned", "zeroed"),
    [
        (4e3, False, ()),
        (-4e3, False, ("--zero-gas",)),
        (6e3, True, ()),
        (6e3, True, ("--zero-gas",)),
    ],
)
def test_warning_if_the_gas_pressure_does_not_match_the_sensor(
    tmp_path, sensor, off_pa, warned, zeroed
):
    source = small_source(sensor, heights=15 * (0.06,))
    pressure = load_sensor(sensor).pneumatics.reference_pressure_pa + off_pa
    frames = (replace(frame, gas_pressure_pa=pressure) for frame in source)
    path = record_frames(tmp_path / "rec.mcap", frames)
    words = ("estimate", path, "--sensor", sensor, *zeroed)
    done = run(*words, "--out", tmp_path / "result.npz")
    told = done.stdout + done.stderr
    assert ("more than weather" in told) == warned
    if warned:
        assert done.exit_code == 0, told
        (line,) = (line for line in told.splitlines() if "more than weather" in line)
        assert "109.9 kPa " in line and "in the recording, but 103.9 kPa" in line


@pytest.mark.parametrize(
    ("unit", "pa", "given"),
    [("kPa", 1e3, "103.9"), ("hPa", 100.0, "1039"), ("psi", 6894.757, "15.07")],
)
@pytest.mark.parametrize("command", ["estimate", "check"])
def test_gas_pressure_in_another_unit(tmp_path, sensor, command, unit, pa, given):
    pressure = load_sensor(sensor).pneumatics.reference_pressure_pa / pa
    frames = (replace(each, gas_pressure_pa=pressure) for each in small_source(sensor))
    path = record_frames(tmp_path / "rec.mcap", frames)
    out = () if command == "check" else ("--out", tmp_path / "out.npz")
    told = refusal(command, path, "--sensor", sensor, *out)
    for word in (str(path), f"gas pressure of {given} on /", f"is in {unit}", f"by {pa:g} before"):
        assert word in told


def test_gauge_pressure_in_place_of_the_absolute_is_not_another_unit(tmp_path, sensor):
    """1026 Pa of gauge pressure are near the 1024 hPa of absolute pressure."""
    own = tmp_path / "own.toml"
    own.write_text(
        sensor.read_text().replace("gauge_pressure_pa = 2585.5", "gauge_pressure_pa = 1026.0")
    )
    assert load_sensor(own).pneumatics.gauge_pressure_pa == 1026.0
    frames = (
        replace(each, gas_pressure_pa=1026.0) for each in small_source(own, heights=15 * (0.06,))
    )
    path = record_frames(tmp_path / "rec.mcap", frames)
    done = run("estimate", path, "--sensor", own, "--out", tmp_path / "out.npz")
    assert done.exit_code == 0, done.output


LEFT, RIGHT = "/left/depth/image", "/right/depth/image"


@pytest.mark.parametrize("command", ["estimate", "check", "identify", "export"])
def test_several_depth_topics(bench, sensor, command):
    """The first is used, as a warning says, or the chosen one: here the right one is empty."""
    bag = BagMaker("mcap file")
    for k, frame in enumerate(small_source(sensor, heights=20 * (0.06,))):
        bag.image(START + k * 10**8, frame.depth_m, topic=LEFT)
        bag.image(START + k * 10**8, np.zeros_like(frame.depth_m), topic=RIGHT)
    bench.recording, bench.sensor = bag.write(bench.folder), sensor
    out = {"estimate": "OUT", "export": "CSV", "identify": "TOML"}.get(command)
    words = (command, "REC", "--sensor", "SENSOR", *(("--out", out, "--overwrite") if out else ()))
    words += ("--nodes", "100") if command == "identify" else ()
    by_default, chosen = bench.run(*words), bench.run(*words, "--depth-topic", LEFT)
    assert (by_default.exit_code, chosen.exit_code) == (0, 0), by_default.output + chosen.output
    assert f"of several depth topics {LEFT} is used, not {RIGHT}" in by_default.stderr
    assert "depth topics" not in chosen.stderr
    if command != "export":  # which writes a table without numbers
        assert bench.run(*words, "--depth-topic", RIGHT).exit_code == 2


@pytest.mark.parametrize(("tension", "warned"), [(105.0, False), (210.0, True), (0.105, True)])
def test_warning_if_tension_and_gauge_pressure_do_not_balance(tmp_path, sensor, tension, warned):
    """By Young–Laplace they do at 105 N/m."""
    path = record_frames(tmp_path / "rec.mcap", small_source(sensor, heights=(0.06,)))
    own = tmp_path / "own.toml"
    added = f"chamber_volume_m3 = 0.0022\ntension_n_per_m = {tension}"
    own.write_text(sensor.read_text().replace("chamber_volume_m3 = 0.0022", added))
    done = run("estimate", path, "--sensor", own, "--out", tmp_path / "result.npz")
    assert done.exit_code == 0, done.output
    assert ("N/m balance its gauge pressure" in done.stderr) == warned


def test_camera_that_looks_away(bench):
    record(bench, GOOD)
    bench.sensor.write_text(toml(replace={"-0.104": "0.104"}))
    bench.refused("estimate", "sensor.toml", "no pixel in use sees the membrane")


@pytest.mark.parametrize("content", [b"", b"ply\nformat ascii 1.0\nelement vertex 9\n", None])
def test_unreadable_mesh_of_the_membrane(bench, content):
    """Empty, broken off or missing."""
    record(bench, GOOD)
    mesh = '[membrane]\nshape = "mesh"\nmesh_file = "dome.ply"\nnodes = 60\n[pneumatics]'
    head, rest = toml().split("[membrane]")[0], toml().split("[pneumatics]")[1]
    bench.sensor.write_text(head + mesh + rest)
    if content is not None:
        (bench.folder / "dome.ply").write_bytes(content)
    bench.refused("estimate", "dome.ply")


@pytest.mark.parametrize("value", [0.0, np.nan])
@pytest.mark.parametrize("encoding", ["32FC1", "16UC1"])
def test_all_zero_depth(bench, value, encoding):
    pixels = np.full((24, 32), value)
    image = np.nan_to_num(pixels).astype(np.uint16) if encoding == "16UC1" else pixels
    record(bench, [image.astype(np.float32) if encoding == "32FC1" else image] * 3, encoding)
    bench.refused("estimate", bench.recording.name, "no valid depth in any frame")


def test_images_shorter_than_their_header_says(bench):
    """As of a driver that announces floats and sends millimetres of two bytes."""
    bag = BagMaker("mcap file")
    for k, pixels in enumerate(GOOD):
        millimetres = (1e3 * pixels).astype(np.uint16).view(np.uint8).ravel()
        bag.image(START + k * 10**8, pixels, data=millimetres)
    bench.recording = bag.write(bench.folder)
    for words in (*COMMANDS.values(), ("info", "REC"), ("check", "REC", "--sensor", "SENSOR")):
        bench.refused(words, bench.recording.name, "all messages on /cam/depth/image", "32×24")


def test_depth_that_never_meets_the_membrane(bench):
    """A column of pixels at the image's edge looks past the dome: returns, but none on it."""
    images = np.zeros((3, 24, 32), np.float32)
    images[:, :1, :1] = 5.0
    record(bench, list(images))
    bench.refused("estimate", bench.recording.name, "on the membrane")


@pytest.mark.parametrize(
    "words",
    [
        ("estimate", "REC", "--sensor", "SENSOR", "--out", "REC"),
        ("estimate", "REC", "--sensor", "SENSOR", "--out", "OUT", "--csv", "REC"),
        ("pose", "REC", "--sensor", "SENSOR", "--object", "sphere", "--out", "REC"),
        ("export", "REC", "--sensor", "SENSOR", "--what", "depth", "--out", "REC"),
        ("convert", "REC", "REC"),
        ("convert", "REC", "PART"),
        ("record", "--source", "REPLAY", "--out", "PART"),
        ("validate", "REC", "--sensor", "SENSOR", "--out", "REC"),
        ("compare", "REC", "REC", "--sensor", "SENSOR", "--out", "REC"),
        ("identify", "REC", "--sensor", "SENSOR", "--out", "TOML", "--report", "REC"),
        ("record", "--source", "REPLAY", "--out", "REC"),
        ("watch", "--source", "REPLAY", "--sensor", "SENSOR", "--out", "REC"),
    ],
    ids=" ".join,
)
def test_an_output_never_replaces_the_recording(bench, words):
    bag = BagMaker("mcap folder")
    for k, pixels in enumerate(GOOD):
        bag.image(START + k * 10**8, pixels)
    bench.recording = bag.write(bench.folder)
    bench.refused((*words, "--overwrite"), "would replace", "choose another name")


def test_an_output_never_replaces_the_pixels_of_the_sensor(bench):
    """`identify --out mine.toml` writes mine.npz next to it, a name that a result may have, too."""
    record(bench, GOOD)
    every, images = np.ones(SIZE[::-1], bool), np.zeros((2, *SIZE[::-1]))
    pixels = {"mask": every, "bias_m": images[0], "noise_m": images[1] + 1e-4}
    np.savez(bench.folder / "result.npz", correlated_pixels=1.0, **pixels)
    bench.sensor.write_text(toml() + '[calibration]\npixels_file = "result.npz"\n')
    bench.refused((*COMMANDS["estimate"], "--overwrite"), "would replace")


@pytest.mark.parametrize("file", ["result.npz", "result.csv"])
def test_an_existing_output_is_refused_before_any_work(bench, file, monkeypatch):
    record(bench, GOOD)
    (bench.folder / file).write_text("precious")
    monkeypatch.setattr(Recording, "__init__", lambda *_: pytest.fail("opened the recording"))
    bench.refused("estimate", file, "exists already")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_full_disk_behind_the_printed_output():
    buffered, words = os.environ | {"PYTHONUNBUFFERED": ""}, [*COMMAND, "presets"]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            words, stdout=full, stderr=subprocess.PIPE, env=buffered, text=True, check=False
        )
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "disk is full" in done.stderr
