"""Thousands of damaged and hostile inputs: each must be read, or refused in one line.

Inputs are small valid files written by bubbleviz, with random mutations: the same seed and number
give the same input. They run in a process with limits of memory and time.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import struct
import sys
import time
import traceback
import warnings
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image
from rosbags.rosbag1 import Writer as RosbagWriter
from rosbags.rosbag2 import StoragePlugin, Writer as Rosbag2Writer

import bubbleviz as bv
from bubbleviz.cli.command_line import main
from bubbleviz.errors import InputError
from bubbleviz.files import SUFFIXES as MESHES, write_ply
from bubbleviz.live import FrameAssembler, load_session
from bubbleviz.processes import PeakMemory, WorkerProcess
from bubbleviz.recordings import Bag, McapFile, Message, ros2_types, typestore
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor import Calibration, Camera, Membrane, Pneumatics, Sensor, sensor_to_toml
from bubbleviz.simulation import read_truth
from bubbleviz.wording import reason_of

MEMORY_BYTES = 2 << 30
TIMEOUT_S = 10.0
POSE = "0.005 0 0.042 0 0 0 1"

Rng = np.random.Generator
Words = list[str]
Work = Words | Callable[[], object]  # a command, or a library call


class Outcome(NamedTuple):
    number: int
    kind: str
    fault: str  # empty if there is none
    seconds: float
    memory_bytes: int  # increase of the peak


# -- mutations ------------------------------------------------------------------------------------

_SIZES = (0, 1, 255, 0x7FFF, 0xFFFF, 2**31 - 1, 2**32 - 1, 2**40, 2**63 - 1, 2**64 - 1)
_NUMBERS = (
    *("0", "-1", "1e-30", "1e30", "1e308", "-1e308", "1e400", "nan", "inf", "-inf", "1_0", "0x1F"),
    *("true", '""', "[]", "{}", "null", "99999999999999999999", "9" * 6000, "-" + "9" * 400, "1.5"),
)
_TEXTS = ("\0", "\ufeff", "é", "=1+1", "\x1b[2J", "a" * 300, "\r", '"', "[" * 5000, "{" * 5000)


def mutated_bytes(data: bytes, rng: Rng) -> bytes:
    """Bytes with one to four mutations anywhere."""
    out = bytearray(data)
    for _ in range(rng.integers(1, 5)):
        at, size = int(rng.integers(len(out) + 1)), int(rng.integers(1, 65))
        match rng.integers(7):
            case 0:
                out[at : at + 1] = bytes([int(rng.integers(256))])
            case 1:
                out[at : at + size] = bytes(size)
            case 2:
                out[at : at + size] = b"\xff" * size
            case 3:
                del out[at : at + size]
            case 4:
                out[at:at] = out[at // 2 : at // 2 + size]
            case 5:
                number = int(rng.choice(np.array(_SIZES, dtype=object)))
                width = int(rng.choice([2, 4, 8]))
                out[at : at + width] = (number % 256**width).to_bytes(width, "little")
            case 6 if rng.random() < 0.3:
                del out[at:]
    return bytes(out)


def mutated_text(text: str, rng: Rng) -> str:
    """Text with one to three of its numbers, words or lines replaced."""
    for _ in range(rng.integers(1, 4)):
        lines, tokens = text.splitlines(keepends=True), list(re.finditer(r"-?[\w.]+", text))
        if not tokens:
            return text
        token = tokens[rng.integers(len(tokens))]
        line = int(rng.integers(len(lines)))
        match rng.integers(6):
            case 0 | 1 | 2:
                new = str(rng.choice(np.array(_NUMBERS, dtype=object)))
                text = text[: token.start()] + new + text[token.end() :]
            case 3:
                new = str(rng.choice(np.array(_TEXTS, dtype=object)))
                text = text[: token.start()] + new + text[token.start() :]
            case 4:
                text = "".join(lines[:line] + lines[line + 1 :])
            case 5:
                text = "".join(lines[: line + 1] + lines[line:])
    return text


def mutated_array(array: np.ndarray, rng: Rng) -> np.ndarray:
    """An array of another shape, type or byte order, or with impossible values."""
    if array.dtype.kind not in "uif":
        array = array.astype(float) if array.dtype.kind == "b" else np.zeros(array.shape)
    array = np.atleast_1d(array)
    wild = float(rng.choice([1e-30, 1e30, 1e308, -1.0, np.nan, np.inf, 0.0]))
    with np.errstate(all="ignore"):
        spoilt = array.astype(float)
        spoilt[rng.random(array.shape) < rng.choice([0.01, 0.5, 1.1])] = wild
        kinds: list[Callable[[], np.ndarray]] = [
            lambda: spoilt,
            lambda: spoilt.astype(">f4"),
            lambda: array.astype(array.dtype.newbyteorder(">")),
            lambda: array[:0],
            lambda: array[..., None],
            lambda: array.ravel(),
            lambda: np.array(wild),
            lambda: np.array([wild, wild]),
            lambda: array.astype("U8"),
            lambda: array.astype(complex),
            lambda: array.astype(np.uint8),
            lambda: np.zeros(3, dtype=[("a", "f8")]),
            lambda: np.array([None, {}], dtype=object),
            lambda: np.zeros((0, 0), ">f4"),
        ]
        return kinds[rng.integers(len(kinds))]()


def _npy(array: np.ndarray, path: Path, rng: Rng) -> None:
    """An array as a file, sometimes with a wrong shape in its header."""
    with path.open("wb") as file:
        np.save(file, array, allow_pickle=array.dtype.kind == "O")
    if rng.random() < 0.3:
        claimed = str(rng.choice(["1000000, 1000000", "-1, 4", "9" * 30, "1e3,", "(" * 3000]))
        data = re.sub(rb"'shape': \([^)]*\)", f"'shape': ({claimed})".encode(), path.read_bytes())
        size = struct.pack("<H", data.index(b"\n") + 1 - 10)
        path.write_bytes(data[:8] + size + data[10:])


def _npz(path: Path, rng: Rng) -> None:
    """An archive with one array mutated."""
    with np.load(path) as file:
        arrays = dict(file.items())
    name = str(rng.choice(sorted(arrays)))
    if rng.random() < 0.2:
        del arrays[name]
    else:
        arrays[name] = mutated_array(arrays[name], rng)
    np.savez_compressed(path, **arrays)


def _png(path: Path, rng: Rng) -> None:
    """A PNG with a changed header or other chunk, and a valid checksum."""
    data = bytearray(path.read_bytes())
    if rng.random() < 0.5:
        struct.pack_into(">II", data, 16, *(int(rng.choice([0, 1, 20_000, 2**31])) for _ in "wh"))
    else:
        data[24:26] = rng.integers(0, 17, 2).astype(np.uint8).tobytes()
    struct.pack_into(">I", data, 29, zlib.crc32(data[12:29]))
    if rng.random() < 0.3:
        data = bytearray(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 32 24\nshowpage\n")
    path.write_bytes(bytes(data) if rng.random() < 0.8 else mutated_bytes(bytes(data), rng))


def mutated_message(message: Message, rng: Rng) -> Message:
    """A message with other content, time, type or topic."""
    match rng.integers(8):
        case 0:
            return message._replace(payload=b"")
        case 1:
            return message._replace(payload=message.payload[: rng.integers(len(message.payload))])
        case 2:
            payload = bytearray(message.payload)
            struct.pack_into(
                "<iI", payload, 4, *(int(rng.choice([0, -1, 2**31 - 1])) for _ in "s"), 0
            )
            return message._replace(payload=bytes(payload))
        case 3:
            return message._replace(arrival_ns=int(rng.choice([0, 1, 2**62, 2**63 - 1])))
        case 4 if len(message.payload) > 1000:  # an image, whose pixels are its end
            pixels = np.frombuffer(message.payload[-2048:], "<f4")
            spoilt = mutated_array(pixels, rng)
            with np.errstate(all="ignore"):
                numeric = spoilt.astype("f4") if spoilt.dtype.kind in "uif" else pixels
            tail = numeric.tobytes()[:2048]
            return message._replace(payload=message.payload[:-2048] + tail)
        case 5:
            head = mutated_bytes(message.payload[:120], rng)
            return message._replace(payload=head + message.payload[120:])
        case _:
            return message._replace(payload=mutated_bytes(message.payload, rng))


# -- inputs ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Corpus:
    """Small valid inputs in a folder, and the messages of their recording."""

    folder: Path
    messages: tuple[Message, ...]
    sensor: Sensor


def small_sensor() -> Sensor:
    camera = Camera(
        width=32, height=24, fx=18.0, fy=18.0, cx=15.5, cy=11.5, position_m=(0.0, 0.0, -0.104)
    )
    return Sensor(
        name="small",
        membrane=Membrane(rim_radius_m=0.075, height_m=0.05, nodes=60),
        pneumatics=Pneumatics(gauge_pressure_pa=2585.5, chamber_volume_m3=2.2e-3),
        camera=camera,
        calibration=Calibration(pixels_file="pixels.npz"),
    )


def make_corpus(folder: Path) -> Corpus:
    """Write the inputs that are mutated."""
    sensor = small_sensor()
    plain = sensor.model_copy(update={"calibration": None})
    bv.simulate(plain, "cylinder", POSE, frames=6, noise_relative=0.002).save(
        folder / "rec.mcap", folder / "truth.npz"
    )
    bv.estimate(folder / "rec.mcap", plain, out=folder / "result.npz")
    (folder / "sensor.toml").write_text(sensor_to_toml(sensor), encoding="utf-8")
    shape = (24, 32)
    pixels: dict[str, Any] = {"mask": np.ones(shape, bool), "bias_m": np.zeros(shape)}
    pixels |= {"noise_m": np.full(shape, 1e-3), "correlated_pixels": np.array(2.0)}
    np.savez(folder / "pixels.npz", **pixels)
    shown = load_object("cylinder")
    write_ply(folder / "object.ply", shown.vertices, {}, shown.triangles)
    corners = shown.vertices[shown.triangles]
    stl = np.zeros(len(corners), dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    stl["v"] = corners
    (folder / "object.stl").write_bytes(bytes(80) + struct.pack("<I", len(stl)) + stl.tobytes())
    lines = [f"v {x} {y} {z}" for x, y, z in shown.vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in shown.triangles + 1]
    (folder / "object.obj").write_text("\n".join(lines) + "\n")
    rows = [f"{k / 30},0.005,0,0.042,0,0,0,1" for k in range(3)]
    (folder / "poses.csv").write_text("\n".join(["time_s,x_m,y_m,z_m,qx,qy,qz,qw", *rows]) + "\n")
    (folder / "session.toml").write_text(_SESSION, encoding="utf-8")
    with contextlib.closing(Bag(folder / "rec.mcap")) as bag:
        messages = tuple(
            Message(topic.name, topic.type, part.payload(k), 0, int(part.log_ns[k]))
            for topic in bag.topics
            for part in [bag.messages(topic)]
            for k in range(len(part))
        )
    _write_foreign(folder, messages)
    return Corpus(folder, messages, sensor)


_SESSION = """schema_version = 1
title = "one"
[[sensors]]
name = "left"
sensor = "pico_flexx_75mm"
source = "synthetic:"
position_m = [0.0, 0.0, 0.0]
quaternion_xyzw = [0.0, 0.0, 0.0, 1.0]
"""


def _write_foreign(folder: Path, messages: Sequence[Message]) -> None:
    """The recording as a ROS 1 bag and as rosbag2's SQLite, which bubbleviz only reads."""
    ros2 = ros2_types()
    sqlite = Rosbag2Writer(folder / "db3", version=9, storage_plugin=StoragePlugin.SQLITE3)
    for writer, ros1 in ((RosbagWriter(folder / "rec.bag"), True), (sqlite, False)):
        with writer as bag:
            kinds, places = {each.topic: each.type for each in messages}, dict[str, Any]()
            for name, kind in kinds.items():
                places[name] = bag.add_connection(name, kind, typestore=typestore(ros1=ros1))
            for each in messages:
                data = ros2.cdr_to_ros1(each.payload, each.type) if ros1 else each.payload
                bag.write(places[each.topic], each.arrival_ns, data)
    next((folder / "db3").glob("*.db3")).rename(folder / "rec.db3")


