"""Zenoh sessions with explicit endpoints: no discovery by multicast or gossip."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from typing import Any

import zenoh

from bubbleviz.errors import InputError
from bubbleviz.live.sources.source_uri import SourceUri
from bubbleviz.live.sources.zenoh_credentials import Credentials
from bubbleviz.live.sources.zenoh_refusal import why_no_session

ROUTER = "tcp/127.0.0.1:7447"
"""Where `rmw_zenohd`, `zenohd` and `zenoh-bridge-ros2dds` listen."""

_RETRY = {"period_init_ms": 200, "period_max_ms": 2000, "period_increase_factor": 1.5}
"""Zenoh connects again by itself, at these intervals."""


class NotConnectedError(InputError):
    """Nobody answers at the endpoint, or who does accepts no session.

    Attributes
    ----------
    why : str
        And what to do.
    """

    def __init__(self, options: SessionOptions, why: str) -> None:
        super().__init__(f"{options.text}: no Zenoh session: {why}")
        self.why = why


@dataclass(frozen=True)
class SessionOptions:
    """Where a session connects to, or where it listens.

    A session that connects is a client and listens nowhere. A router hands messages to and from
    clients only, not between the peers that ROS 2 nodes are: they connect to each other directly.

    Attributes
    ----------
    text : str
        For messages to the user.
    connect, listen : str or None
        One endpoint such as `tcp/192.168.1.7:7447`.
    credentials : Credentials
    """

    text: str
    connect: str | None = None
    listen: str | None = None
    credentials: Credentials = field(default_factory=Credentials)

    @classmethod
    def of(cls, uri: SourceUri) -> SessionOptions:
        """Options of `zenoh:[endpoint]`, or of `zenoh:?listen=endpoint`."""
        given = uri.options
        listen = given.listen
        credentials = Credentials(given.ca, given.cert, given.key, given.login)
        if listen and uri.place:
            raise uri.refusal("give an endpoint to connect to, or listen=, not both")
        return cls(uri.text, None if listen else uri.place or ROUTER, listen, credentials)


def make_config(options: SessionOptions) -> Any:
    """Configuration of a session.

    Raises
    ------
    InputError
        The endpoint is malformed, or a file of the credentials is not there.
    """
    connects = options.connect is not None
    settings: dict[str, Any] = {
        "mode": "client" if connects else "peer",
        "connect/endpoints": [options.connect] if connects else [],
        "connect/timeout_ms": 0,
        "connect/retry": _RETRY,
        "listen/endpoints": [] if options.listen is None else [options.listen],
        "listen/timeout_ms": 0,
        "listen/exit_on_failure": True,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,
        **options.credentials.settings(connects=connects),
    }
    config = zenoh.Config()
    try:
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
    except zenoh.ZError as error:
        raise _no_session(options, error) from error
    return config


def open_session(options: SessionOptions) -> Any:
    """Open `zenoh.Session`.

    Raises
    ------
    InputError
        The endpoint is malformed, the connection fails, or the address cannot be bound.
    NotConnectedError
        There is no session, and it is known why.
    """
    config = make_config(options)
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        place = options.connect
        why = "" if place is None else why_no_session(place, options.credentials)
        if why:
            raise NotConnectedError(options, why) from error
        raise _no_session(options, error) from error


def connected(session: Any) -> bool:
    """Whether a session has anybody to talk to."""
    return bool(session.info.peers_zid() or session.info.routers_zid())


def _no_session(options: SessionOptions, error: Exception) -> InputError:
    text = str(error).split(" at /")[0]
    quoted = re.search(r'msg: "(.*?)"?\}?\)?$', text)
    reason = (quoted.group(1) if quoted else text).strip().rstrip("!.")[:160]
    return InputError(f"{options.text}: no Zenoh session ({reason}); give a place like {ROUTER}")
