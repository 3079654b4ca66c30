"""`.ci/setup` on other machines, simulated by stand-ins for Debian's commands."""

import fcntl
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[1]
pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux") or shutil.which("flock") is None,
    reason="Debian's package names, and locks of util-linux",
)


def machine(folder, packages):
    """A checkout's setup on a machine where these packages, or "all", are installed."""
    (folder / ".ci").mkdir()
    shutil.copy(REPOSITORY / ".ci" / "setup", folder / ".ci" / "setup")
    command = folder / "bin" / "dpkg-query"
    command.parent.mkdir()
    # called as dpkg-query -W -f FORMAT NAME, where NAME may be a pattern
    command.write_text(
        "#!/bin/sh\n"
        f"for package in {packages}; do\n"
        '    if [ "$package" = all ] && [ "$4" != "*t64" ]; then echo installed; exit; fi\n'
        '    case "$package" in $4) echo installed; exit;; esac\n'
        "done\n"
    )
    command.chmod(0o755)
    return {**os.environ, "PATH": f"{command.parent}:{os.environ['PATH']}"}


def setup(folder, *words, environment):
    return subprocess.run(
        [folder / ".ci" / "setup", *words], env=environment, capture_output=True, text=True,
        check=False,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("system", "installed", "glib"),
    [
        ("Debian 12, Ubuntu 22.04", "libc6 libssl3", "libglib2.0-0"),
        ("Debian 13, Ubuntu 24.04", "libc6 libssl3t64", "libglib2.0-0t64"),
    ],
)
def test_packages_that_were_renamed_and_no_others_have_the_new_name(
    system, installed, glib, tmp_path
):
    done = setup(tmp_path, "packages", environment=machine(tmp_path, installed))
    names = done.stdout.split()
    assert glib in names
    assert [name for name in names if name.endswith("t64")] == [glib] * glib.endswith("t64")
    assert {"libgl1", "libidn2-0", "xvfb"} <= set(names)


def test_unsuitable_interpreter_is_named(tmp_path):
    environment = machine(tmp_path, "all") | {"PYTHON": "/bin/false"}
    done = setup(tmp_path, environment=environment)
    assert done.returncode == 1
    assert "PYTHON=/bin/false is not a Python 3.11 to 3.13" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_a_second_setup_waits_for_the_first(tmp_path):
    environment = machine(tmp_path, "all") | {"PYTHON": "/bin/false"}
    with (tmp_path / ".ci" / "setup").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        second = subprocess.Popen(
            [tmp_path / ".ci" / "setup"], env=environment, stderr=subprocess.PIPE, text=True
        )
        assert "waiting" in second.stderr.readline()
        assert second.poll() is None
    assert "PYTHON=/bin/false" in second.communicate(timeout=60)[1]