def _on_recording(corpus: Corpus, path: Path, rng: Rng) -> Words:
    """A command that reads a recording."""
    sensor, out = ["--sensor", str(corpus.folder / "sensor.toml")], path.parent
    commands = {
        "info": [],
        "convert": [str(out / "out.mcap")],
        "estimate": [*sensor, "--out", str(out / "r.npz")],
        "check": sensor,
        "export": [*sensor, "--what", "depth", "--out", str(out / "pictures")],
    }
    verb = str(rng.choice(list(commands), p=[0.4, 0.3, 0.1, 0.1, 0.1]))
    as_json = ["--json"] if verb == "info" and rng.random() < 0.25 else []
    return [verb, str(path), *commands[verb], *as_json]


def recording_bytes(corpus: Corpus, folder: Path, rng: Rng) -> Work:
    name = str(rng.choice(["rec.mcap", "rec.bag", "rec.db3"]))
    (folder / name).write_bytes(mutated_bytes((corpus.folder / name).read_bytes(), rng))
    return _on_recording(corpus, folder / name, rng)


def recording_messages(corpus: Corpus, folder: Path, rng: Rng) -> Work:
    messages = list(corpus.messages)
    for k in rng.choice(len(messages), rng.integers(1, 4), replace=False):
        messages[k] = mutated_message(messages[k], rng)
    file = McapFile(folder / "rec.mcap")
    for each in messages:
        file.write(each, each.arrival_ns)
    file.close()
    return _on_recording(corpus, folder / "rec.mcap", rng)


