"""Output files appear complete or not at all."""

import errno
import os
import signal
import subprocess
import sys

import pytest

from bubbleviz.errors import InputError
from bubbleviz.files import whole_file, write_rows


def test_file_appears_at_the_end_of_the_block(tmp_path):
    path = tmp_path / "result.npz"
    with whole_file(path) as temporary:
        assert temporary.suffix == ".npz"  # numpy appends it otherwise
        temporary.write_text("half")
        assert not path.exists()
    assert path.read_text() == "half"
    assert list(tmp_path.iterdir()) == [path]


def test_file_has_default_permissions(tmp_path):
    (tmp_path / "plain").write_text("")
    with whole_file(tmp_path / "whole") as temporary:
        temporary.write_text("")
    assert (tmp_path / "whole").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_folder_appears_at_the_end_of_the_block(tmp_path):
    with whole_file(tmp_path / "report") as temporary:
        temporary.mkdir()
        (temporary / "a.csv").write_text("1")
    assert (tmp_path / "report" / "a.csv").read_text() == "1"
    assert [entry.name for entry in tmp_path.iterdir()] == ["report"]


@pytest.mark.parametrize("folder", [False, True])
@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_failure_leaves_no_file(tmp_path, error, folder):
    with pytest.raises(error), whole_file(tmp_path / "out") as temporary:
        if folder:
            temporary.mkdir()
            (temporary / "a").write_text("1")
        else:
            temporary.write_text("half")
        raise error
    assert list(tmp_path.iterdir()) == []


def test_an_existing_file_is_refused_before_any_work(tmp_path):
    path = tmp_path / "out"
    path.write_text("precious")
    with pytest.raises(InputError, match="exists already"), whole_file(path):
        raise AssertionError("the block must not run")
    assert path.read_text() == "precious"


def test_file_created_meanwhile_is_kept(tmp_path):
    path = tmp_path / "out"
    with pytest.raises(InputError, match="exists already"), whole_file(path) as temporary:
        temporary.write_text("new")
        path.write_text("precious")
    assert path.read_text() == "precious"
    assert list(tmp_path.iterdir()) == [path]


def test_without_hard_links(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(errno.EPERM, "no hard links here")

    monkeypatch.setattr(os, "link", refuse)
    with whole_file(tmp_path / "out") as temporary:
        temporary.write_text("new")
    assert (tmp_path / "out").read_text() == "new"


def test_a_missing_folder_and_a_full_disk_are_input_errors(tmp_path):
    with pytest.raises(InputError, match="does not exist"), whole_file(tmp_path / "no" / "out"):
        pass
    with pytest.raises(InputError, match="No space left"), whole_file(tmp_path / "out"):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert list(tmp_path.iterdir()) == []


def test_longest_possible_file_name(tmp_path):
    path = tmp_path / f"{'a' * 251}.csv"
    with whole_file(path) as temporary:
        temporary.write_text("new")
    assert path.read_text() == "new"


def test_unwritable_folder_is_an_input_error(tmp_path):
    with pytest.raises(InputError, match="cannot be written"), whole_file(tmp_path / "out") as new:
        tmp_path.rmdir()  # as a share that is gone
        new.write_text("new")


def test_missing_input_is_not_reported_as_output(tmp_path):
    with pytest.raises(FileNotFoundError), whole_file(tmp_path / "out"):
        (tmp_path / "input").read_text()


@pytest.mark.parametrize("waited", [True, False])  # a container may have no init that waits
@pytest.mark.parametrize("name", ["a.csv", "b.mcap", "folder"])
def test_leftovers_of_a_killed_process_are_removed_by_the_next_run(tmp_path, name, waited):
    """But not files being written by others, nor files with similar names."""
    script = (
        "import os, sys; from bubbleviz.files import whole_file\n"
        "with whole_file(sys.argv[1]) as path: path.write_text('half'); os.kill(os.getpid(), 9)"
    )
    killed = subprocess.Popen([sys.executable, "-c", script, str(tmp_path / name)])
    ended = os.waitid(os.P_PID, killed.pid, os.WEXITED | (0 if waited else os.WNOWAIT))
    assert ended is not None and ended.si_status == signal.SIGKILL
    (tmp_path / ".a.notes.csv").write_text("mine")
    assert len(list(tmp_path.iterdir())) == 2
    with pytest.raises(InputError, match="exists"), whole_file(tmp_path / "a.csv") as outer:
        outer.write_text("1")
        with whole_file(tmp_path / "a.csv") as inner:
            assert {".a.notes.csv", outer.name} == {path.name for path in tmp_path.iterdir()}
            inner.write_text("2")
    assert {path.name for path in tmp_path.iterdir()} == {"a.csv", ".a.notes.csv"}
    assert (tmp_path / "a.csv").read_text() == "2"
    killed.wait()


def test_table_cells_are_never_formulas(tmp_path):
    write_rows(tmp_path / "a.csv", [{"name": "=1+1", "x": -1.5}, {"name": "\udcff", "x": 2}])
    assert (tmp_path / "a.csv").read_text().split() == ["name,x", "'=1+1,-1.5", r"\udcff,2"]
