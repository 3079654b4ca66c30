"""Live sensors in a session file: what of the disk they name. No Qt in here."""

from __future__ import annotations

from collections.abc import Callable
from urllib.parse import quote, unquote

from bubbleviz.live.session_preset import SessionPreset

ON_DISK = ("replay", "realsense")
"""Schemes whose place may be a file."""
SAFE = "/:\\ "
"""What a place may have as it is."""

Rename = Callable[[str], str]


def with_paths(live: SessionPreset, rename: Rename) -> SessionPreset:
    """The same live sensors with other names for every sensor file and recording."""
    places = tuple(
        place.model_copy(
            update={"sensor": rename(place.sensor), "source": source_with(place.source, rename)}
        )
        for place in live.sensors
    )
    title = source_with(live.title, rename)  # of a single sensor: its source
    return live.model_copy(update={"title": title, "sensors": places})


def with_sensor(live: SessionPreset, number: int, sensor: str) -> SessionPreset:
    """The same live sensors, one of them with another sensor file."""
    places = list(live.sensors)
    places[number] = places[number].model_copy(update={"sensor": sensor})
    return live.model_copy(update={"sensors": tuple(places)})


def source_with(source: str, rename: Rename) -> str:
    """A source with another name for the file it plays, where it plays one."""
    scheme, colon, rest = source.partition(":")
    place, question, options = rest.partition("?")
    if scheme not in ON_DISK or not place:
        return source
    return f"{scheme}{colon}{quote(rename(unquote(place)), safe=SAFE)}{question}{options}"
