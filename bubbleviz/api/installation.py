"""Presets, and facts about this machine for bug reports."""

from __future__ import annotations

import os
import platform
import re
import subprocess
import sys
from dataclasses import dataclass
from importlib import metadata
from typing import Any

import numpy as np

import bubbleviz
from bubbleviz.api.summary import Summary
from bubbleviz.files import preset_names, presets_folder
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor import load_sensor
from bubbleviz.wording import how_to_install, size_text

_OPENGL = "import pyvista; print(pyvista.GPUInfo().renderer, pyvista.GPUInfo().version)"
_CAMERAS = """
import pyrealsense2 as sdk
names = sdk.camera_info.name, sdk.camera_info.serial_number
found = [" ".join(map(each.get_info, names)) for each in sdk.context().query_devices()]
print(", ".join(found) or "none connected")
"""
_TIMEOUT_S = 30.0
"""For an answer of a driver, which may hang or crash, in a separate process."""
_VARIABLES = ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM", "OPENBLAS_NUM_THREADS")


@dataclass(frozen=True)
class Listing(Summary):
    """Texts by name, in sections by title."""

    sections: dict[str, dict[str, str]]

    def facts(self) -> dict[str, Any]:
        """The sections."""
        return self.sections

    def to_text(self) -> str:
        """Text for the terminal."""
        lines = []
        for title, texts in self.sections.items():
            width = max(map(len, texts), default=0)
            lines += [title, *(f"  {name:<{width}}  {text}" for name, text in texts.items())]
        return "\n".join(lines)


def presets() -> Listing:
    """List the sensors and objects shipped with bubbleviz.

    Returns
    -------
    Listing
        With `sections` `sensors` and `objects`.
    """
    sensors, objects = {}, {}
    for name in preset_names("sensors"):
        own = load_sensor(name)
        shape = own.membrane.shape.replace("_", " ")
        sensors[name] = f"{own.name}, {shape}, camera of {size_text(own.camera.size)} pixels"
    for path in sorted(presets_folder("objects").glob("*.ply")):
        sides = 1e3 * np.ptp(load_object(path.stem).vertices, axis=0)
        objects[path.stem] = f"{' × '.join(f'{side:.0f}' for side in sides)} mm"
    return Listing({"sensors": sensors, "objects": objects})


def doctor() -> Listing:
    """List versions, libraries, OpenGL and cameras, for bug reports.

    Returns
    -------
    Listing
        With `sections` `machine`, `environment` and `libraries`.
    """
    machine = {
        "bubbleviz": bubbleviz.__version__,
        "Python": platform.python_version(),
        "system": f"{platform.platform()}, {os.cpu_count()} processors",
        "OpenGL": _answer(_OPENGL, "window"),
        "cameras": _answer(_CAMERAS, "realsense"),
    }
    environment = {name: os.environ[name] for name in _VARIABLES if name in os.environ}
    return Listing({"machine": machine, "environment": environment, "libraries": _libraries()})


def _libraries() -> dict[str, str]:
    """Version of each required or optional library, or how to install it."""
    try:
        requirements = metadata.requires("bubbleviz") or ()
    except metadata.PackageNotFoundError:
        text = "runs from its source folder, not installed, so its libraries are not listed"
        return {"bubbleviz": text}
    found = {}
    for requirement in requirements:
        name = re.split(r"[^\w.-]", requirement)[0]
        extra = re.search(r"extra == ['\"](.+?)['\"]", requirement)
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            if extra is not None:
                found[name] = f"not installed, optional; to add it: {how_to_install(extra[1])}"
            elif ";" not in requirement:  # else it may be for another system
                found[name] = "missing; install bubbleviz again"
    return found


def _answer(program: str, extra: str) -> str:
    """Last line printed by a short Python program in a separate process."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", program],
            capture_output=True,
            text=True,
            timeout=_TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"no answer in {_TIMEOUT_S:.0f} s"
    if "ModuleNotFoundError" in done.stderr:
        return f"unknown, as its library is not installed; to add it: {how_to_install(extra)}"
    lines = (done.stderr if done.returncode else done.stdout).split("\n")
    printed = [line.strip() for line in lines if line.strip()]
    return printed[-1] if printed else f"no answer; the process ended with code {done.returncode}"
