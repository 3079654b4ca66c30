"""Where the shipped presets are, and what they are called; imports nothing heavy."""

from __future__ import annotations

from pathlib import Path

_HERE = Path(__file__).parents[1]


def presets_folder(kind: str) -> Path:
    """Folder of the shipped presets of a kind: `sensors`, `objects`, `scenes` or `sessions`."""
    installed = _HERE / "presets" / kind
    return installed if installed.is_dir() else _HERE.parent / "presets" / kind


def preset_names(kind: str) -> list[str]:
    """Names of the shipped presets of a kind that are TOML files."""
    return sorted(path.stem for path in presets_folder(kind).glob("*.toml"))
