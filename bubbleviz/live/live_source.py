"""Base class of live sources (a thread that delivers messages), and the `--source` URIs."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple
from urllib.parse import parse_qsl, unquote, urlsplit, urlunsplit

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from bubbleviz.errors import InputError
from bubbleviz.plugins import plugin
from bubbleviz.recordings import Encoding, Message
from bubbleviz.wording import reason_of

Link = Literal["connecting", "up", "lost", "ended"]
"""`lost`: it was up; the source reconnects automatically."""

Deliver = Callable[[Message], None]

_RETRY_S, _LONGER = (0.2, 2.0), 1.5
"""s between attempts to connect, first and longest, and their ratio; chosen."""


class OfferedTopic(NamedTuple):
    name: str
    type: str


class LiveSource:
    """Delivers messages from its own thread, in order of arrival and without gaps."""

    closing_s: float | None = None  # how long to wait for the thread to end, s

    def __init__(
        self,
        name: str,  # name in the window title
    ) -> None:
        self.name = name
        self.link: Link = "connecting"
        self.topics: tuple[OfferedTopic, ...] = ()  # found so far, of the types used here
        self.missed = 0  # messages lost on the way, by the publishers' sequence numbers
        self.preparing = ""  # text: progress before the first message
        self.problem = ""  # failure of the source itself as text; empty without one
        self._with_colour = False
        self._retry_s = 0.0
        self._stopped = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self, deliver: Deliver) -> None:
        """Begin; InputError when that is impossible. `deliver` must not raise."""
        self._thread = threading.Thread(
            target=self._main, args=(deliver,), name=self.name, daemon=True
        )
        self._thread.start()

    def stop(self) -> None:
        """Stop; nothing is delivered after it returns."""
        self._stopped.set()
        if self._thread not in (None, threading.current_thread()):
            self._thread.join(self.closing_s)
        self.link = "ended"

    @contextmanager
    def held(self) -> Iterator[None]:
        """Pause the source within the block, while a solver is built; only a replay can."""
        yield

    def follow_colour(self, on: bool = True) -> None:
        """Start or stop delivering colour images, which are large."""
        self._with_colour = on

    def _run(self, deliver: Deliver) -> None:
        """Deliver until the end, or until `_wait_until` returns False."""
        raise NotImplementedError

    def _wait_until(self, time_s: float) -> bool:
        """Sleep until a time of `time.monotonic`; returns False if stopped meanwhile."""
        return not self._stopped.wait(max(time_s - time.monotonic(), 0.0))

    def _wait_to_retry(self, *, anew: bool = False) -> bool:
        """Wait to connect again, longer each time, or `anew`; False if stopped meanwhile."""
        first, longest = _RETRY_S
        self._retry_s = first if anew else min(max(_LONGER * self._retry_s, first), longest)
        return self._wait_until(time.monotonic() + self._retry_s)

    def _main(self, deliver: Deliver) -> None:
        try:
            self._run(deliver)
        except BaseException as error:  # shown by the users of the source
            self.problem = reason_of(error)
        finally:
            self.link = "ended"


# URIs of live sources: `scheme:place?option=value&…`.


class SourceOptions(BaseModel):
    """Options of every scheme."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    # depth, info, pressure, wrench, colour: topics; None for the first that fits
    depth: str | None = None
    info: str | None = None
    pressure: str | None = None
    wrench: str | None = None
    colour: str | None = None
    prefix: str = ""  # common prefix of the sensor's topics
    # how much later the stamps of gas pressure and wrench are than the images', s
    lag: float = Field(0.0, ge=-1.0, le=1.0)


class SyntheticOptions(SourceOptions):
    """Options of `synthetic:`; the noise is relative to the range, the sensor's by default."""

    rate: float = Field(30.0, ge=0.1, le=1000.0)
    frames: int = Field(150, ge=1, le=100_000)
    noise: float | None = Field(None, ge=0.0, le=0.5)
    seed: int = Field(0, ge=0, le=2**31)
    ahead: bool = True
    encoding: Encoding = "32FC1"


