"""The lab's server: who is let in, and sessions that outlive it."""

from __future__ import annotations

import asyncio
import http.client
import json
import re
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import parse_qs, urlsplit

import pytest

from kinegraph.devices.lab import jobs
from kinegraph.devices.lab.app import Lab, app_of
from kinegraph.devices.lab.app_server import listening
from kinegraph.devices.lab.sessions import LabSession, Sessions
from kinegraph.devices.page.access import Access
from kinegraph.devices.page.address import Address
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.recording import Recording
from tests.support.command_line import Command, kinegraph, refused
from tests.support.page_session import needs_page

__all__ = ["kinegraph"]

pytestmark = needs_page

TOKEN = "a-token"
ROUNDS = ("round one", "round two", "round three", "round four", "round five")
GRAPH = """
nodes:
  board: {use: devices.people.treadmill.Treadmill}
  rect: {use: operators.filters.rectify.Rectify, from: board.emg}
"""


class Client:
    """A client of a lab at a port."""

    def __init__(self, port: int) -> None:
        self.port = port

    def ask(self, method: str, path: str, body: Any = None, **headers: str) -> tuple[int, Any]:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        given = {"Cookie": f"kinegraph-{self.port}={TOKEN}", "X-Client": "me", **headers}
        connection.request(method, path, None if body is None else json.dumps(body), given)
        answer = connection.getresponse()
        text = answer.read()
        connection.close()
        kind = answer.headers.get("content-type", "")
        return answer.status, json.loads(text) if kind.startswith("application/json") else text.decode(errors="replace")


@contextmanager
def lab(home: Path) -> Iterator[Client]:
    """A lab in a thread of this process; it is gone afterwards, sessions are not."""
    import uvicorn

    heard = listening(Address(port=0), "lab")
    port = heard.getsockname()[1]
    config = uvicorn.Config(app_of(home, Access(TOKEN, port)), log_config=None, lifespan="off", ws="websockets-sansio")
    server = uvicorn.Server(config)
    thread = threading.Thread(target=lambda: asyncio.run(server.serve(sockets=[heard])), daemon=True)
    thread.start()
    try:
        yield Client(port)
    finally:
        server.should_exit = True
        thread.join(20)


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    with lab(tmp_path_factory.mktemp("home")) as found:
        yield found


def test_without_the_token_nothing_is_answered(client: Client) -> None:
    assert client.ask("GET", "/", Cookie="")[0] == 403
    assert client.ask("GET", "/api/home", Cookie=f"kinegraph-{client.port}=wrong")[0] == 403
    status, body = client.ask("GET", "/api/home")
    assert status == 200 and body["sessions"] == [] and body["uses"]


def test_the_token_in_the_address_becomes_a_cookie(client: Client) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", client.port, timeout=60)
    connection.request("GET", f"/?token={TOKEN}")
    answer = connection.getresponse()
    assert answer.status == 303 and answer.headers["location"] == "/"
    assert "HttpOnly; SameSite=Lax" in answer.headers["set-cookie"]
    connection.close()


def test_another_web_site_and_another_host_name_are_refused(client: Client) -> None:
    asked = {"graph": "treadmill_emg", "values": {}}
    assert client.ask("POST", "/api/sessions", asked, Origin="http://evil.example")[0] == 403
    assert client.ask("GET", "/api/home", Host=f"evil.example:{client.port}")[0] == 403


def test_answers_carry_what_browsers_must_refuse(client: Client) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", client.port, timeout=60)
    connection.request("GET", "/", headers={"Cookie": f"kinegraph-{client.port}={TOKEN}"})
    answer = connection.getresponse()
    policy = answer.headers["content-security-policy"]
    assert "default-src 'none'" in policy and "frame-ancestors 'none'" in policy and "frame-src 'self'" in policy
    assert "unsafe" not in policy and answer.headers["x-content-type-options"] == "nosniff"
    connection.close()


def test_what_is_wrong_is_refused_in_words(client: Client) -> None:
    status, body = client.ask("POST", "/api/sessions", {"graph": "../secret.yaml", "values": {}})
    assert status == 400 and "no graph" in body["error"]
    assert client.ask("GET", "/api/sessions/..%2F..%2Fetc")[0] in (400, 404)
    assert client.ask("GET", "/api/sessions/nothing")[0] == 400
    assert client.ask("POST", "/api/presets", [1])[0] == 400


