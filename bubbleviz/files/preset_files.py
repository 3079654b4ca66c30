"""Paths of the shipped presets and pages, and shared defaults; imports nothing, to start fast."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).parents[1]


def presets_folder(kind: str) -> Path:
    """Folder of the shipped presets of a kind: `sensors`, `objects`, `scenes` or `sessions`."""
    return _shipped("presets") / kind


def pages_folder() -> Path:
    return _shipped("docs")


def preset_names(kind: str) -> list[str]:
    return sorted(path.stem for path in presets_folder(kind).glob("*.toml"))


def _shipped(name: str) -> Path:
    """Folder in the installed package, else in the checkout."""
    installed = _PACKAGE / name
    return installed if installed.is_dir() else _PACKAGE.parent / name


SYNTHETIC_SENSOR = "pico_flexx_75mm"  # preset of the built-in live sensor, and of studies
TRUTH_SUFFIX = ".npz"  # of files with the ground truth of a simulated recording
SESSION_SUFFIX = ".bubbleviz"  # of files with a session of the window
MAX_COLOUR_DELAY_S = 0.5
"""Largest difference between stamps of colour and depth of one scene; chosen: 15 frames."""
