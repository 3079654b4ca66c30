"""Fixtures shared by all tests."""

import gc
import os
import shutil
import signal
import subprocess
import tempfile
import time
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace

import pytest
from hypothesis import settings

settings.register_profile("full", deadline=None)  # other work on this machine is no defect
settings.register_profile("quick", settings.get_profile("full"), max_examples=25)
settings.load_profile("full" if "TEST_ALL" in os.environ else "quick")
signal.signal(signal.SIGINT, signal.default_int_handler)  # `nohup` and `make test &` ignore it
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line sets it
os.environ["MPLBACKEND"] = "agg"  # a figure's window would be left to tests of windows
_SETTINGS = TemporaryDirectory(prefix="bubbleviz-tests-")
# the user's lists of fonts and compiled shaders, which take seconds to make
os.environ.setdefault("XDG_CACHE_HOME", str(Path.home() / ".cache"))
os.environ["XDG_CONFIG_HOME"] = _SETTINGS.name  # not the user's own session
os.environ["HOME"] = _SETTINGS.name  # the RealSense library makes a folder there

REPOSITORY = Path(__file__).parents[1]
LONG = (
    "pose",
    "shear",
    "inverse",
    "study",
    "benchmarks",
    "calibration",
    "ui/bench",
    "ui/calibration",
    "ui/live",
    "batch",
    "live",
    ".",
)
"""Rooms whose files take longest, and files of no room: first, so that no process ends on one.

After them come the other windows, and last the rooms without.
"""


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Modules and tests stay, so that looking for garbage among them takes time for nothing."""
    gc.disable()
    found = yield
    gc.enable()
    gc.freeze()
    return found


def pytest_collection_modifyitems(items):
    """Order the files for `--dist loadfile`, which hands them out in this order."""
    items.sort(key=_turn)
    if "TEST_ALL" not in os.environ:
        for item in items:
            if item.get_closest_marker("long"):
                item.add_marker(pytest.mark.skip(reason="make test-all runs it"))


def _turn(item):
    room = item.path.parent.relative_to(REPOSITORY / "tests").as_posix()
    if room in LONG:
        return LONG.index(room)
    return len(LONG) + (room.split("/")[0] != "ui")


@pytest.fixture(scope="session", autouse=True)
def _temporary_files(tmp_path_factory):
    """Temporary files of tests and their processes are in pytest's folder, which it removes."""
    folder = str(tmp_path_factory.mktemp("temporary"))
    before, tempfile.tempdir = tempfile.tempdir, folder
    os.environ["TMPDIR"] = folder
    yield
    tempfile.tempdir = before


@pytest.fixture(scope="session")
def punyo_press():
    """The real recording of a press, where this machine has it."""
    return _real_recording("punyo_press_a")


@pytest.fixture(scope="session")
def punyo_press_colour():
    """The same press with colour images from frame 45 on."""
    return _real_recording("punyo_press_a_color")


def _real_recording(name):
    path = REPOSITORY.parent / "shared" / "data" / name
    if not path.is_dir():
        pytest.skip(f"the real recording {name} is not on this machine")
    return path


@pytest.fixture(scope="session")
def sensor(tmp_path_factory):
    """File of a small sensor."""
    from small_press import write_small_sensor

    return write_small_sensor(tmp_path_factory.mktemp("sensor") / "small.toml")


@pytest.fixture(scope="session")
def press(sensor):
    """Recording of five frames, of which three are pressed."""
    from small_press import write_press

    return write_press(sensor.with_name("press.mcap"), sensor)


@pytest.fixture(scope="session")
def tls(tmp_path_factory):
    """Paths of certificates of two authorities, one of localhost with its key, and logins."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl, which makes the certificates, is not on this machine")
    folder = tmp_path_factory.mktemp("certificates")
    (folder / "names").write_text("subjectAltName=DNS:localhost\n")
    (folder / "login").write_text("ann:secret\n")
    (folder / "stranger").write_text("bob:secret\n")
    new = "req -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes"
    for words in (
        f"{new} -x509 -keyout ca_key -out ca -days 2 -subj /CN=authority",
        f"{new} -x509 -keyout other_key -out other -days 2 -subj /CN=other"
        " -addext subjectAltName=DNS:localhost",
        f"{new} -keyout key -out asked -subj /CN=localhost",
        "x509 -req -in asked -CA ca -CAkey ca_key -CAserial serial -CAcreateserial -extfile names"
        " -out cert -days 2",
    ):
        command = ("openssl", *words.split())
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
    return SimpleNamespace(**{path.name: str(path) for path in folder.iterdir()})


@pytest.fixture
def eventually():
    """Wait until a condition is true; the time limit is for broken code only."""

    def wait(condition, limit_s=240.0):
        deadline = time.monotonic() + limit_s
        while not condition():
            assert time.monotonic() < deadline, "it never came true"
            time.sleep(0.02)

    return wait


@pytest.fixture
def recwarn(recwarn):
    """Warnings, but not of files that earlier tests left open and are collected meanwhile."""
    warnings.simplefilter("ignore", ResourceWarning)
    return recwarn