def test_networks_are_downloaded_by_those_who_may(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    """The command itself: tests/avatar/test_fetch.py."""
    says = "import sys; print('4 of 10 MB', file=sys.stderr); sys.exit(sys.argv[1:] != ['files', 'fetch', 'camera-models'])"
    monkeypatch.setattr(jobs, "COMMAND", (sys.executable, "-S", "-c", says))
    wish = {"name": "camera-models"}
    assert client.ask("POST", "/api/downloads", wish, Origin="http://evil.example")[0] == 403
    assert client.ask("POST", "/api/downloads", wish, Cookie="")[0] == 403
    status, body = client.ask("POST", "/api/downloads", {"name": "--package=/etc/passwd"})
    assert status == 400 and "no download" in body["error"]
    _, begun = client.ask("POST", "/api/downloads", wish)
    found = dict[str, Any]()
    wait(lambda: found.update(client.ask("GET", f"/api/checks/{begun['id']}")[1]) or found["code"] >= 0)
    assert (found["code"], found["status"]) == (0, "4 of 10 MB\n")


def test_where_no_lab_can_be_is_named(kinegraph: Command, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("no folder")
    refused(kinegraph("lab", "notes.txt", "--for", "1", "--no-browser"), "notes.txt is a file", "name the folder")
    refused(
        kinegraph("lab", "--at", "no such host:1", "--for", "1", "--no-browser"), "cannot be served at no such host"
    )


@pytest.mark.parametrize("name", ["..", ".", ".hidden", "a/b", "a\\b", ""])
def test_no_session_leads_out_of_the_folder(name: str, tmp_path: Path) -> None:
    with pytest.raises(KinegraphError, match="no such session"):
        Sessions(tmp_path).of(name)


def test_one_at_a_time_controls_a_session(tmp_path: Path) -> None:
    lab = Lab(tmp_path)
    assert lab.controls("s", "one") and not lab.controls("s", "two") and not lab.controls("s", "")
    assert lab.controls("s", "two", take=True) and not lab.controls("s", "one")


def test_an_end_waits_for_a_process_that_is_being_started(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    async def ends_after_the_start() -> None:
        may_start = asyncio.Event()

        async def slow(*_: Any, **__: Any) -> Any:
            await may_start.wait()
            raise OSError

        monkeypatch.setattr(asyncio, "create_subprocess_exec", slow)
        check = asyncio.create_task(jobs.Check().run(tmp_path, "emg", "check-electrodes"))
        await asyncio.sleep(0)
        end = asyncio.create_task(jobs.settled())
        await asyncio.wait([end], timeout=0)
        assert not end.done()
        may_start.set()
        await end
        assert isinstance((await asyncio.gather(check, return_exceptions=True))[0], OSError)

    asyncio.run(ends_after_the_start())


def test_the_cameras_picture_stays_on_the_labs_own_machine(tmp_path: Path) -> None:
    request = SimpleNamespace(client=SimpleNamespace(host="192.168.1.20"))
    with pytest.raises(KinegraphError, match="own machine alone"):
        asyncio.run(Lab(tmp_path).post_look(request))  # type: ignore[arg-type]
    graph = {"graph": "treadmill_emg", "values": {}}
    with lab(tmp_path) as client:
        status, body = client.ask("POST", "/api/look", graph)
    assert status == 400 and "depth cameras; a bedside graph has one" in body["error"]


@pytest.mark.nightly
def test_a_session_outlives_the_lab_and_the_next_lab_ends_it(tmp_path: Path) -> None:
    (tmp_path / "graphs").mkdir()
    (tmp_path / "graphs" / "small.yaml").write_text(GRAPH)
    with lab(tmp_path) as first:
        status, made = first.ask(
            "POST", "/api/sessions", {"graph": "graphs/small.yaml", "values": {"session.subject": "P1"}}
        )
        assert status == 200
        path = f"/api/sessions/{made['id']}"
        wait(lambda: first.ask("GET", path)[1]["page"] and [*tmp_path.rglob("*.mcap")])
    with lab(tmp_path) as second:
        status, state = second.ask("GET", path)
        assert status == 200 and state["runs"] and state["subject"] == "P1" and "token" not in state["output"]
        status, page = second.ask("GET", f"/sessions/{made['id']}/")
        assert status == 200 and "page.js" in page
        assert second.ask("DELETE", path)[0] == 400, "it runs"
        wait(lambda: second.ask("POST", f"{path}/mark", {"text": "seen"})[0] == 200)
        assert second.ask("POST", f"{path}/mark", {"text": "not mine"}, **{"X-Client": "other"})[0] == 400
        wait(lambda: re.search(r"seen", LabSession(tmp_path / "sessions" / made["id"]).output) is not None)
        assert second.ask("POST", f"{path}/stop", {})[0] == 200
        wait(lambda: not second.ask("GET", path)[1]["runs"])
        state = second.ask("GET", path)[1]
        assert state["error"] == "" and state["lasted_s"] > 0 and state["recorded"]
        with Recording.open(tmp_path / "sessions" / made["id"]) as recording:
            assert recording.header["session"]["subject"] == "P1" and not recording.missing
            assert recording.read("annotations")[1]["text"].tolist() == ["seen"]
        assert second.ask("DELETE", path)[0] == 200 and not (tmp_path / "sessions" / made["id"]).exists()


def watched_by_two(url: str, session: LabSession, word: str) -> None:
    """Both look at the session; the first one alone can mark it, with the word."""
    place, path = urlsplit(url), f"/api/sessions/{session.id}"
    cookie = f"kinegraph-{place.port}={parse_qs(place.query)['token'][0]}"
    one, two = ({"Cookie": cookie, "X-Client": name} for name in ("one", "two"))
    client = Client(place.port or 0)
    wait(lambda: client.ask("GET", path, **one)[1]["page"])
    assert client.ask("GET", path, **one)[1]["controls"] and not client.ask("GET", path, **two)[1]["controls"]
    assert client.ask("GET", f"/sessions/{session.id}/", **two)[0] == 200
    assert client.ask("POST", f"{path}/mark", {"text": "not mine"}, **two)[0] == 400
    wait(lambda: client.ask("POST", f"{path}/mark", {"text": word}, **one)[0] == 200)
    wait(lambda: word in session.output)


@pytest.mark.nightly
def test_a_lab_that_is_killed_five_times_loses_nothing_while_two_watch_and_one_controls(tmp_path: Path) -> None:
    from tests.lab.test_lab_page import lab as lab_process

    home = tmp_path / "home"
    (home / "graphs").mkdir(parents=True)
    (home / "graphs" / "small.yaml").write_text(GRAPH)
    session = Sessions(home).run("graphs/small.yaml", "small", {}, simulate=False)
    for word in ROUNDS:
        with lab_process(home) as (process, url):
            watched_by_two(url, session, word)
            process.kill()
        assert session.runs
    session.stop()
    wait(lambda: not session.runs)
    with Recording.open(session.folder) as recording:
        assert not recording.missing and not [s for s in recording.streams.values() if s.gaps]
        assert recording.read("annotations")[1]["text"].tolist() == [*ROUNDS]


def wait(condition: Any, seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)
