"""The package of the page on plug-ins, installed by pip: format, source and solver are usable."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pages import REPOSITORY, blocks

import bubbleviz as bv
from tests.program import output_of, refusal

PAGE = REPOSITORY / "docs" / "plugins.md"
BUILD = '[build-system]\nrequires = ["hatchling"]\nbuild-backend = "hatchling.build"\n\n'


@pytest.fixture(scope="module")
def lab(tmp_path_factory, sensor, press):
    """A folder with the sensor, the press as its own format, and the installed package."""
    folder = tmp_path_factory.mktemp("lab")
    package = folder / "package"
    package.mkdir()
    (toml,), (python,) = blocks(PAGE, "text"), blocks(PAGE, "python")
    (package / "pyproject.toml").write_text(BUILD + toml.text)
    (package / "lab_bubble.py").write_text(python.text)
    options = ["--no-deps", "--no-build-isolation", "--no-index", "--quiet"]
    install = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", *options]
    subprocess.run([*install, "--target", str(folder / "site"), str(package)], check=True)
    shutil.copy(sensor, folder)
    with bv.open(shutil.copy(press, folder)) as frames:
        np.save(folder / "press.npy", [frame.depth_m for frame in frames])
    return folder


@pytest.fixture
def installed(lab, monkeypatch):
    """The lab as working folder of this process, where the package is installed."""
    monkeypatch.syspath_prepend(lab / "site")
    monkeypatch.chdir(lab)
    return lab


def bubbleviz(lab, *words):
    """The command in a process of its own, where the package is installed."""
    paths = [str(lab / "site"), *filter(None, [os.environ.get("PYTHONPATH")]), str(REPOSITORY)]
    return subprocess.run(
        [sys.executable, "-m", "bubbleviz", *words],
        cwd=lab,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)},
        capture_output=True,
        text=True,
        timeout=300,
    )


def test_plugin_with_a_format_and_a_solver(installed):
    lab = installed
    done = bubbleviz(lab, *["estimate", "press.npy", "--sensor", "small.toml", "--out", "own.npz"])
    assert done.returncode == 0, done.stderr
    own = bv.load_run(lab / "own.npz")
    usual = bv.estimate(lab / "press.mcap", lab / "small.toml", solver="linear")
    # the same images, but without the gas pressure
    assert own.status.tolist() == usual.status.tolist()
    np.testing.assert_allclose(own.force_n, usual.force_n, atol=0.05 * np.abs(usual.force_n).max())
    words = "estimate press.npy --sensor small.toml --solver sharp --out sharp.npz"
    output_of(*words.split())
    sharp = bv.load_run(lab / "sharp.npz")
    assert sharp.status.tolist() == own.status.tolist()
    assert np.abs(sharp.force_n - own.force_n).max() > 1e-4


@pytest.mark.usefixtures("installed")
def test_plugin_with_a_live_source():
    words = "watch --source lab:press.npy?rate=10 --sensor small.toml --duration 20"
    assert " N" in output_of(*words.split())


def test_a_source_that_waits_for_its_next_frame_can_be_stopped(lab):
    words = "watch --source lab:press.npy?rate=0.001 --sensor small.toml --duration 1"
    done = bubbleviz(lab, *words.split())  # the next frame comes in 1,000 s, after the time-out
    assert done.returncode == 0, done.stderr


def test_errors_are_one_sentence(installed):
    (installed / "bad.npy").write_bytes(b"no array")
    estimate = "estimate --sensor small.toml --out other.npz"
    for words, says in (
        (f"{estimate} bad.npy", "bad.npy: the plug-in for this format failed"),
        (f"{estimate} none.npy", "none.npy: no such file"),
        ("watch --source lab:none.npy --sensor small.toml", "none.npy"),
        (f"{estimate} press.npy --solver best", "paper, rubber-base"),
    ):
        assert says in refusal(*words.split())


def test_window_opens_a_plugin_format(lab):
    if sys.platform != "linux":
        pytest.skip("starts an X server of its own")
    picture = lab / "press.png"
    done = bubbleviz(
        lab, "open", "press.npy", "--sensor", "small.toml", "--screenshot", str(picture)
    )
    assert done.returncode == 0, done.stderr
    assert Path(picture).stat().st_size > 10_000
