"""MP4 files, read back by ffmpeg."""

from collections.abc import Iterator

import imageio_ffmpeg
import numpy as np
import pytest

from bubbleviz.errors import InputError
from bubbleviz.output import open_mp4
from tests.program import python


def pictures(count, height, width):
    """Grey pictures with a bright bar that moves down."""
    for k in range(count):
        picture = np.full((height, width, 3), 60, np.uint8)
        picture[8 * k : 8 * (k + 1)] = (220, 40, 40)
        yield picture


def write(path, pictures, fps):
    with open_mp4(path, fps) as writer:
        for picture in pictures:
            writer.add(picture)


@pytest.mark.parametrize("size", [(64, 96), (65, 97)])
def test_video_frames_are_read_back(size, tmp_path):
    path = tmp_path / "view.mp4"
    write(path, pictures(8, *size), fps=12.5)
    reader = imageio_ffmpeg.read_frames(str(path))
    facts = next(reader)
    width, height = facts["size"]
    assert (height, width) == (64 if size[0] == 64 else 66, 96 if size[1] == 96 else 98)
    assert facts["fps"] == pytest.approx(12.5)
    assert facts["codec"] == "h264"
    assert "yuv420p" in facts["pix_fmt"]
    shown = [np.frombuffer(raw, np.uint8).reshape(height, width, 3) for raw in reader]
    assert len(shown) == 8
    for k, picture in enumerate(shown):
        red = picture[..., 0].astype(float).mean(axis=1)
        assert int(np.argmax(red[:64])) // 8 == k
        assert red[8 * k + 4] == pytest.approx(220, abs=20)


def test_an_unfinished_video_leaves_no_file(tmp_path):
    with pytest.raises(KeyboardInterrupt), open_mp4(tmp_path / "a.mp4", 30.0) as writer:
        for picture in pictures(3, 64, 64):
            writer.add(picture)
        raise KeyboardInterrupt
    with pytest.raises(InputError, match="no frames"):
        write(tmp_path / "b.mp4", [], 30.0)
    with pytest.raises(InputError, match="32×64 pixels, the first 64×64"):
        write(tmp_path / "c.mp4", [*pictures(1, 64, 64), *pictures(1, 64, 32)], 30.0)
    assert not list(tmp_path.iterdir())


def test_refusals_before_the_work(tmp_path):
    there = tmp_path / "there.mp4"
    there.write_text("mine")
    never: Iterator[np.ndarray] = iter(())
    with pytest.raises(InputError, match="exists already"):
        write(there, never, 30.0)
    with pytest.raises(InputError, match=r"end it in \.mp4"):
        write(tmp_path / "x.avi", never, 30.0)
    with pytest.raises(InputError, match="pictures per second"):
        write(tmp_path / "x.mp4", never, float("nan"))
    assert there.read_text() == "mine"


def test_errors_of_the_encoder_are_quoted(tmp_path):
    said = r"cannot write the video \(invalid width x height \(20000x2\)\); check"
    with pytest.raises(InputError, match=said):
        write(tmp_path / "a.mp4", [np.zeros((2, 20_000, 3), np.uint8)] * 30, 30.0)
    assert not list(tmp_path.iterdir())


def test_no_python_runs_between_fork_and_ffmpeg(tmp_path):
    """Python code run there by another thread's factorisation would print a traceback."""
    code = f"""
import threading
import numpy as np
from scipy.sparse import eye_array
from scipy.sparse.linalg import splu
from bubbleviz.output import open_mp4
made, over = threading.Event(), threading.Event()
def factor():
    kept = splu(eye_array(9, format="csc"))
    made.set()
    over.wait()
threading.Thread(target=factor).start()
made.wait()
try:
    with open_mp4({str(tmp_path / "a.mp4")!r}, 30.0) as writer:
        writer.add(np.zeros((32, 32, 3), np.uint8))
finally:
    over.set()
"""
    assert python(code) == ""
