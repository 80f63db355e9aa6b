"""`kinegraph files fetch`: from an origin on this machine, checked before anything is kept."""

from __future__ import annotations

import hashlib
import io
import tarfile
import threading
from collections.abc import Iterator
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from kinegraph.operators.body.network.published import POSE
from kinegraph.operators.commands import fetch
from tests.support.command_line import Command, kinegraph

__all__ = ["kinegraph"]

NETWORK = bytes(range(256)) * 40_000


def package_of(file: str, content: bytes) -> bytes:
    made = io.BytesIO()
    with tarfile.open(fileobj=made, mode="w:gz", compresslevel=0) as archive:
        member = tarfile.TarInfo(f"package/{file}")
        member.size = len(content)
        archive.addfile(member, io.BytesIO(content))
    return made.getvalue()


@pytest.fixture
def asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """What a registry on this machine, which has one package for all, is asked for."""
    package, paths = package_of(POSE.file, NETWORK), list[str]()

    class Registry(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            paths.append(self.path)
            self.send_response(200)
            self.send_header("Content-Length", str(len(package)))
            self.end_headers()
            self.wfile.write(package)

        def log_message(self, format: str, *arguments: object) -> None:
            """Nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Registry)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
    thread.start()
    monkeypatch.setenv(fetch.MIRROR, f"http://127.0.0.1:{server.server_address[1]}/")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    yield paths
    server.shutdown()
    server.server_close()
    thread.join()


def test_a_network_is_fetched_with_progress_and_kept_with_its_licence(
    asked: list[str], kinegraph: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours = replace(POSE, sha256=hashlib.sha256(NETWORK).hexdigest())
    monkeypatch.setattr(fetch, "POSE", ours)
    code, out, err = kinegraph("files", "fetch", "pose-model")
    assert code == 0 and asked == ["/@mediapipe/pose/-/pose-0.5.1675469404.tgz"]
    assert err.splitlines() == ["4 of 10 MB", "8 of 10 MB"]
    assert ours.default().read_bytes() == NETWORK and ours.is_kept()
    assert "Apache License" in ours.default().with_suffix(".NOTICE.txt").read_text() and "fetched and checked" in out
    assert "already exists" in kinegraph("files", "fetch", "pose-model")[1] and len(asked) == 1


def test_what_is_not_the_published_network_is_not_kept(asked: list[str], kinegraph: Command) -> None:
    code, _, err = kinegraph("files", "fetch", "pose-model")
    assert code and len(asked) == 1 and "is not the one that was published; nothing was kept" in err
    assert not POSE.default().exists()


def test_a_registry_that_does_not_answer_is_named_with_another_way(
    kinegraph: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(fetch.MIRROR, "http://127.0.0.1:9")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    code, _, err = kinegraph("files", "fetch", "pose-model")
    assert code and "npm pack @mediapipe/pose@0.5.1675469404" in err and "--package FILE.tgz" in err