class ReplayOptions(SourceOptions):
    speed: float = Field(1.0, ge=1e-3, le=1e3)
    loop: bool = False


class ZenohOptions(SourceOptions):
    """Options of `zenoh:`; `listen` is an endpoint, `domain` ROS 2's, the files are credentials."""

    listen: str | None = None
    ca: str | None = None
    cert: str | None = None
    key: str | None = None
    login: str | None = None
    domain: int = Field(0, ge=0, le=232)


class RealSenseOptions(SourceOptions):
    rate: int = Field(30, ge=1, le=300)
    exposure: float | None = Field(None, ge=0.001, le=1000.0)  # ms; None: as the camera is set
    loop: bool = False


class PluginOptions(SourceOptions):
    """Options of the scheme of a plug-in: its own are in `model_extra`, as text."""

    model_config = ConfigDict(extra="allow")


_SCHEMES: dict[str, tuple[type[SourceOptions], str]] = {
    "synthetic": (SyntheticOptions, "synthetic:[object][?rate=HZ&noise=RELATIVE]"),
    "replay": (ReplayOptions, "replay:REC[?speed=X&loop=1]"),
    "zenoh": (ZenohOptions, "zenoh:[tcp/HOST:PORT][?depth=/topic]"),
    "realsense": (RealSenseOptions, "realsense:[SERIAL | FILE.bag]"),
}
"""Options of each scheme, and an example."""


@dataclass(frozen=True)
class SourceUri:
    text: str  # as given
    # scheme, place: before and after the colon
    scheme: str
    place: str
    options: Any  # of the scheme's own type

    def refusal(self, what: str) -> InputError:
        """The error to raise about this source."""
        return _refusal(self.text, what)


def parse_uri(text: str) -> SourceUri:
    """Parse a source URI.

    Raises InputError: not a string, unknown scheme, or an option that is not `name=value`, given
    twice, unknown to the scheme, or out of range.
    """
    if not isinstance(text, str):  # Python callers may pass anything
        raise InputError(
            f'source: give a text such as "zenoh:", not a {type(text).__name__}; to solve a stream '
            "that is open already, use estimate or track"
        )
    text = text.strip()
    try:
        parts = urlsplit(text, allow_fragments=False)
        pairs = parse_qsl(parts.query, keep_blank_values=True, strict_parsing=True)
    except ValueError as error:
        raise _refusal(text, f"{error}; write it as SCHEME:PLACE?name=value&name=value") from error
    model, _ = _SCHEMES.get(parts.scheme, (PluginOptions, ""))
    if model is PluginOptions and plugin("sources", parts.scheme) is None:
        examples = ", ".join(example for _, example in _SCHEMES.values())
        raise _refusal(text, f"unknown scheme; begin with one of {examples}")
    given = dict(pairs)
    if len(given) < len(pairs):
        raise _refusal(text, "an option is given twice; give each once")
    try:
        options = model.model_validate(given)
    except ValidationError as error:
        raise _refusal(text, _first_problem(error, model, parts.scheme)) from error
    place = urlunsplit(("", parts.netloc, parts.path, "", ""))
    return SourceUri(text, parts.scheme, unquote(place), options)


def _first_problem(error: ValidationError, model: type[SourceOptions], scheme: str) -> str:
    problem = error.errors()[0]
    name = str(problem["loc"][0])
    options = model.model_json_schema()["properties"]
    if name not in options:
        return f"{name}: {scheme} has no such option; choose from {', '.join(sorted(options))}"
    may_be = options[name].get("anyOf", [options[name]])[0]
    if "enum" in may_be:
        what = f"choose one of {', '.join(may_be['enum'])}"
    elif may_be["type"] == "boolean":
        what = "give 1 or 0"
    else:
        kind = "whole number" if may_be["type"] == "integer" else "number"
        what = f"give a {kind} from {may_be['minimum']:g} to {may_be['maximum']:g}"
    return f"{name}={problem['input']}: {what}"


def _refusal(text: str, what: str) -> InputError:
    return InputError(f'--source "{text}": {what}')
