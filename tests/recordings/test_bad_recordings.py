"""Every error of a recording is one line that names the file, without traceback."""

import os
import random
import shutil

import numpy as np
import pytest
from bagmaker import KINDS, PERIOD, START, BagMaker, depth_image, fill
from mcap.reader import make_reader
from mcap.records import Chunk, Message, MessageIndex
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, IndexType
from mcap_copy import copied

from bubbleviz.api.frames import info
from bubbleviz.errors import InputError
from bubbleviz.recordings import IMAGE, Recording

DEPTH = "/cam/depth/image"


def refusal(path):
    with pytest.raises(InputError) as caught:
        info(path)
    message = str(caught.value)
    assert "\n" not in message
    assert path.name in message
    return message


def read_all(path):
    info(path)
    with Recording(path) as recording:
        for k in range(len(recording)):
            recording[k]


def test_missing_file(tmp_path):
    assert "no such recording" in refusal(tmp_path / "nope.mcap")
    assert "no such recording" in refusal(tmp_path / ("x" * 5000))


@pytest.mark.parametrize("suffix", [".mcap", ".db3", ".bag", ".txt", ""])
@pytest.mark.parametrize("times", [0, 100])
def test_an_empty_file_or_one_of_another_kind(tmp_path, suffix, times):
    path = tmp_path / f"rec{suffix}"
    path.write_bytes(b"not a recording at all, but some text\n" * times)
    refusal(path)


def test_folder_without_recording(tmp_path):
    assert "no recording in this folder" in refusal(tmp_path)
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information: [1, 2]\n")
    refusal(tmp_path)


@pytest.mark.parametrize("kind", KINDS)
def test_no_messages(tmp_path, kind):
    assert "no messages" in refusal(BagMaker(kind).write(tmp_path))


@pytest.mark.parametrize(
    ("add", "says"),
    [
        (lambda bag: bag.pressure(START, 1e5), ("no topic with depth",)),
        *(
            (lambda bag, kind=kind: bag.image(START, depth_image(0), kind), (repr(kind), "16UC1"))
            for kind in ("rgb8", "mono16", "64FC1", "")
        ),
        (
            lambda bag: bag.image(START, depth_image(0), height=2**32 - 1, width=2**32 - 1),
            ("images of 4294967295×4294967295 pixels",),
        ),
        (lambda bag: bag.rows.append((DEPTH, IMAGE, START, b"\0\1\0\0garbage")), ()),
    ],
)
def test_first_message_that_is_no_depth_image(tmp_path, add, says):
    bag = BagMaker("mcap file")
    add(bag)
    told = refusal(bag.write(tmp_path))
    assert all(word in told for word in says)


@pytest.mark.parametrize("kind", ["mcap file", "mcap messages", "db3 file", "bag lz4"])
@pytest.mark.parametrize("bad", [0, 2])
def test_a_message_without_an_image_is_a_frame_without_data(tmp_path, kind, bad):
    """As a driver publishes while it starts or hangs; `info` lists them.

    That of frame 5 lacks fewer bytes than the header has, so it is longer than its pixels.
    """
    bag = BagMaker(kind)
    for k in range(9):
        stamp = START + k * PERIOD
        pixels = depth_image(k) if k != bad else np.zeros((0, 0), np.float32)
        bag.image(stamp, pixels, **({"data": np.zeros(7, np.uint8)} if k == 4 else {}))
        bag.pressure(stamp, 1e5 + k)
    for topic, number, length in ((DEPTH, bad + 1, 0), ("/gas", 3, 0), (DEPTH, 5, -8)):
        at = [k for k, row in enumerate(bag.rows) if row[0] == topic][number]
        _, of_type, log, message = bag.rows[at]
        bag.rows[at] = (topic, of_type, log, bag.payload(of_type, message)[:length])
    path, gone = bag.write(tmp_path), (bad, bad + 1, 4, 5)
    assert info(path).bad_frames == gone
    assert f"bad frames    4 without a depth image: {bad}, " in info(path).to_text()
    with Recording(path) as recording:
        np.testing.assert_allclose(np.diff(recording.times_s), PERIOD / 1e9, atol=1e-9)
        for k in range(9):
            wanted = np.full((24, 32), np.nan) if k in gone else depth_image(k)
            np.testing.assert_array_equal(recording[k].depth_m, wanted)
        assert recording[8].gas_pressure_pa == 1e5 + 8


