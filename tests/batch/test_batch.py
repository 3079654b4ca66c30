"""The command batch: real processes, real files, real signals."""

import os
import shutil
import signal
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
import pytest
from small_press import record, small_source

import bubbleviz as bv
from bubbleviz.api.batching import (
    BatchRow,
    BatchSummary,
    Job,
    find_recordings,
    run_in_processes,
    run_job,
)
from bubbleviz.api.run_summary import statistics
from bubbleviz.errors import InputError
from tests.program import COMMAND, facts_of, output_of, python, rows_of, run, start
from tests.recordings.bagmaker import START, BagMaker

NAMES = ["a.mcap", "b.v2.mcap", "day 1/c.mcap"]
LONG = 80  # frames
FILES = {"result.npz", "result.csv", "summary.json"}


def batch(*words):
    return subprocess.run(
        [*COMMAND, "batch", *map(str, words)], capture_output=True, text=True, check=False
    )


def resumed(*words):
    """Status of each recording as printed by a resumed batch, run in this process."""
    rows = facts_of("batch", *words, "--resume")["rows"]
    return {row["recording"]: row["outcome"] for row in rows}


def begin(*words):
    """The command in a session of its own, as a terminal would have it."""
    return start("batch", *words, start_new_session=True)


def table_of(out):
    return {row["recording"]: row for row in rows_of(out / "summary.csv")}


def hidden_in(out):
    """Temporary files and folders, some of which may go while they are listed."""
    there = [name for _, folders, files in os.walk(out) for name in (*folders, *files)]
    return [name for name in there if name.startswith(".")]


def unfinished_in(out):
    """Whether a result is being written, or was when its writer was killed."""
    return bool({*hidden_in(out)} - {".batch.lock"})


def lives(process):
    """Whether a process does anything still."""
    return process.is_running() and process.status() != psutil.STATUS_ZOMBIE


