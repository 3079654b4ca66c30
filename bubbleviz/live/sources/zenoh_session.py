"""Zenoh sessions with explicit endpoints: no discovery by multicast or gossip."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zenoh

from bubbleviz.errors import InputError
from bubbleviz.live.sources.source_uri import SourceUri

ROUTER = "tcp/127.0.0.1:7447"
"""Where `rmw_zenohd`, `zenohd` and `zenoh-bridge-ros2dds` listen."""

_RETRY = {"period_init_ms": 200, "period_max_ms": 2000, "period_increase_factor": 1.5}
"""Zenoh connects again by itself, at these intervals."""


@dataclass(frozen=True)
class Credentials:
    """Files by which two sides know each other; each may be left out.

    Attributes
    ----------
    ca : str or None
        Certificate of the authority that the other side's must be of.
    cert, key : str or None
        Own certificate and its private key: of who listens at `tls/…`, and of who connects where
        that is asked for, by a `ca` of who listens.
    login : str or None
        Lines `user:password`: who listens lets these in, who connects is the first of them.
    """

    ca: str | None = None
    cert: str | None = None
    key: str | None = None
    login: str | None = None

    def settings(self, *, connects: bool) -> dict[str, Any]:
        """Zenoh's settings of them.

        Raises
        ------
        InputError
            A file is not there, or the first line of `login` is no `user:password`.
        """
        for file in filter(None, (self.ca, self.cert, self.key, self.login)):
            if not Path(file).is_file():
                raise InputError(f"{file}: no such file; check the path")
        tls, side = "transport/link/tls", "connect" if connects else "listen"
        found: dict[str, Any] = {
            f"{tls}/root_ca_certificate": self.ca,
            f"{tls}/{side}_certificate": self.cert,
            f"{tls}/{side}_private_key": self.key,
            f"{tls}/enable_mtls": True if self.ca and self.cert else None,
        }
        if self.login and connects:
            found |= _first_login(self.login)
        elif self.login:
            found["transport/auth/usrpwd/dictionary_file"] = self.login
        return {name: value for name, value in found.items() if value is not None}


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
    credentials: Credentials = Credentials()

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
        raise _refusal(options, error) from error
    return config


def _first_login(file: str) -> dict[str, str]:
    user, found, password = Path(file).read_text(encoding="utf-8").partition("\n")[0].partition(":")
    if not found:
        raise InputError(f"{file}: its first line is no user:password; write one")
    auth = "transport/auth/usrpwd"
    return {f"{auth}/user": user.strip(), f"{auth}/password": password.strip()}


def open_session(options: SessionOptions) -> Any:
    """Open `zenoh.Session`.

    Raises
    ------
    InputError
        The endpoint is malformed, the connection fails, or the address cannot be bound.
    """
    try:
        return zenoh.open(make_config(options))
    except zenoh.ZError as error:
        raise _refusal(options, error) from error


def connected(session: Any) -> bool:
    """Whether a session has anybody to talk to."""
    return bool(session.info.peers_zid() or session.info.routers_zid())


def _refusal(options: SessionOptions, error: Exception) -> InputError:
    text = str(error).split(" at /")[0]
    quoted = re.search(r'msg: "(.*?)"?\}?\)?$', text)
    reason = (quoted.group(1) if quoted else text).strip().rstrip("!.")[:160]
    return InputError(f"{options.text}: no Zenoh session ({reason}); give a place like {ROUTER}")