def live_messages(corpus: Corpus, folder: Path, rng: Rng) -> Work:
    def assemble() -> None:
        assembler = FrameAssembler()
        for each in corpus.messages:
            for frame in assembler.push(mutated_message(each, rng) if rng.random() < 0.3 else each):
                frame.depth_m.mean()

    return assemble


def image_folder(corpus: Corpus, folder: Path, rng: Rng) -> Work:
    """Depth images with intrinsics and times, one of them or a table damaged."""
    images, kind = folder / "images", str(rng.choice(["npy", "png", "tif"]))
    images.mkdir()
    depth = 0.1 + 1e-5 * np.arange(768, dtype=np.float32).reshape(24, 32)
    for k in range(3):
        if kind == "npy":
            np.save(images / f"{k}.npy", depth)
        else:
            pixels = (1e3 * depth).astype(np.uint16) if kind == "png" else depth
            Image.fromarray(pixels).save(images / f"{k}.{kind}")
    camera = {"width": 32, "height": 24, "fx": 18.0, "fy": 18.0, "cx": 15.5, "cy": 11.5}
    toml = "\n".join(f"{key} = {value}" for key, value in camera.items())
    kinds = {"intrinsics.json": json.dumps(camera), "intrinsics.toml": toml}
    chosen = str(rng.choice(list(kinds)))
    tables = {
        chosen: kinds[chosen],
        "times.csv": "time_s\n0.0\n0.033\n0.066\n",
        "gas.csv": "0.0,104000\n0.05,104010\n0.1,104020\n",
    }
    if rng.random() < 0.5:
        name = str(rng.choice(sorted(tables)))
        tables[name] = mutated_text(tables[name], rng)
    elif kind == "npy" and rng.random() < 0.7:
        _npy(mutated_array(depth, rng), images / f"{rng.integers(3)}.npy", rng)
    elif kind == "png" and rng.random() < 0.7:
        _png(images / f"{rng.integers(3)}.png", rng)
    else:
        path = images / f"{rng.integers(3)}.{kind}"
        path.write_bytes(mutated_bytes(path.read_bytes(), rng))
    for name, content in tables.items():
        (images / name).write_text(content, encoding="utf-8")
    gas = ["--gas-pressure", str(images / "gas.csv")]
    return ["convert", str(images), str(folder / "out.mcap"), *gas]


