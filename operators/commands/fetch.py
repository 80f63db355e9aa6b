"""`kinegraph files fetch pose-model`: the pose network, from the registry where its makers published it, checked before it is kept."""

from __future__ import annotations

import hashlib
import io
import tarfile
import urllib.error
import urllib.request
from pathlib import Path
from typing import Annotated

import typer

from kinegraph.operators.body.network.blazepose import FILE, SHA256, default_model
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.system.atomic_file import private_folder, write_complete
from kinegraph.stream.text.safe_text import say

PACKAGE = "https://registry.npmjs.org/@mediapipe/pose/-/pose-0.5.1675469404.tgz"
PACKAGE_BYTES = 64 << 20
"""A longer answer is not the package."""
NOTICE = """pose_landmark_full.tflite: BlazePose, of MediaPipe Pose 0.5.1675469404 (npm: @mediapipe/pose).
Copyright The MediaPipe Authors. Licensed under the Apache License, Version 2.0: http://www.apache.org/licenses/LICENSE-2.0
It is unchanged, and it is no part of kinegraph. Source: https://github.com/google-ai-edge/mediapipe
"""


def pose_model(
    package: Annotated[
        str, typer.Option("--package", metavar="FILE.tgz", help="the package, if it was downloaded otherwise")
    ] = "",
) -> None:
    """Download BlazePose (Apache-2.0; 41 MB, of which 6 are kept) for operators.body.network.PoseNetwork, and check it."""
    path = default_model()
    if path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() == SHA256:
        say(f"{path} already exists")
        return
    content = _network_in(Path(package).read_bytes() if package else _downloaded())
    private_folder(path.parent)
    write_complete(path.with_suffix(".NOTICE.txt"), NOTICE)
    write_complete(path, content)
    say(f"{path}: fetched and checked ({SHA256[:12]}...); its licence is in {path.with_suffix('.NOTICE.txt').name}")


def _downloaded() -> bytes:
    """The package. Raises KinegraphError."""
    say(f"downloading {PACKAGE}")
    try:
        with urllib.request.urlopen(PACKAGE, timeout=60) as answer:
            return bytes(answer.read(PACKAGE_BYTES))
    except (urllib.error.URLError, TimeoutError, OSError) as error:
        raise KinegraphError(
            f"{PACKAGE} cannot be downloaded ({error}); get it elsewhere (npm pack @mediapipe/pose@0.5.1675469404) "
            "and give it with --package FILE.tgz"
        ) from None


def _network_in(package: bytes) -> bytes:
    """The network in the package, checked. Raises KinegraphError."""
    try:
        with tarfile.open(fileobj=io.BytesIO(package), mode="r:gz") as archive:
            member = archive.extractfile(f"package/{FILE}")
            content = member.read() if member else b""
    except (tarfile.TarError, KeyError, OSError, EOFError) as error:
        raise KinegraphError(f"the package holds no {FILE} that can be read ({error}); nothing was kept") from None
    if hashlib.sha256(content).hexdigest() != SHA256:
        raise KinegraphError(f"{FILE} in the package is not the one that was published; nothing was kept")
    return content