@pytest.fixture(scope="module")
def long_original(sensor, tmp_path_factory):
    """Takes longer than a worker outlives its parent: 0.2 s."""
    pressed = list(small_source(sensor, (0.044, 0.043))) * (LONG // 2)
    frames = (replace(each, index=k, time_s=k / 30.0) for k, each in enumerate(pressed))
    return record(tmp_path_factory.mktemp("long") / "z.mcap", frames)


@pytest.fixture
def long_recording(long_original, recordings):
    """One more among the others."""
    return Path(shutil.copy(long_original, recordings))


# -- one bad recording among good ones, and once more ------------------------------------------


def test_good_and_corrupted_recordings(recordings, sensor, tmp_path):
    good = (recordings / "a.mcap").read_bytes()
    (recordings / "bad.mcap").write_bytes(good[:1000])
    out = tmp_path / "out"
    done = batch(recordings, "--sensor", sensor, "--out", out, "--jobs", "2")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "1 of 4 recordings have no result" in done.stderr
    assert "bad.mcap: the recording ends before its first message" in done.stderr
    rows = table_of(out)
    assert list(rows) == [*NAMES[:2], "bad.mcap", NAMES[2]]
    assert [row["outcome"] for row in rows.values()] == ["done", "done", "bad_input", "done"]
    assert "ends before its first message" in rows["bad.mcap"]["error"]
    assert all(name in done.stdout for name in rows)
    for name in NAMES:
        assert {path.name for path in (out / name).iterdir()} == FILES
    assert not (out / "bad.mcap").exists()
    assert not hidden_in(out)

    shutil.copy(recordings / "a.mcap", recordings / "bad.mcap")  # repaired
    statuses = resumed(recordings, "--sensor", sensor, "--out", out)
    assert statuses == {**dict.fromkeys(NAMES, "kept"), "bad.mcap": "done"}


def test_truncated_recording_is_reported(recordings, sensor, tmp_path):
    cut = recordings / "cut.mcap"
    output_of("record", "--source", f"replay:{recordings / 'a.mcap'}", "--out", cut)
    cut.write_bytes(cut.read_bytes()[:-40])
    row = run_job(Job("cut.mcap", str(cut), str(tmp_path / "cut"), str(sensor), {}))
    assert row.outcome == "done"
    assert "ends early" in row.warning
    text = BatchSummary("t", [row]).to_text()
    assert "cut.mcap: cut.mcap ends early" in text


def test_numbers_equal_those_of_the_estimate_command(recordings, sensor, tmp_path):
    job = Job("a", str(recordings / "a.mcap"), str(tmp_path / "a"), str(sensor), {})
    row = run_job(job)
    bv.estimate(bv.open(recordings / "a.mcap"), sensor, out=tmp_path / "alone.npz")
    with np.load(tmp_path / "a" / "result.npz") as one, np.load(tmp_path / "alone.npz") as two:
        for key in ("force_n", "contact_pressure_pa", "patch_mask", "status"):
            np.testing.assert_array_equal(one[key], two[key])
        size = np.linalg.norm(two["force_n"], axis=1)
        touching = two["patch_area_m2"] > 0.0
        residual = two["residual_rms_m"]
    assert (row.outcome, row.frames, row.contact_frames) == ("done", 5, touching.sum())
    assert BatchSummary("t", [row, row]).to_text().count("constant tension") == 1
    assert row.max_force_n == pytest.approx(size.max())
    assert row.median_contact_force_n == pytest.approx(np.median(size[touching]))
    assert row.median_residual_rms_m == np.median(residual)
    assert (row.worst_frame, row.worst_residual_rms_m) == (np.argmax(residual), residual.max())


def test_frame_to_inspect_is_an_untrusted_one():
    nan = float("nan")
    values = {
        "frame": [10, 20, 30, 40],
        "status": ["ok", "no_data", "implausible", "no_contact"],
        "force_n": [[0, 3, 4], [nan] * 3, [nan] * 3, [0, 0, 0]],
        "measured_force_n": [4.0, 9.0, 9.0, 0.1],
        "patch_area_m2": [1e-4, nan, nan, 0],
        "residual_rms_m": [9e-3, nan, nan, 1e-4],
        "total_ms": [100, 2, 3, 4],
        "solve_ms": [1, 1, 1, 1],
        "kkt_residual": [0, nan, nan, 0],
    }
    rows = [dict(zip(values, each, strict=True)) for each in zip(*values.values(), strict=True)]
    row = BatchRow.of("r", rows, statistics(rows, [0.1, nan, nan, 0.0]) | {"sensor": "s"})
    assert (row.worst_frame, row.worst_status, row.untrusted_frames) == (20, "no_data", 2)
    assert (row.max_force_n, row.median_contact_force_n, row.median_total_ms) == (5.0, 5.0, 3.0)
    assert (row.median_contact_measured_force_n, row.sensor) == (4.0, "s")
    failed = BatchRow("q", "failed", error="it broke")
    summary = BatchSummary("sum.csv", [row, failed, row])
    assert repr(summary) == "<3 recordings: 2 done, 1 failed; table sum.csv>"


@pytest.mark.parametrize("change", ["settings", "sensor", "recording", "nothing", "summary"])
def test_which_recordings_are_estimated_again(change, recordings, sensor, tmp_path):
    own = Path(shutil.copy(sensor, tmp_path / "own.toml"))
    job = Job("b", str(recordings / NAMES[1]), str(tmp_path / "b"), str(own), {})
    assert run_job(job).outcome == "done"
    if change == "settings":
        job = Job(job.name, job.recording, job.out, str(own), {"kappa": 2.0})
    elif change == "sensor":
        own.write_text(own.read_text().replace("height_m = 0.05", "height_m = 0.0501"))
    elif change == "recording":
        shutil.copy(recordings / "a.mcap", job.recording)
    elif change == "summary":
        (tmp_path / "b" / "summary.json").write_text("{")
    row = run_job(job)
    assert row.outcome == ("kept" if change == "nothing" else "done")
    assert row.kappa == job.options.get("kappa")
    assert run_job(job).outcome == "kept"
    assert {path.name for path in (tmp_path / "b").iterdir()} == FILES


def test_a_folder_that_is_not_a_result_is_not_replaced(recordings, sensor, tmp_path):
    out = tmp_path / "b"
    out.mkdir()
    (out / "thesis.tex").write_text("years of work")
    row = run_job(Job("b", str(recordings / NAMES[1]), str(out), str(sensor), {}))
    assert row.outcome == "bad_input"
    assert "exists already" in row.error
    assert (out / "thesis.tex").read_text() == "years of work"


# -- stopped -----------------------------------------------------------------------------------


def test_killed_in_the_middle_then_resumed(
    recordings, sensor, long_recording, tmp_path, eventually
):
    out = tmp_path / "out"
    words = [recordings, "--sensor", sensor, "--out", out, "--jobs", "1"]
    running = begin(*words)
    # The others are done, the long one has begun.
    eventually(lambda: all((out / name).is_dir() for name in NAMES) and unfinished_in(out))
    os.killpg(running.pid, signal.SIGSTOP)  # else a slow machine might find the long one done
    workers = psutil.Process(running.pid).children(recursive=True)
    assert workers
    running.kill()
    os.killpg(running.pid, signal.SIGCONT)
    running.communicate()
    eventually(lambda: not any(lives(worker) for worker in workers))
    assert not (out / long_recording.name).exists()
    assert unfinished_in(out)  # killed: nobody could tidy up

    kept = {name: (out / name / "result.npz").stat().st_mtime_ns for name in NAMES}
    statuses = resumed(*words)
    assert statuses == {**dict.fromkeys(NAMES, "kept"), long_recording.name: "done"}
    assert {n: (out / n / "result.npz").stat().st_mtime_ns for n in NAMES} == kept
    assert not hidden_in(out)
    assert table_of(out)[long_recording.name]["frames"] == str(LONG)


@pytest.mark.long  # in short: in test_stopped_commands.py
def test_interrupt_leaves_complete_files(recordings, sensor, long_recording, tmp_path, eventually):
    out = tmp_path / "out"
    running = begin(recordings, "--sensor", sensor, "--out", out, "--jobs", "1")
    eventually(lambda: unfinished_in(out) and (out / NAMES[2]).is_dir())
    os.killpg(running.pid, signal.SIGINT)  # as ^C does: everybody gets it
    _, said = running.communicate(timeout=240)
    assert running.returncode == 130
    assert said.split() == ["bubbleviz:", "stopped"]
    assert not hidden_in(out)
    assert not (out / long_recording.name).exists()
    for name in NAMES:
        with np.load(out / name / "result.npz") as file:
            assert len(file["frame"]) == len(file["force_n"])


@pytest.mark.long
def test_second_batch_in_the_same_folder_is_refused(
    recordings, sensor, long_recording, tmp_path, eventually
):
    out = tmp_path / "out"
    words = [recordings, "--sensor", sensor, "--out", out]
    running = begin(*words)
    eventually(lambda: unfinished_in(out))
    os.killpg(running.pid, signal.SIGSTOP)  # it cannot end before the other one begins
    done = batch(*words, "--resume")
    os.killpg(running.pid, signal.SIGKILL)
    running.communicate()
    assert done.returncode == 2
    assert "another batch is writing there" in done.stderr


@pytest.mark.long
def test_crashed_process_loses_only_its_own_recording(
    recordings, sensor, long_recording, tmp_path, eventually
):
    jobs = [
        Job(path.name, str(path), str(tmp_path / path.name), str(sensor), {})
        for path in (long_recording, *(recordings / name for name in NAMES))
    ]
    running = run_in_processes(jobs, 1)
    me = psutil.Process()

    def kill_when_it_works():
        eventually(lambda: unfinished_in(tmp_path))
        for child in me.children():
            if "--multiprocessing-fork" in child.cmdline():
                child.kill()

    import threading

    killer = threading.Thread(target=kill_when_it_works)
    killer.start()
    rows = list(running)
    killer.join()
    assert [row.outcome for row in rows] == ["failed", "done", "done", "done"]
    assert "process ended with code -9" in rows[0].error


def test_blas_has_one_thread_in_a_worker(monkeypatch):
    code = """
    import os, threading
    from bubbleviz.processes import serve
    class Pipe:
        def recv(self): raise EOFError
    serve(Pipe(), os.getppid(), None)
    import numpy as np
    a = np.ones((1500, 1500)); a @ a
    print(len(os.listdir("/proc/self/task")) - threading.active_count())
    """
    for name in [each for each in os.environ if each.endswith("_NUM_THREADS")]:
        monkeypatch.delenv(name)
    assert python(code).strip() == "0"


# -- finding, and refusals ---------------------------------------------------------------------


def test_recordings_found_in_a_folder(tmp_path):
    for name in ("bag/metadata.yaml", "bag/bag_0.mcap", "deep/er/x.bag", "y.db3", "notes.txt",
                 ".z.0a1b2c3d.mcap", ".hidden/w.mcap"):  # fmt: skip
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    (tmp_path / "deep" / "loop").symlink_to(tmp_path)
    found = [str(path.relative_to(tmp_path)) for path in find_recordings(tmp_path)]
    assert found == ["bag", "deep/er/x.bag", "y.db3"]
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="no recording in it"):
        find_recordings(tmp_path / "empty")


def test_single_recording_as_input(recordings):
    (recordings / "metadata.yaml").touch()
    assert find_recordings(recordings) == [recordings]


def test_depth_topic_is_that_of_every_recording(tmp_path, sensor):
    folder, bag = tmp_path / "in", BagMaker("mcap file")
    for k, frame in enumerate(small_source(sensor)):
        bag.image(START + k * 10**8, np.zeros_like(frame.depth_m), topic="/left/depth/image")
        bag.image(START + k * 10**8, frame.depth_m, topic="/right/depth/image")
    folder.mkdir()
    shutil.copy(bag.write(tmp_path), folder)
    words = ("batch", folder, "--sensor", sensor, "--jobs", "1", "--out")
    assert run(*words, tmp_path / "first").exit_code == 2
    output_of(*words, tmp_path / "chosen", "--depth-topic", "/right/depth/image")
    (row,) = table_of(tmp_path / "chosen").values()
    assert row["outcome"] == "done" and float(row["max_force_n"]) > 1.0
