"""Zenoh sessions with explicit endpoints: no discovery by multicast or gossip."""

from __future__ import annotations

import json
import re
import socket
import ssl
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple

import zenoh

from bubbleviz.errors import InputError
from bubbleviz.live.live_source import SourceUri

# Certificates, keys and passwords of Zenoh sessions.


@dataclass(frozen=True)
class Credentials:
    """Files for encryption and login; each is optional."""

    ca: str | None = None  # certificate of the authority that must have signed the other side's
    # cert, key: own certificate and private key: required to listen at `tls/…`, and to connect if
    # the listening side has a `ca`
    cert: str | None = None
    key: str | None = None
    # lines `user:password`: accepted when listening; the first one is used to connect
    login: str | None = None

    def settings(self, *, connects: bool) -> dict[str, Any]:
        """Settings for Zenoh.

        Raises InputError: a file is missing, or the first line of `login` is no `user:password`.
        """
        for file in filter(None, (self.ca, self.cert, self.key, self.login)):
            if not Path(file).is_file():
                raise InputError(f"{file}: no such file, or no access to it; check the path")
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


def _first_login(file: str) -> dict[str, str]:
    user, found, password = Path(file).read_text(encoding="utf-8").partition("\n")[0].partition(":")
    if not found:
        raise InputError(f"{file}: the first line is not user:password; correct it")
    auth = "transport/auth/usrpwd"
    return {f"{auth}/user": user.strip(), f"{auth}/password": password.strip()}


# Diagnosis of failed connections to a Zenoh endpoint: Zenoh itself gives no reason.


_ENDPOINT = re.compile(r"(\w+)/(\[[^\[\]]+\]|[^\[\]:]+):(\d+)")
"""Protocol, host and port."""
TIMEOUT_S = 1.0  # longest wait for an answer of the host, s; chosen
UNTRUSTED = range(18, 22)  # OpenSSL's codes of certificates signed by no known authority


def why_no_session(
    endpoint: str,  # `tcp/HOST:PORT` or `tls/HOST:PORT`, which Zenoh could not open a session with
    given: Credentials,
) -> str:
    """Text: why there is no session, and what to do; empty if unknown."""
    parts = _ENDPOINT.match(endpoint)
    if parts is None or parts[1] not in ("tcp", "tls"):
        return ""
    protocol, host, port = parts[1], parts[2].strip("[]"), int(parts[3])
    try:
        link = socket.create_connection((host, port), TIMEOUT_S)
    except OSError as error:
        return _absence(error, host, port)
    with link:
        encrypted = protocol == "tls"
        why = _certificates(link, host, given) if encrypted else ""
    return f"refused: {why or _login(f'{host}:{port}', given, encrypted)}"


def _absence(error: OSError, host: str, port: int) -> str:
    """Text: why the host does not answer, perhaps temporarily."""
    if isinstance(error, socket.gaierror):
        return f"the host name {host} cannot be resolved; check the name and the network"
    if isinstance(error, ConnectionRefusedError):
        return (
            f"nothing listens at {host}:{port}; check address and port, or start the router or "
            "bridge"
        )
    return f"{host}:{port} does not answer; check address, network and firewall"


def _certificates(link: socket.socket, host: str, given: Credentials) -> str:
    """Problem with the certificates of either side; empty for none."""
    context = ssl.create_default_context()
    context.verify_flags &= ~ssl.VERIFY_X509_STRICT  # on from Python 3.13; Zenoh is not strict
    try:
        if given.ca:
            context.load_verify_locations(given.ca)
        if given.cert and given.key:
            context.load_cert_chain(given.cert, given.key)
    except ssl.SSLError:
        return (
            "the file of ca=, cert= or key= is not in PEM form, or cert= and key= do not match; "
            "correct these files"
        )
    try:
        secure = context.wrap_socket(link, server_hostname=host)
    except ssl.SSLCertVerificationError as error:
        return _untrusted(error, host, given)
    except OSError as error:
        return _other_side(error, host, given)
    with secure:
        if secure.getpeercert(binary_form=True) in context.get_ca_certs(binary_form=True):
            return (
                f"the certificate of {host} is the authority's own; give {host} one that the "
                "authority signed"
            )
        try:
            secure.recv(1)  # a missing client certificate is reported only after the handshake
        except ssl.SSLError as error:
            return _other_side(error, host, given)
        except OSError:  # not a problem of certificates
            pass
    return ""