@pytest.mark.parametrize(
    ("kind", "problem"), [("mcap file", "bytes"), ("db3 file", "bytes"), ("bag lz4", "NaN")]
)
def test_damaged_gas_pressure_leaves_its_frame_without_one(tmp_path, kind, problem):
    """As when another program publishes on the topic, or the pressure sensor has no value."""
    bag = BagMaker(kind)
    for k in range(6):
        bag.image(START + k * PERIOD, depth_image(k))
        bag.pressure(START + k * PERIOD, np.nan if (problem, k) == ("NaN", 3) else 1e5 + k)
    if problem == "bytes":
        row = [k for k, row in enumerate(bag.rows) if row[0] == "/gas"][3]
        bag.rows[row] = (*bag.rows[row][:3], np.random.default_rng(0).bytes(40))
    path = bag.write(tmp_path)
    assert info(path).frames == 6
    with Recording(path) as recording:
        np.testing.assert_array_equal(recording[3].depth_m, depth_image(3))
        assert recording[3].gas_pressure_pa is None
        assert [recording[k].gas_pressure_pa for k in (0, 1, 5)] == [1e5, 1e5 + 1, 1e5 + 5]


def test_a_frame_of_another_size(tmp_path):
    bag = BagMaker("mcap file")
    bag.image(START, depth_image(0))
    bag.image(START + PERIOD, depth_image(1, 48, 16))
    with Recording(bag.write(tmp_path)) as recording:
        with pytest.raises(InputError, match=r"frame 1.*16×48"):
            recording[1]
        np.testing.assert_array_equal(recording[0].depth_m, depth_image(0))  # still usable


@pytest.mark.parametrize("logged", [0, 2**62])
def test_an_implausible_log_time_changes_no_frame_time(tmp_path, logged):
    bag = BagMaker("mcap file")
    for k in range(6):
        stamp = START + k * PERIOD
        bag.image(stamp, depth_image(k), log=logged if k == 3 else stamp + 5_000_000)
        bag.pressure(stamp, 1e5 + k)
    with Recording(bag.write(tmp_path)) as recording:
        assert info(recording).gaps == 0
        for k in range(6):
            assert recording[k].stamp_ns == START + k * PERIOD
            assert recording[k].gas_pressure_pa == 1e5 + k
            np.testing.assert_array_equal(recording[k].depth_m, depth_image(k))


