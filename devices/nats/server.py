"""Which NATS server is used, and as whom."""

from __future__ import annotations

import os
import re
import ssl
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from kinegraph.stream.errors import KinegraphError, ParameterError
from kinegraph.stream.params import build

NAME = re.compile(r"[A-Za-z0-9_-]+")
INSTALL = "pip install 'kinegraph[nats]'"


@dataclass(frozen=True, slots=True)
class NatsServer:
    """A NATS server with JetStream, and the account that is used there.

    url             nats://HOST:PORT; tls://HOST:PORT encrypts
    user            the user's name; its password is the first line of `password_file`, so that no graph holds one
    nkey_file       a file with an NKey seed, instead of user and password
    ca_file         the authority that has signed the server's certificate, where the system does not have it; it asks for TLS
    """

    url: str = "nats://127.0.0.1:4222"
    user: str = ""
    password_file: str = ""
    nkey_file: str = ""
    ca_file: str = ""

    def check(self) -> None:
        """Raises ParameterError for what cannot be."""
        if not re.fullmatch(r"(nats|tls)://[^@/\s]+", self.url):
            error = ParameterError("server", None, "nats://HOST:PORT or tls://HOST:PORT")
            error.args = (
                "server.url is not shown here, as it may hold a password; it must be nats://HOST:PORT or tls://HOST:PORT",
            )
            raise error
        for file in (self.password_file, self.nkey_file, self.ca_file):
            if file and not os.access(file, os.R_OK):
                raise ParameterError("server", file, "a file that exists and that the user who runs kinegraph may read")
        if bool(self.user) != bool(self.password_file):
            raise ParameterError("server", self.user or self.password_file, "a user and a password_file, or neither")
        if self.user and self.nkey_file:
            raise ParameterError("server", self.nkey_file, "left out where there is a user")

    @property
    def options(self) -> dict[str, Any]:
        """What the client library takes."""
        found: dict[str, Any] = {"servers": [self.url]}
        if self.user:
            text = Path(self.password_file).read_text(encoding="utf-8")
            found |= {"user": self.user, "password": next(iter(text.splitlines()), "")}
        if self.nkey_file:
            found["nkeys_seed"] = self.nkey_file
        if self.ca_file or self.url.startswith("tls:"):
            found["tls"] = ssl.create_default_context(cafile=self.ca_file or None)
        return found


def check_bed(bed: str) -> None:
    """Raises ParameterError for a name that cannot be part of a subject."""
    if not NAME.fullmatch(bed):
        raise ParameterError("bed", bed, "a name of letters, digits, - and _")


def account_of(file: Path) -> tuple[str, NatsServer]:
    """The bed and the server that a server.yaml of `kinegraph ward add` names; its files are beside it. Raises KinegraphError."""
    from kinegraph.stream.graph.reading.yaml_lines import parse

    try:
        found = parse(file.read_text(encoding="utf-8"), str(file)).plain()
        bed, server = str(found.get("bed", "centre")), build(NatsServer, found["server"])
    except (OSError, KeyError, TypeError, AttributeError) as error:
        raise KinegraphError(f"{file}: cannot be read as an account ({error}); kinegraph ward add writes one") from None
    check_bed(bed)
    for name in ("password_file", "nkey_file", "ca_file"):
        if value := getattr(server, name):
            server = replace(server, **{name: str((file.parent / value).absolute())})
    server.check()
    return bed, server