def mesh(corpus: Corpus, folder: Path, rng: Rng) -> Work:
    path = folder / f"object{rng.choice(['.ply', '.stl', '.obj'])}"
    data = (corpus.folder / path.name).read_bytes()
    if path.suffix == ".obj":
        text = mutated_text(data.decode(), rng)
        if rng.random() < 0.1:
            text = "v x y\n" + text
        path.write_text(text, encoding="utf-8")
    elif path.suffix == ".stl" and rng.random() < 0.2:  # every vertex at one place
        path.write_bytes(data[:84] + bytes(len(data) - 84))
    else:
        path.write_bytes(mutated_bytes(data, rng))
    assert path.suffix in MESHES
    return lambda: load_object(path)


def sensor_file(corpus: Corpus, folder: Path, rng: Rng) -> Work:
    """A sensor file, or the file of its pixels."""
    path, pixels = folder / "sensor.toml", folder / "pixels.npz"
    path.write_bytes((corpus.folder / path.name).read_bytes())
    pixels.write_bytes((corpus.folder / pixels.name).read_bytes())
    if rng.random() < 0.6:
        path.write_text(mutated_text(path.read_text(encoding="utf-8"), rng), encoding="utf-8")
    elif rng.random() < 0.7:
        _npz(pixels, rng)
    else:
        pixels.write_bytes(mutated_bytes(pixels.read_bytes(), rng))
    recording = str(corpus.folder / "rec.mcap")
    if rng.random() < 0.3:
        return ["check", recording, "--sensor", str(path)]
    out = str(folder / "r.npz")
    return ["estimate", recording, "--frames", "0:1", "--sensor", str(path), "--out", out]


