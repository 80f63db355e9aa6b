"""A site's folder: accounts of the server, what a bed needs to connect, certificates.

server.yaml           the centre's own account, for graphs that read beds
accounts.json         accounts with their passwords (private)
server/               the nats-server's configuration and store
beds/NAME/            what is copied to a bed: server.yaml, password, ca.pem
certificate.pem, key.pem   of the server, where others reach it
"""

from __future__ import annotations

import datetime
import ipaddress
import json
import secrets
from pathlib import Path
from typing import Any

from kinegraph.devices.nats.local_server import CENTRE, Account, LocalServer
from kinegraph.devices.nats.server import INSTALL, NatsServer, check_bed
from kinegraph.devices.page.access import is_loopback
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.system.atomic_file import private_folder, write_complete
from kinegraph.stream.system.extras import optional

PORT = 4223
"""Not 4222, where Debian's package starts a server of its own."""
VALID = datetime.timedelta(days=3650)


class WardSite:
    """The folder of a site with a server of its own.

    moved   whether beds reach it elsewhere than before: their folders are written again, and must be copied again
    """

    def __init__(self, home: Path, host: str = "127.0.0.1", port: int = PORT) -> None:
        self.home = private_folder(home)
        facts: dict[str, Any] = {"host": host, "port": port, "accounts": []}
        if (home / "accounts.json").exists():
            try:
                facts |= json.loads((home / "accounts.json").read_text(encoding="utf-8"))
            except (OSError, ValueError) as error:
                raise KinegraphError(f"{home / 'accounts.json'} cannot be read ({error})") from None
        before = facts["host"], facts["port"]
        if host != "127.0.0.1":
            facts["host"] = host
        if port != PORT:
            facts["port"] = port
        self.moved = bool(facts["accounts"]) and before != (facts["host"], facts["port"])
        self.host, self.port = str(facts["host"]), int(facts["port"])
        self.accounts = [Account(**one) for one in facts["accounts"]]
        if not self.accounts:
            self._add(CENTRE)
        if self.moved:
            (home / "certificate.pem").unlink(missing_ok=True)  # it is for the host of before
            self._keep()
            for bed in self.beds:
                self._folder(bed)
        write_complete(home / CENTRE, self.account(CENTRE).password)
        ca = "  ca_file: certificate.pem\n" if self.encrypted else ""
        text = f"server:\n  url: {self._url('127.0.0.1')}\n  user: {CENTRE}\n  password_file: {CENTRE}\n{ca}"
        write_complete(home / "server.yaml", text)

    def account(self, name: str) -> Account:
        return next(one for one in self.accounts if one.name == name)

    @property
    def beds(self) -> tuple[str, ...]:
        return tuple(one.name for one in self.accounts if one.name != CENTRE)

    def add(self, bed: str) -> Path:
        """An account for a bed; returns the folder that is copied there. Raises ParameterError for a name that cannot be."""
        check_bed(bed)
        if bed == CENTRE:
            raise KinegraphError(f"{bed} is the centre's own account; choose another name")
        if bed not in self.beds:
            self._add(bed)
        return self._folder(bed)

    def _folder(self, bed: str) -> Path:
        """What is copied to the bed."""
        folder = private_folder(self.home / "beds" / bed)
        write_complete(folder / "password", self.account(bed).password)
        server = {"url": self._url(self.host), "user": bed, "password_file": "password"}
        if self.encrypted:
            server["ca_file"] = "ca.pem"
            write_complete(folder / "ca.pem", (self.home / "certificate.pem").read_bytes())
        text = "".join(f"  {name}: {json.dumps(value)}\n" for name, value in server.items())
        write_complete(folder / "server.yaml", f"bed: {bed}\nserver:\n{text}")
        return folder

    @property
    def encrypted(self) -> bool:
        return not is_loopback(self.host)

    def _url(self, host: str) -> str:
        return f"{'tls' if self.encrypted else 'nats'}://{host}:{self.port}"

    @property
    def server(self) -> NatsServer:
        """The centre's own way to it."""
        ca = str(self.home / "certificate.pem") if self.encrypted else ""
        return NatsServer(self._url("127.0.0.1"), CENTRE, str(self.home / CENTRE), ca_file=ca)

    def local_server(self) -> LocalServer:
        """The server's process, configured and not started yet."""
        tls = self._certificate() if self.encrypted else None
        return LocalServer(
            self.home / "server", self.port, self.accounts, host="0.0.0.0" if self.encrypted else "127.0.0.1", tls=tls
        )

    def _add(self, name: str) -> None:
        self.accounts.append(Account(name, secrets.token_urlsafe(24)))
        self._keep()

    def _keep(self) -> None:
        if self.encrypted:
            self._certificate()
        facts = {
            "host": self.host,
            "port": self.port,
            "accounts": [{"name": one.name, "password": one.password} for one in self.accounts],
        }
        write_complete(self.home / "accounts.json", json.dumps(facts))

    def _certificate(self) -> tuple[Path, Path]:
        """The server's certificate, made once; beds get it as the authority that they trust."""
        certificate, key = self.home / "certificate.pem", self.home / "key.pem"
        if not certificate.exists():
            optional("cryptography", "a certificate", INSTALL)
            made, secret = self_signed(self.host)
            write_complete(key, secret)
            write_complete(certificate, made)
        return certificate, key


def self_signed(host: str) -> tuple[bytes, bytes]:
    """A certificate for a host (and for this machine), and its key."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import NameOID

    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, f"kinegraph ward {host}"[:64])])
    names: list[x509.GeneralName] = [x509.DNSName("localhost"), x509.IPAddress(ipaddress.ip_address("127.0.0.1"))]
    try:
        names.append(x509.IPAddress(ipaddress.ip_address(host)))
    except ValueError:
        names.append(x509.DNSName(host))
    now = datetime.datetime.now(datetime.UTC)
    made = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + VALID)
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .sign(key, hashes.SHA256())
    )
    return made.public_bytes(serialization.Encoding.PEM), key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
