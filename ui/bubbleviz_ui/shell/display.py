"""Detection of a display, and a private virtual one (Xvfb)."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from bubbleviz.errors import InputError


def has_display(environment: Mapping[str, str] = os.environ) -> bool:
    """Whether there is a working display.

    Raises InputError: Wayland without an X server, which VTK needs.
    """
    if not sys.platform.startswith("linux") or _answers(environment.get("DISPLAY", "")):
        return True
    wayland = environment.get("WAYLAND_DISPLAY", "")
    if wayland and _listens(str(Path(environment.get("XDG_RUNTIME_DIR", "/")) / wayland)):
        raise InputError(
            "no X server answers in this Wayland session, but the window needs one; install "
            "XWayland (apt install xwayland) and log in again, or correct DISPLAY"
        )
    return False


@contextmanager
def private_display(width: int, height: int) -> Iterator[None]:
    """Run with a virtual display (Xvfb).

    A Qt application stays connected until the process ends, and Xlib reports "fatal IO error" if
    the server ends first. So the server ends itself with its last client (`-terminate`).

    Raises InputError: Xvfb is not installed or does not start.
    """
    xvfb = shutil.which("Xvfb")
    if xvfb is None:
        raise InputError(
            "no display, and Xvfb for drawing without one is missing; "
            "install it (apt install xvfb) or run in a desktop session"
        )
    read, write = os.pipe()
    arguments = ["-screen", "0", f"{width}x{height}x24", "-nolisten", "tcp", "-terminate"]
    server = subprocess.Popen(
        [xvfb, "-displayfd", str(write), *arguments],
        pass_fds=(write,),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.close(write)
    before = {name: os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")}
    try:
        with os.fdopen(read) as pipe:
            number = pipe.readline().strip()
        if not number:
            raise InputError("Xvfb does not start; run `Xvfb :99` to see why")
        os.environ["DISPLAY"] = f":{number}"
        os.environ.pop("WAYLAND_DISPLAY", None)
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value
        if not _has_application():
            server.terminate()
            server.wait(10)


def _has_application() -> bool:
    qt = sys.modules.get("PySide6.QtCore")
    return qt is not None and qt.QCoreApplication.instance() is not None


def _answers(display: str) -> bool:
    """Whether an X server is running; not checked on another host."""
    host, _, rest = display.partition(":")
    number = rest.split(".")[0]
    if not number.isdigit():
        return False
    if host not in ("", "unix"):
        return True
    path = f"/tmp/.X11-unix/X{number}"
    return any(_listens(address) for address in (path, "\0" + path))


def _listens(address: str) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
        return client.connect_ex(address) == 0