@pytest.mark.parametrize("kind", ["db3 file", "bag none", "bag lz4"])
@pytest.mark.parametrize("share", [0.02, 0.3, 0.7, 0.99])
def test_truncated(tmp_path, kind, share):
    path = fill(BagMaker(kind)).write(tmp_path)
    os.truncate(path, int(path.stat().st_size * share))
    with pytest.raises(InputError) as caught:
        read_all(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", ["mcap file", "mcap folder"])
def test_a_truncated_mcap_of_rosbag2_opens(tmp_path, kind):
    path = fill(BagMaker(kind)).write(tmp_path)
    file = path if path.is_file() else next(path.glob("*.mcap"))
    os.truncate(file, file.stat().st_size - 20)  # in its summary: no chunk is lost
    assert frames_up_to_the_cut(path) == 6
    lost_kb = float(info(path).note.partition(" kB ")[0].split()[-1])
    assert 0.0 < lost_kb < 10.0  # the index, no images
    os.truncate(file, 300)
    assert "ends before its first message" in refusal(path)


@pytest.mark.parametrize(
    "options",
    [{}, {"index_types": IndexType.NONE}, {"use_chunking": False}],
    ids=["indexed", "without indexes", "without chunks"],
)
def test_truncated_mcap_of_any_recorder_opens_up_to_the_cut(tmp_path, options):
    path = fill(BagMaker("mcap file"), frames=20).write(tmp_path)
    rewrite(path, **options)
    whole, found = path.read_bytes(), list[int]()
    for share in np.linspace(0.02, 0.999, 15):
        path.write_bytes(whole[: int(share * len(whole))])
        try:
            found.append(frames_up_to_the_cut(path))
        except InputError as error:
            assert "ends before its first message" in str(error) or "no topic with depth" in str(
                error
            )
            found.append(0)
    assert found == sorted(found) and len(set(found)) > 5
    assert found[0] == 0 and found[-1] == 20


def test_last_complete_chunk_is_read_without_its_indexes(tmp_path):
    path, cut = fill(BagMaker("mcap file"), frames=20).write(tmp_path), tmp_path / "cut.mcap"
    rewrite(path)
    whole, frames = path.read_bytes(), 0
    with path.open("rb") as file:
        for record in StreamReader(file, emit_chunks=True).records:
            if isinstance(record, Chunk):
                before, inside = frames, breakup_chunk(record)
                frames += sum(isinstance(m, Message) and len(m.data) > 3000 for m in inside)
                # a file system may give a file its size before it has what was written to it
                cut.write_bytes(whole[: file.tell() - 1000] + bytes(1000))
                assert not before or frames_up_to_the_cut(cut) == before
            if isinstance(record, Chunk | MessageIndex) and frames:
                cut.write_bytes(whole[: file.tell()])
                assert frames_up_to_the_cut(cut) == frames
    assert frames == 20


def test_chunk_with_a_wrong_checksum_is_refused(tmp_path):
    path = fill(BagMaker("mcap file")).write(tmp_path)
    rewrite(path)
    with path.open("rb") as file:
        chunk = next(
            r for r in StreamReader(file, emit_chunks=True).records if isinstance(r, Chunk)
        )
    checksum = chunk.uncompressed_crc.to_bytes(4, "little")
    path.write_bytes(path.read_bytes().replace(checksum, bytes([checksum[0] ^ 1]) + checksum[1:]))
    with pytest.raises(InputError, match="checksum does not match"):
        read_all(path)


@pytest.mark.parametrize(("kind", "text"), [("bag lz4", b"topic="), ("db3 file", b"/cam/depth")])
def test_damaged_text_is_called_damage(tmp_path, kind, text):
    path = fill(BagMaker(kind)).write(tmp_path)
    path.write_bytes(path.read_bytes().replace(text, b"\xff" + text[1:]))
    assert "(some of its bytes are damaged); copy the recording again" in refusal(path)


def test_an_mcap_with_a_damaged_summary_is_scanned(tmp_path):
    path = fill(BagMaker("mcap file")).write(tmp_path)
    rewrite(path)
    with path.open("rb") as file:
        second = make_reader(file).get_summary().chunk_indexes[1].chunk_start_offset
    before, name, after = path.read_bytes().rpartition(b"/cam/depth/image")  # in the summary
    path.write_bytes(before + b"\xff" + name[1:] + after)
    with pytest.raises(UnicodeDecodeError), path.open("rb") as file:
        make_reader(file).get_summary()
    assert info(path).frames == 6
    read_all(path)
    damaged = bytearray(path.read_bytes())
    damaged[second] = 15  # a chunk that pretends to be the end of the data
    path.write_bytes(damaged)
    with pytest.raises(InputError):  # not a recording of the first chunk alone
        read_all(path)


def rewrite(path, **options):
    """The same messages by the `mcap` library, in chunks of a few images."""
    copied(path, path, chunk_size=8_000, **options)


def frames_up_to_the_cut(path):
    """How many frames open, each as it was recorded."""
    with Recording(path) as recording:
        assert "ends early" in recording.bag.note
        for k in range(len(recording)):
            np.testing.assert_array_equal(recording[k].depth_m, depth_image(k))
        return len(recording)


@pytest.mark.parametrize(
    "kind", ["mcap file", "mcap folder", "mcap file lz4", "db3 file", "bag none", "bag bz2"]
)
def test_mutated_files_are_read_or_refused(tmp_path, kind):
    """Flipped, overwritten, doubled and removed bytes: only InputError is raised."""
    path = fill(BagMaker(kind.removesuffix(" lz4")), frames=2).write(tmp_path)
    if kind.endswith("lz4"):  # as our recorder writes
        rewrite(path, compression=CompressionType.LZ4)
    files = [path] if path.is_file() else sorted(path.iterdir())
    pristine = {file: file.read_bytes() for file in files}
    rng = random.Random(kind)
    refused = 0
    for _ in range(int(os.environ.get("BUBBLEVIZ_MUTATIONS", "40"))):
        file = rng.choice(files)
        file.write_bytes(mutated(pristine[file], rng))
        try:
            read_all(path)
        except InputError as error:
            assert "\n" not in str(error)
            refused += 1
        file.write_bytes(pristine[file])
    assert refused > 5  # else the mutations prove nothing
    read_all(path)


def mutated(data, rng):
    at = rng.randrange(len(data))
    count = rng.choice([1, 4, 8, 64, 1000])
    junk = rng.choice([b"\xff" * count, bytes(count), rng.randbytes(count)])
    return rng.choice(
        [
            data[:at] + junk + data[at + count :],
            data[:at] + data[at + count :],
            data[:at] + junk + data[at:],
            data[:at] + data[at : at + count] + data[at:],
        ]
    )


def test_unreadable_file(tmp_path):
    if os.geteuid() == 0:
        pytest.skip("root reads everything")
    path = fill(BagMaker("mcap file")).write(tmp_path)
    path.chmod(0)
    refusal(path)


def test_a_recording_folder_with_a_missing_file(tmp_path):
    path = fill(BagMaker("mcap folder")).write(tmp_path)
    next(path.glob("*.mcap")).unlink()
    refusal(path)
    shutil.rmtree(path)
