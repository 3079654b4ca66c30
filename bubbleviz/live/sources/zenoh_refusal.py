"""Why there is no session with a Zenoh endpoint: Zenoh itself gives no reason."""

from __future__ import annotations

import re
import socket
import ssl

from bubbleviz.live.sources.zenoh_credentials import Credentials

PATIENCE_S = 1.0
"""Longest wait for an answer of the host, s; chosen."""
UNTRUSTED = range(18, 22)
"""OpenSSL's codes of certificates that no authority known here has signed."""


def why_no_session(endpoint: str, given: Credentials) -> str:
    """Why there is no session, and what to do; empty where that is not known.

    Parameters
    ----------
    endpoint : str
        `tcp/HOST:PORT` or `tls/HOST:PORT`, which Zenoh could not open a session with.
    given : Credentials
    """
    parts = re.match(r"(tcp|tls)/\[?([^\[\]]+?)\]?:(\d+)", endpoint)
    if parts is None:
        return ""
    protocol, host, port = parts[1], parts[2], int(parts[3])
    try:
        link = socket.create_connection((host, port), PATIENCE_S)
    except OSError as error:
        return _absence(error, host, port)
    with link:
        encrypted = protocol == "tls"
        why = _certificates(link, host, given) if encrypted else ""
    return f"refused: {why or _login(f'{host}:{port}', given, encrypted)}"


def _absence(error: OSError, host: str, port: int) -> str:
    """Why nobody answers, who may be there later."""
    if isinstance(error, socket.gaierror):
        return f"the host {host} is not known to this computer; check the name"
    if isinstance(error, ConnectionRefusedError):
        return f"nothing listens at {host}:{port}; check the port, or start the router or bridge"
    return f"{host}:{port} does not answer; check address and network"


def _certificates(link: socket.socket, host: str, given: Credentials) -> str:
    """What is wrong with the certificates of either side; empty where nothing is."""
    context = ssl.create_default_context()
    context.verify_flags &= ~ssl.VERIFY_X509_STRICT  # on from Python 3.13; Zenoh is not strict
    try:
        if given.ca:
            context.load_verify_locations(given.ca)
        if given.cert and given.key:
            context.load_cert_chain(given.cert, given.key)
    except ssl.SSLError:
        return "ca, cert or key holds no certificate or key in PEM form; check the files"
    try:
        secure = context.wrap_socket(link, server_hostname=host)
    except ssl.SSLCertVerificationError as error:
        return _untrusted(error, host, given)
    except OSError as error:
        return _other_side(error, host, given)
    with secure:
        if secure.getpeercert(binary_form=True) in context.get_ca_certs(binary_form=True):
            return f"the certificate of {host} is the authority's own; have it sign another"
        try:
            secure.recv(1)  # who misses our certificate says so only after the handshake
        except ssl.SSLError as error:
            return _other_side(error, host, given)
        except OSError:  # nothing is wrong with it
            pass
    return ""


def _untrusted(error: ssl.SSLCertVerificationError, host: str, given: Credentials) -> str:
    if error.verify_code in UNTRUSTED:
        signer = f"ca={given.ca}" if given.ca else "an authority that this system knows"
        return f"the certificate of {host} is not signed by {signer}; check ca="
    what = error.verify_message.rstrip(".")
    return f"the certificate of {host} does not hold: {what}; check the host name and the clocks"


def _other_side(error: OSError, host: str, given: Credentials) -> str:
    reason = str(getattr(error, "reason", "")).replace("_", " ").lower()
    if "alert" not in reason:
        return f"{host} does not answer encrypted; write tcp/ for tls/"
    if given.cert is None:
        return f"{host} asks for a certificate of this computer; give cert= and key= ({reason})"
    return f"{host} does not accept cert={given.cert}; have its authority sign it ({reason})"


def _login(place: str, given: Credentials, encrypted: bool) -> str:
    text = f"{place} answers and accepts no session"
    if given.login:
        text += f"; check user and password in login={given.login}"
    else:
        text += "; it may ask for user and password, give login="
    return text if encrypted else f"{text}; or it is encrypted, write tls/"
