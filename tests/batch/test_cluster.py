"""The batch on a real Dask cluster: scheduler and workers are processes that talk over TCP."""

import socket
import threading

import numpy as np
import pytest

from bubbleviz.api.batching import Job, batch, run_job
from bubbleviz.errors import InputError
from bubbleviz.processes import check_cluster, dask_cluster


@pytest.fixture(scope="module")
def address():
    from distributed import LocalCluster  # each process of the suite would load it

    with LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        protocol="tcp",
        host="127.0.0.1",
        dashboard_address=None,
    ) as own:
        yield own.scheduler_address


@pytest.mark.long
def test_results_equal_those_of_a_local_run(address, recordings, sensor, tmp_path):
    assert address.startswith("tcp://127.0.0.1:")
    (recordings / "bad.mcap").write_bytes(b"no recording")
    out = tmp_path / "out"
    far = batch(recordings, out, sensor, scheduler=address)
    assert [row.outcome for row in far.rows] == ["done", "done", "bad_input", "done"]
    for row in far.rows:
        if row.has_result:
            alone = tmp_path / "alone" / row.recording
            run_job(
                Job(row.recording, str(recordings / row.recording), str(alone), str(sensor), {})
            )
            paths = out / row.recording / "result.npz", alone / "result.npz"
            with np.load(paths[0]) as one, np.load(paths[1]) as two:
                np.testing.assert_array_equal(one["force_n"], two["force_n"])
    again = batch(recordings, out, sensor, scheduler=address, resume=True)
    assert [row.outcome for row in again.rows] == ["kept", "kept", "bad_input", "kept"]
    with pytest.raises(InputError, match="1 of 4 recordings have no result"):
        again.raise_failures()


@pytest.fixture
def _impatient(monkeypatch):
    monkeypatch.setattr(dask_cluster, "TIMEOUT_S", 1.0)


@pytest.mark.usefixtures("_impatient")
def test_no_scheduler_at_the_address(recordings, sensor, tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    with pytest.raises(InputError, match="no Dask scheduler answers; start one"):
        batch(recordings, tmp_path / "out", sensor, scheduler=address)
    assert not (tmp_path / "out").exists()


def test_server_that_is_not_a_scheduler():
    with socket.create_server(("127.0.0.1", 0)) as server:
        threading.Thread(target=_talk, args=(server,), daemon=True).start()
        with pytest.raises(InputError, match="no Dask scheduler answers"):
            check_cluster(f"tcp://127.0.0.1:{server.getsockname()[1]}")


@pytest.mark.parametrize("address", ["nonsense", "tcp://127.0.0.1", "foo://x:1"])
def test_invalid_address(address):
    with pytest.raises(InputError, match=f"--scheduler {address}: no Dask scheduler answers"):
        check_cluster(address)


def _talk(server):
    """Another program listens on the port, such as a web server."""
    while True:
        try:
            connection, _ = server.accept()
        except OSError:
            return
        with connection:
            connection.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")