def _untrusted(error: ssl.SSLCertVerificationError, host: str, given: Credentials) -> str:
    if error.verify_code in UNTRUSTED:
        signer = f"ca={given.ca}" if given.ca else "an authority that this computer trusts"
        return (
            f"the certificate of {host} is not signed by {signer}; give the certificate of its "
            "authority as ca="
        )
    what = error.verify_message.rstrip(".")
    return (
        f"the certificate of {host}, or of its authority, is not valid: {what}; check the host "
        "name and both clocks, or renew the certificate"
    )


def _other_side(error: OSError, host: str, given: Credentials) -> str:
    reason = str(getattr(error, "reason", "")).replace("_", " ").lower()
    if "alert" not in reason:
        return f"{host} does not complete the TLS handshake; use tcp/ if it does not encrypt"
    if given.cert is None:
        return (
            f"{host} refuses the TLS connection ({reason}); if it asks for a certificate of this "
            "computer, give cert= and key="
        )
    return (
        f"{host} refuses the TLS connection ({reason}); if it does not accept cert={given.cert}, "
        "have its authority sign it"
    )


def _login(place: str, given: Credentials, encrypted: bool) -> str:
    text = f"{place} answers but opens no Zenoh session; check the port"
    if given.login:
        text += f", and user and password in login={given.login}"
    else:
        text += "; if it requires user and password, give login="
    return text if encrypted else f"{text}; if it requires encryption, use tls/"


ROUTER = "tcp/127.0.0.1:7447"  # where `rmw_zenohd`, `zenohd` and `zenoh-bridge-ros2dds` listen

_RETRY = {"period_init_ms": 200, "period_max_ms": 2000, "period_increase_factor": 1.5}
"""Zenoh reconnects by itself, at these intervals."""


class NotConnectedError(InputError):
    """The endpoint does not answer, or refuses the session."""

    def __init__(self, options: SessionOptions, why: str) -> None:
        super().__init__(f"{options.text}: no Zenoh session: {why}")
        self.why = why  # and what to do


@dataclass(frozen=True)
class SessionOptions:
    """Where a session connects to, or where it listens.

    A session that connects is a client and does not listen. ROS 2 nodes are peers, which connect to
    each other directly; a router forwards messages only to and from clients.
    """

    text: str  # for messages to the user
    # connect, listen: one endpoint such as `tcp/192.168.1.7:7447`
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

    Raises InputError: the endpoint is malformed, or a file of the credentials is missing.
    """
    connects = options.connect is not None
    endpoint = options.connect or options.listen or ""
    if endpoint.startswith(("tcp/", "tls/")) and not _ENDPOINT.match(endpoint):
        # without a port Zenoh tries for ten seconds, and names no reason
        raise InputError(
            f"{options.text}: {endpoint} is no host with a port; give it as {ROUTER}, an IPv6 "
            "address in brackets"
        )
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

    Raises InputError: the endpoint is malformed, the connection fails, or the address cannot be
    bound. Raises NotConnectedError: there is no session, and it is known why.
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


def listening_warning(options: SessionOptions) -> str:
    """Warning about a session that listens to other computers; else empty."""
    parts = _ENDPOINT.match(options.listen or "")
    if parts is None or re.fullmatch(r"localhost|127\.[\d.]+|\[::1\]", parts[2]):
        return ""
    given = options.credentials
    who = "anyone who knows the login" if given.login else "anyone"
    if parts[1] == "tls" and given.ca and given.cert:
        who = f"anyone with a certificate signed by {given.ca}"
    text = f"{options.listen} is open to other computers: {who} on the network can connect"
    text += "; give --login to prevent that" if who == "anyone" else ""
    return text + ("; messages are NOT ENCRYPTED, use tls/" if parts[1] != "tls" else "")


def connected(session: Any) -> bool:
    return bool(session.info.peers_zid() or session.info.routers_zid())


def _no_session(options: SessionOptions, error: Exception) -> InputError:
    text = str(error).split(" at /")[0]
    quoted = re.search(r'msg: "(.*?)"?\}?\)?$', text)
    reason = (quoted.group(1) if quoted else text).strip().rstrip("!.")[:160]
    return InputError(
        f"{options.text}: no Zenoh session ({reason}); check address, such as {ROUTER}, and "
        "credentials, and to listen that the port is free"
    )


# Names of ROS 2 topics in Zenoh, in the two layouts in use.
#
# `rmw_zenoh` publishes `/cam/depth` as `0/cam/depth/sensor_msgs::msg::dds_::Image_/RIHS01_…`
# (domain, topic, type, hash of the type) and announces it by the liveliness token
# `@ros2_lv/0/<session>/<node id>/<id>/MP/<enclave>/<namespace>/<node>/<topic>/<type>/<hash>/<qos>`,
# `%` for `/` within a part. The bridge `zenoh-bridge-ros2dds` publishes it as `cam/depth`, and
# announces `@/<session>/@ros2_lv/MP/<key>/<type>/<qos>` (before 1.0: `@ros2_lv/<session>/MP/…`),
# `§` for `/`.


TOKENS = ("@ros2_lv/**", "@/*/@ros2_lv/**")  # where publishers are announced

Layout = Literal["rmw", "dds"]

_DDS_SLASH = "§"
_TOPIC = re.compile(r"(/[^/*$#?@\s]+){1,32}")
_ATTACHMENT = struct.Struct("<qqB16s")


class Announced(NamedTuple):
    """A published topic and its key layout."""

    topic: str
    type: str
    layout: Layout


class Attachment(NamedTuple):
    """What `rmw_zenoh` sends with a message."""

    sequence: int
    stamp_ns: int
    publisher: bytes


def parse_token(key: str, domain: int) -> Announced | None:
    """Publisher that a liveliness token announces; None if it announces something else."""
    parts = key.split("/")
    if parts[0] == "@" and len(parts) >= 6 and parts[2] == "@ros2_lv":
        return _bridged(parts[3:])
    if parts[0] != "@ros2_lv" or len(parts) < 5:
        return None
    if parts[2] in ("MP", "MS", "SS", "SC", "AS", "AC"):
        return _bridged(parts[2:])
    if len(parts) < 12 or parts[1] != str(domain) or parts[5] != "MP":
        return None
    return _announced(parts[9].replace("%", "/"), ros_type(parts[10]), "rmw")


def _bridged(parts: list[str]) -> Announced | None:
    if len(parts) < 3 or parts[0] != "MP":
        return None
    key, kind = (part.replace(_DDS_SLASH, "/") for part in parts[1:3])
    return _announced(key, kind, "dds")


def _announced(key: str, kind: str | None, layout: Layout) -> Announced | None:
    topic = "/" + key.strip("/")
    return Announced(topic, kind, layout) if kind and is_topic(topic) else None


def is_topic(name: str) -> bool:
    """Whether a topic name is valid; Zenoh refuses others, or interprets them as patterns."""
    return _TOPIC.fullmatch(name) is not None


def subscription(topic: str, layout: Layout, domain: int) -> str:
    """Key expression that a topic's messages come under, whatever their type."""
    name = topic.strip("/")
    return f"{domain}/{name}/*/*" if layout == "rmw" else name


