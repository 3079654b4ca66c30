"""Zenoh sessions that find each other where they are told to, and nowhere else."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from bubbleviz.errors import InputError
from bubbleviz.live.uri import SourceUri

ROUTER = "tcp/127.0.0.1:7447"
"""Where `rmw_zenohd`, `zenohd` and `zenoh-bridge-ros2dds` listen."""
LOOPBACK = "tcp/127.0.0.1:0"

_RETRY = {"period_init_ms": 200, "period_max_ms": 2000, "period_increase_factor": 1.5}
"""Zenoh connects again by itself, at these intervals."""


@dataclass(frozen=True)
class SessionOptions:
    """Where a session connects to and listens.

    Attributes
    ----------
    text : str
        For messages to the user.
    connect, listen : tuple of str
        Endpoints such as `tcp/192.168.1.7:7447`. Listening is on loopback unless told otherwise.
    """

    text: str
    connect: tuple[str, ...] = (ROUTER,)
    listen: tuple[str, ...] = (LOOPBACK,)

    @classmethod
    def of(cls, uri: SourceUri) -> SessionOptions:
        """Options of `zenoh:[endpoint][?listen=endpoint]`; only listening with `zenoh:?listen=`."""
        listen = uri.text_of("listen")
        connect = (uri.place,) if uri.place else () if listen else (ROUTER,)
        return cls(uri.text, connect, (listen or LOOPBACK,))


def open_session(options: SessionOptions) -> Any:
    """Open `zenoh.Session`; who is not there yet is connected to when it comes.

    Raises
    ------
    InputError
        An endpoint is malformed, or nobody can listen there.
    """
    import zenoh

    settings = {
        "mode": "peer",
        "connect/endpoints": list(options.connect),
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": _RETRY,
        "listen/endpoints": list(options.listen),
        "listen/timeout_ms": 0,
        "listen/exit_on_failure": True,
        "scouting/multicast/enabled": False,
        "transport/shared_memory/enabled": False,
    }
    config = zenoh.Config()
    try:
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        return zenoh.open(config)
    except zenoh.ZError as error:
        reason = str(error).split(" at /")[0].strip()[:160]
        raise InputError(
            f"{options.text}: no Zenoh session ({reason}); give endpoints like {ROUTER}"
        ) from error


def connected(session: Any) -> bool:
    """Whether a session has anybody to talk to."""
    return bool(session.info.peers_zid() or session.info.routers_zid())