def pose_file(corpus: Corpus, folder: Path, rng: Rng) -> Work:
    path, out = folder / "poses.csv", str(folder / "out.mcap")
    text = mutated_text((corpus.folder / path.name).read_text(), rng)
    path.write_text(text, encoding="utf-8")
    sensor = ["--sensor", str(corpus.folder / "sensor.toml")]
    return ["simulate", *sensor, "--object", "cylinder", "--path", str(path), "--out", out]


def saved_arrays(corpus: Corpus, folder: Path, rng: Rng) -> Work:
    """Ground truth, or saved results."""
    reads = {"truth.npz": read_truth, "result.npz": lambda path: bv.load_run(path).to_text()}
    path = folder / str(rng.choice(list(reads)))
    path.write_bytes((corpus.folder / path.name).read_bytes())
    if rng.random() < 0.5:
        _npz(path, rng)
    else:
        path.write_bytes(mutated_bytes(path.read_bytes(), rng))
    return partial(reads[path.name], path)


def session_file(corpus: Corpus, folder: Path, rng: Rng) -> Work:
    path = folder / "session.toml"
    path.write_text(mutated_text(_SESSION, rng), encoding="utf-8")
    return partial(load_session, path)


Make = Callable[[Corpus, Path, Rng], Work]
KINDS: dict[str, Make] = {
    make.__name__: make
    for make in (
        *(recording_bytes, recording_messages, live_messages, image_folder, mesh),
        *(sensor_file, pose_file, saved_arrays, session_file),
    )
}


# -- running and checking -------------------------------------------------------------------------


def run_input(corpus: Corpus, make: Make, seed: int, number: int, scratch: Path) -> Outcome:
    """Make an input in a new folder, run it and check the outcome."""
    folder = scratch / str(number)
    folder.mkdir()
    work = make(corpus, folder, np.random.default_rng([seed, number]))
    with (
        _streams_in_files(scratch) as said,
        warnings.catch_warnings(),
        PeakMemory() as memory,
    ):
        warnings.simplefilter("always")  # else each place warns once
        warnings.filterwarnings("ignore", category=DeprecationWarning)
        warnings.filterwarnings("ignore", category=ResourceWarning)
        begun = time.process_time()
        code, fault = _run(work)
        seconds = time.process_time() - begun
    fault = fault or _fault_of(code, *(path.read_text(errors="replace") for path in said))
    left = [path.name for path in folder.rglob(".*")]
    fault = fault or (f"left {left[0]}" if left else "")
    return Outcome(number, make.__name__, fault, seconds, memory.increase_bytes)


