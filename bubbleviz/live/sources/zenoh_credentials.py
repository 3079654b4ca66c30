"""Certificates, keys and passwords of Zenoh sessions."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bubbleviz.errors import InputError


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


def _first_login(file: str) -> dict[str, str]:
    user, found, password = Path(file).read_text(encoding="utf-8").partition("\n")[0].partition(":")
    if not found:
        raise InputError(f"{file}: its first line is no user:password; write one")
    auth = "transport/auth/usrpwd"
    return {f"{auth}/user": user.strip(), f"{auth}/password": password.strip()}