def type_of(key: str) -> str | None:
    """Type in the key of a message in rmw_zenoh's layout; None without one."""
    parts = key.split("/")
    return ros_type(parts[-2]) if len(parts) >= 4 else None


def ros_type(mangled: str) -> str | None:
    """`sensor_msgs/msg/Image` of `sensor_msgs::msg::dds_::Image_`; None of anything else."""
    parts = mangled.split("::")
    if len(parts) != 4 or parts[2] != "dds_" or not parts[3].endswith("_"):
        return None
    return f"{parts[0]}/{parts[1]}/{parts[3][:-1]}"


def dds_type(kind: str) -> str:
    """`sensor_msgs::msg::dds_::Image_` of `sensor_msgs/msg/Image`."""
    package, space, name = kind.split("/")
    return f"{package}::{space}::dds_::{name}_"


def publication(topic: str, kind: str, type_hash: str, domain: int) -> str:
    """Key that messages of a topic are published under, in rmw_zenoh's layout."""
    return f"{domain}/{topic.strip('/')}/{dds_type(kind)}/{type_hash}"


def announcement(
    topic: str, kind: str, type_hash: str, domain: int, session: str, number: int
) -> str:
    """Liveliness token of a publisher; the default quality of service."""
    mangled = topic.replace("/", "%")
    node = f"@ros2_lv/{domain}/{session}/0/{number}/MP/%/%/bubbleviz"
    return f"{node}/{mangled}/{dds_type(kind)}/{type_hash}/::,10:,:,:,,"


def pack_attachment(attachment: Attachment) -> bytes:
    """Attachment in the format of rmw_zenoh 0.2.4 and later, whose subscribers require it."""
    sequence, stamp, publisher = attachment
    return _ATTACHMENT.pack(sequence, stamp, 16, publisher)


def unpack_attachment(data: bytes | None) -> Attachment | None:
    """Attachment in the format of rmw_zenoh 0.2.4 and later; None in any other."""
    if data is None:
        return None
    if len(data) == _ATTACHMENT.size:
        sequence, stamp, length, publisher = _ATTACHMENT.unpack(data)
        return Attachment(sequence, stamp, publisher) if length == 16 else None
    return None