def _run(work: Work) -> tuple[int, str]:
    """Exit code and, of an uncaught error, where it was raised."""
    try:
        if not callable(work):
            main(work)
        work()  # type: ignore[operator]
    except SystemExit as end:
        return int(end.code or 0), ""
    except InputError as error:
        print(f"bubbleviz: {error}", file=sys.stderr)
        return 2, ""
    except BaseException as error:
        places = traceback.extract_tb(error.__traceback__)
        ours = [each for each in places if "bubbleviz" in each.filename] or list(places)
        where = f"{Path(ours[-1].filename).name}:{ours[-1].lineno}"
        return 1, f"{type(error).__name__} at {where}: {reason_of(error, 100)}"
    return 0, ""


def _fault_of(code: int, out: str, err: str) -> str:
    """Fault in the outcome of a command; empty if there is none."""
    stray = [line for line in err.splitlines() if not line.startswith("bubbleviz: ")]
    if stray:
        return f"stray line: {re.sub('0x[0-9a-f]+', '0x', stray[0])[:160]}"
    if code not in (0, 1, 2):
        return f"exit code {code}"
    if code and (out.strip() or err.count("\n") != 1):
        return f"exit code {code} with {err.count(chr(10))} lines of error, and {out[:60]!r}"
    return ""


@contextlib.contextmanager
def _streams_in_files(folder: Path) -> Iterator[tuple[Path, Path]]:
    """Redirect stdout and stderr, also of C libraries, to two files."""
    paths = folder / "stdout", folder / "stderr"
    kept = os.dup(1), os.dup(2)
    streams = sys.stdout, sys.stderr
    for number, path in enumerate(paths, start=1):
        with path.open("wb") as file:
            os.dup2(file.fileno(), number)
    sys.stdout, sys.stderr = (os.fdopen(k, "w", closefd=False) for k in (1, 2))
    try:
        yield paths
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        sys.stdout, sys.stderr = streams
        for number, descriptor in enumerate(kept, start=1):
            os.dup2(descriptor, number)
            os.close(descriptor)


def _import_commands() -> None:
    for verb in ("info", "convert", "estimate", "check", "export"):
        getattr(bv, verb)


def fuzz(numbers: range, seed: int, folder: Path) -> Iterator[Outcome]:
    """Outcomes of inputs by number; a process that dies or hangs is one fault."""
    (folder / "corpus").mkdir()
    corpus = make_corpus(folder / "corpus")
    with WorkerProcess(MEMORY_BYTES) as worker:
        for number in numbers:
            if worker.pid is None:  # imports are not part of an input's time
                worker.send(_import_commands)
                worker.outcome()
            make = list(KINDS.values())[number % len(KINDS)]
            found = worker.call(run_input, corpus, make, seed, number, folder, limit_s=TIMEOUT_S)
            if found.kind == "returned":
                yield found.value
            else:
                yield Outcome(number, make.__name__, found.detail, 1e-3 * found.ms, 0)


def to_text(outcomes: Sequence[Outcome]) -> str:
    """Text: counts, and each fault once with its inputs."""
    faults = Counter((each.kind, each.fault) for each in outcomes if each.fault)
    first = {(each.kind, each.fault): each.number for each in reversed(outcomes)}
    lines = [
        f"{count:5} × {kind}: {fault} (first: {first[kind, fault]})"
        for (kind, fault), count in faults.most_common()
    ]
    memory = max(each.memory_bytes for each in outcomes) / 1e6
    longest = max(each.seconds for each in outcomes)
    wrong = sum(faults.values())
    lines.append(
        f"{len(outcomes)} inputs, {wrong} faults; at most {memory:.0f} MB, {longest:.2f} s"
    )
    return "\n".join(lines)
