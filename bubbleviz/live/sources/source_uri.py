"""What `--source` may say: `scheme:place?option=value&…`."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from urllib.parse import unquote

from bubbleviz.errors import InputError

SCHEMES = {
    "synthetic": "synthetic:[object][?rate=HZ&noise=RELATIVE]",
    "replay": "replay:REC[?speed=X&loop=1]",
    "zenoh": "zenoh:[tcp/HOST:PORT][?depth=/topic]",
    "realsense": "realsense:[SERIAL | FILE.bag]",
}
"""Schemes, each with an example."""

_TRUE, _FALSE = ("1", "true", "yes", "on"), ("0", "false", "no", "off")


@dataclass(frozen=True)
class SourceUri:
    """A parsed source; its options are taken one by one, and what nobody took is refused.

    Attributes
    ----------
    text : str
        As given.
    scheme, place : str
        Before and behind the colon.
    """

    text: str
    scheme: str
    place: str
    _options: dict[str, str]
    _known: set[str] = field(default_factory=set)

    def text_of(self, name: str, default: str | None = None) -> str | None:
        """Option as text."""
        self._known.add(name)
        return self._options.get(name, default)

    def choice(self, name: str, among: tuple[str, ...]) -> str:
        """Option that is one of a few words; the first by default."""
        value = self.text_of(name) or among[0]
        if value not in among:
            raise self.refusal(f"{name}={value}: choose one of {', '.join(among)}")
        return value

    def number(self, name: str, default: float, low: float, high: float) -> float:
        """Option as a number between `low` and `high`."""
        text = self.text_of(name)
        if text is None:
            return default
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            raise self.refusal(f"{name}={text}: give a number from {low:g} to {high:g}")
        return value

    def flag(self, name: str, *, default: bool) -> bool:
        """Option that is on or off."""
        text = self.text_of(name)
        if text is None:
            return default
        if text.lower() not in _TRUE + _FALSE:
            raise self.refusal(f"{name}={text}: give 1 or 0")
        return text.lower() in _TRUE

    def check_all_known(self) -> None:
        """Refuse options that nobody asked for; call when all were."""
        for name in self._options:
            if name not in self._known:
                known = ", ".join(sorted(self._known))
                raise self.refusal(f"{name}: no such option of {self.scheme}; there are {known}")

    def refusal(self, what: str) -> InputError:
        """The error to raise about this source."""
        return InputError(f'--source "{self.text}": {what}')


def parse_uri(text: str) -> SourceUri:
    """Take a source apart.

    Raises
    ------
    InputError
        It begins with none of the schemes, or an option is not `name=value`.
    """
    scheme, colon, rest = text.strip().partition(":")
    if not colon or scheme not in SCHEMES:
        raise InputError(f'--source "{text}": begin with one of {", ".join(SCHEMES.values())}')
    place, _, query = rest.partition("?")
    options: dict[str, str] = {}
    for part in filter(None, query.split("&")):
        name, equals, value = part.partition("=")
        if not equals or not name:
            raise InputError(f'--source "{text}": "{part}" is no option; write name=value')
        if name in options:
            raise InputError(f'--source "{text}": {name} is given twice')
        options[name] = unquote(value)
    return SourceUri(text.strip(), scheme, unquote(place), options)
