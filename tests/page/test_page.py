"""The page of a running session: what a browser draws, what people do in it, and that clients do not change the graph's output."""

from __future__ import annotations

import http.client
import json
import os
import re
import signal
import ssl
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from prometheus_client.openmetrics.parser import text_string_to_metric_families
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from kinegraph.stream.recording import Recording
from tests.support.browser import needs_browser
from tests.support.command_line import KINEGRAPH
from tests.support.live_browser import LiveBrowser, live_browser
from tests.support.page_session import PageProcess, needs_page, page_process, see, until
from tests.support.tiers import rest_nightly

pytestmark = [needs_page, pytest.mark.timeout(280)]

HOSTILE = '<img src=x onerror=alert(1)>"&amp;'
SMALL = f"""
name: small
session: {{subject: '{HOSTILE}'}}
record: [calf, active.interval]
nodes:
  board: {{use: devices.people.treadmill.Treadmill}}
  level: {{use: stream.manual.Value, initial: 40, least: 0, most: 100, unit: uV}}
  calf: {{use: operators.filters.channels.Select, from: board.emg, channels: [GM, SO]}}
  active: {{use: operators.filters.threshold.Threshold, from: calf, channel: GM, level: 40, release: 25}}
"""


@pytest.fixture
def small(tmp_path: Path) -> Iterator[PageProcess]:
    (tmp_path / "small.yaml").write_text(SMALL)
    with page_process(tmp_path, "run", "small.yaml", "--view", "none", "-o", "s") as process:
        yield process


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PageProcess]:
    """The same session for all tests that only look at it."""
    folder = tmp_path_factory.mktemp("running")
    (folder / "small.yaml").write_text(SMALL)
    with page_process(folder, "run", "small.yaml", "--view", "none", "--no-record") as process:
        yield process


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveBrowser]:
    with live_browser(tmp_path_factory.mktemp("browser")) as found:
        yield found


def verified(folder: Path) -> None:
    """The recording is whole, and the graph gave what it gives without a page."""
    done = subprocess.run(
        [KINEGRAPH, "replay", "small.yaml", "s", "--verify", "-q"], cwd=folder, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr


def answer(process: PageProcess, path: str, **headers: str) -> tuple[int, dict[str, str], bytes]:
    """What the server answers to a request."""
    place = urlsplit(process.url)
    connection = http.client.HTTPConnection("127.0.0.1", place.port or 0, timeout=100)
    cookie = f"kinegraph-{place.port}={place.query.removeprefix('token=')}"
    connection.request("GET", path, headers={"Cookie": cookie, **headers})
    reported = connection.getresponse()
    return reported.status, {name.lower(): value for name, value in reported.getheaders()}, reported.read()


@needs_browser
def test_a_person_watches_marks_a_moment_changes_a_value_and_both_are_in_the_recording(
    small: PageProcess, browser: LiveBrowser, tmp_path: Path
) -> None:
    browser.open(small.url)
    browser.wait("document.querySelector('.signal')?.dataset.points > 200")
    assert browser.colours(".signal canvas") > 5
    assert HOSTILE in browser.value("document.getElementById('name').textContent")
    assert not browser.value("document.querySelector('#name img')")
    browser.wait("document.querySelector('.state').dataset.rows >= 4")
    browser.type("m")
    browser.wait("document.activeElement.getAttribute('aria-label') === 'annotation'")
    browser.type(HOSTILE[:20] + "\r")
    browser.type("7")
    browser.value(
        "(s => { s.value = '55'; s.dispatchEvent(new Event('change')); })(document.querySelector('input[type=range]'))"
    )
    browser.wait("document.querySelector('.events').dataset.events > 0")
    browser.wait("document.querySelector('.log').textContent.includes('annotated on the page')")
    browser.wait("document.querySelector('.log').textContent.includes('set on the page')")
    browser.value(
        "document.querySelector('select[aria-label=stream]').value = "
        "[...document.querySelectorAll('select[aria-label=stream] option')].find(o => o.textContent === 'annotations').value"
    )
    browser.wait(f"document.querySelector('.table table').textContent.includes({HOSTILE[:20]!r})")
    assert browser.complaints == []
    assert small.stop() == 0
    with Recording.open(tmp_path / "s") as recording:
        _, marks = recording.read("annotations")
        _, levels = recording.read("level")
    assert marks["text"].tolist() == [HOSTILE[:20], "7"]
    assert levels[:, 0].tolist() == [40, 55]
    verified(tmp_path)


@needs_browser
@pytest.mark.nightly
def test_a_server_that_is_killed_is_started_again_the_page_comes_back_and_the_graph_never_noticed(
    small: PageProcess, browser: LiveBrowser, tmp_path: Path
) -> None:
    browser.open(small.url)
    browser.wait("document.querySelector('.signal')?.dataset.points > 100")
    os.kill(small.server(), signal.SIGKILL)
    browser.wait("document.body.dataset.state.includes('not connected')")
    small.wait_for(re.compile("it is started again"))
    browser.wait("document.body.dataset.state === 'live'")
    browser.wait("document.querySelector('.signal').dataset.points > 100")
    assert [c for c in browser.complaints if "WebSocket" not in c and "ERR_CONN" not in c] == []
    browser.complaints.clear()
    assert small.stop() == 0
    verified(tmp_path)


@needs_browser
@pytest.mark.parametrize(
    ("size", "theme"), [((375, 4000), "light"), ((1920, 4000), "dark")], ids=["phone", "projector"]
)
def test_it_fits_and_can_be_read(running: PageProcess, browser: LiveBrowser, size: tuple[int, int], theme: str) -> None:
    browser.open(running.url, *size)
    browser.wait("document.querySelector('.signal')?.dataset.points > 20")
    browser.value(f"document.documentElement.dataset.theme = '{theme}'")
    assert browser.value("document.documentElement.scrollWidth <= innerWidth")
    assert browser.value(CONTRAST) >= 4.5
    assert browser.complaints == []


CONTRAST = """
(() => {
  const line = v => v <= .03928 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4;
  const light = c => { const [r, g, b] = c.match(/[\\d.]+/g).map(v => line(v / 255));
    return .2126 * r + .7152 * g + .0722 * b; };
  const back = e => { while (e && /rgba\\(0, 0, 0, 0\\)|transparent/.test(getComputedStyle(e).backgroundColor)) e = e.parentElement;
    return getComputedStyle(e ?? document.body).backgroundColor; };
  const said = e => [...e.childNodes].some(n => n.nodeType === 3 && n.textContent.trim()) || e.placeholder;
  const texts = [...document.querySelectorAll('body *')].filter(e => said(e) && e.getClientRects().length);
  const own = e => getComputedStyle(e)[e instanceof SVGElement ? 'fill' : 'color'];
  const ink = e => e.placeholder ? getComputedStyle(e, '::placeholder').color : own(e);
  const behind = e => e instanceof SVGElement ? getComputedStyle(document.body).backgroundColor : back(e);
  return Math.min(...texts.map(e => { const [a, b] = [light(ink(e)), light(behind(e))].sort((x, y) => y - x);
    return (a + .05) / (b + .05); }));
})()
"""
"""The least contrast of any text, as WCAG 2 defines it."""


@pytest.mark.parametrize("count", [5, 20])
@pytest.mark.nightly
def test_many_clients_and_one_that_stops_reading_change_nothing(small: PageProcess, tmp_path: Path, count: int) -> None:
    with ExitStack() as stack:
        frozen = stack.enter_context(small.client(max_queue=1))
        see(frozen)
        clients = [stack.enter_context(small.client()) for _ in range(count)]
        for client in clients:
            see(client)
        for client in clients:
            until(client, "signal")
        until(
            clients[0], "state"
        )  # how many still are there is the machine's: one that reads nothing for 20 s is sent away
    assert small.stop() == 0
    verified(tmp_path)


@pytest.mark.nightly
def test_a_server_that_stands_still_costs_views_and_never_samples(small: PageProcess, tmp_path: Path) -> None:
    with small.client() as client:
        see(client)
        until(client, "signal")
        os.kill(small.server(), signal.SIGSTOP)
        time.sleep(3)
        os.kill(small.server(), signal.SIGCONT)
        until(client, "state")
    assert small.stop() == 0
    verified(tmp_path)


def test_headers_forbid_what_a_page_does_not_need(running: PageProcess) -> None:
    for path in ("/", "/page.js", "/page.css"):
        status, headers, body = answer(running, path)
        assert status == 200
        assert "default-src 'none'" in headers["content-security-policy"]
        assert "unsafe" not in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff"
        assert len(body) < 1_000_000
    assert b"<script>" not in answer(running, "/")[2]


@pytest.mark.parametrize("path", ["/../pyproject.toml", "/built/page.js", "/%2e%2e/x", "//etc/passwd", "/page.js/"])
def test_a_client_cannot_name_files(running: PageProcess, path: str) -> None:
    assert answer(running, path)[0] == 404


def test_another_web_site_is_refused(running: PageProcess) -> None:
    assert answer(running, "/", Host="evil.example")[0] == 403
    with pytest.raises(InvalidStatus, match="403"), running.client(origin="https://evil.example"):
        pass


@pytest.mark.parametrize(
    "message",
    [
        "",
        "{}",
        '{"do": "see", "streams": {"99": 0}}',
        '{"do": "mark", "text": ""}',
        '{"do": "tell", "node": "board", "text": "1"}',
        "x" * 5000,
        b"\0\1",
    ],
)
def test_a_message_that_cannot_be_ends_its_connection_and_nothing_else(
    running: PageProcess, message: str | bytes
) -> None:
    with running.client() as hostile, running.client() as other:
        see(other)
        hostile.send(message)
        with pytest.raises(Exception, match=r"1008|1009"):
            for _ in range(1000):
                hostile.recv(timeout=100)
        until(other, "signal")


def test_a_value_out_of_bounds_is_refused_and_the_session_goes_on(small: PageProcess) -> None:
    with small.client() as client:
        hello = see(client)
        until(client, "state")
        client.send(json.dumps({"do": "tell", "node": "level", "text": "1e9"}))
        while "not understood" not in (line := until(client, "log")["lines"][-1]["text"]):
            pass
        assert "between 0 and 100" in line
        client.send(json.dumps({"do": "mark", "text": "after"}))
        until(client, "events", s=[stream["name"] for stream in hello["streams"]].index("annotations"))


def test_metrics_can_be_read_by_prometheus(small: PageProcess) -> None:
    with small.client() as client:
        see(client)
        until(client, "state")
        status, headers, body = answer(small, "/metrics")
    assert status == 200
    assert headers["content-type"].startswith("application/openmetrics-text")
    families = {family.name: family for family in text_string_to_metric_families(body.decode())}
    samples = {sample.labels["node"]: sample.value for sample in families["kinegraph_samples"].samples}
    assert samples.keys() >= {"board.emg", "calf"} and samples["board.emg"] > 0
    assert {sample.labels["session"] for sample in families["kinegraph_samples"].samples} == {"small"}
    assert families["kinegraph_samples"].type == "counter" and families["kinegraph_rate_hertz"].type == "gauge"
    assert families["kinegraph_page_clients"].samples[0].value == 1


def test_a_page_with_a_certificate_is_encrypted(tmp_path: Path) -> None:
    certificate, key = certificate_of(tmp_path)
    (tmp_path / "small.yaml").write_text(SMALL)
    given = ("--page-certificate", certificate, "--page-key", key)
    with page_process(tmp_path, "run", "small.yaml", "--view", "none", "--no-record", *given) as process:
        assert process.url.startswith("https://127.0.0.1:")
        trusted = ssl.create_default_context(cafile=certificate)
        with connect(process.at("socket").replace("https", "wss", 1), ssl=trusted) as client:
            until(client, "hello")
        with pytest.raises(ssl.SSLCertVerificationError), connect(process.at("socket").replace("https", "wss", 1)):
            pass


def certificate_of(folder: Path) -> tuple[Path, Path]:
    """A certificate of 127.0.0.1 for a day, and its key."""
    x509 = pytest.importorskip("cryptography.x509")
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    secret, now = ec.generate_private_key(ec.SECP256R1()), datetime.now(UTC)
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "127.0.0.1")])
    made = (
        x509.CertificateBuilder(
            name, name, secret.public_key(), x509.random_serial_number(), now, now + timedelta(days=1)
        )
        .add_extension(x509.SubjectAlternativeName([x509.IPAddress(ip_address("127.0.0.1"))]), critical=False)
        .sign(secret, hashes.SHA256())
    )
    plain = (serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    (folder / "c.pem").write_bytes(made.public_bytes(serialization.Encoding.PEM))
    (folder / "k.pem").write_bytes(secret.private_bytes(serialization.Encoding.PEM, *plain))
    return folder / "c.pem", folder / "k.pem"


CAMERA = """
record: [simplify.blocks]
page: {unrecorded_pictures: true}
nodes:
  camera: {use: devices.people.bedside.Bedside, width: 64, height: 48, fps: 1, bed_h: 0.1}
  simplify: {use: operators.bed.frames.simplify.Simplify, from: camera.depth}
"""


@pytest.mark.parametrize(("at", "seen"), [("127.0.0.1:0", True), ("0.0.0.0:0", False)])
def test_pictures_that_are_not_recorded_are_shown_to_nobody_outside(tmp_path: Path, at: str, seen: bool) -> None:
    (tmp_path / "camera.yaml").write_text(CAMERA)
    with page_process(tmp_path, "run", "camera.yaml", "--view", "none", "--no-record", at=at) as process:
        place = urlsplit(process.url)
        with connect(f"ws://127.0.0.1:{place.port}/socket?{place.query}", max_size=None) as client:
            hello = see(client)
            kinds = {stream["name"]: stream["kind"] for stream in hello["streams"]}
            assert ("camera.depth" in kinds) is seen
            if seen:
                until(client, "frame")
            else:
                assert [name for name, kind in kinds.items() if kind == "frame"] == ["simplify.blocks"], (
                    "it is recorded"
                )
                assert not [panel for panel in hello["panels"] if "camera.depth" in panel["of"]]
                with pytest.raises(ConnectionClosed, match="1008"):
                    client.send(json.dumps({"do": "see", "streams": {str(len(kinds)): 0}}))
                    while True:
                        client.recv(timeout=100)


@pytest.mark.parametrize("at", rest_nightly("0.0.0.0:0", "127.0.0.1:0"))
def test_the_address_has_a_token_and_a_cookie_takes_over(tmp_path: Path, at: str) -> None:
    (tmp_path / "small.yaml").write_text(SMALL)
    with page_process(tmp_path, "run", "small.yaml", "--view", "none", "--no-record", at=at) as process:
        place = urlsplit(process.url)
        assert place.query.startswith("token=") and place.hostname != "0.0.0.0"
        assert answer(process, "/", Cookie="")[0] == 403
        assert answer(process, "/metrics", Cookie="")[0] == 403
        status, headers, _ = answer(process, f"/?{place.query}", Cookie="")
        assert (status, headers["location"]) == (303, "./")
        cookie = headers["set-cookie"].partition(";")[0]
        assert "HttpOnly" in headers["set-cookie"] and "Secure" not in headers["set-cookie"]
        assert answer(process, "/", Cookie=cookie)[0] == 200
        assert answer(process, "/page.js", Cookie=cookie)[0] == 200
        with pytest.raises(InvalidStatus, match="403"), connect(f"ws://127.0.0.1:{place.port}/socket"):
            pass
        with connect(f"ws://127.0.0.1:{place.port}/socket", additional_headers={"Cookie": cookie}) as client:
            see(client)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A graph, and six seconds that were recorded with it, which tests only read."""
    folder = tmp_path_factory.mktemp("recorded")
    (folder / "small.yaml").write_text(SMALL)
    command = [KINEGRAPH, "run", "small.yaml", "--for", "6", "--view", "none", "-o", "s"]
    assert subprocess.run(command, cwd=folder, capture_output=True).returncode == 0
    return folder / "small.yaml", folder / "s"


def test_a_replay_is_shown_too_and_takes_no_marks(recorded: tuple[Path, Path], tmp_path: Path) -> None:
    with page_process(tmp_path, "replay", *recorded, "--verify", "-q", "--speed", "0.5") as process:
        with process.client() as client, process.client() as other:
            hello = see(client)
            assert (hello["mode"], hello["values"]) == ("replay", [])
            until(client, "signal")
            other.send(json.dumps({"do": "mark", "text": "x"}))
            with pytest.raises(ConnectionClosed, match="1008"):
                while True:
                    other.recv(timeout=100)
        assert process.process.wait(100) == 0


@needs_browser
def test_a_person_pauses_a_replay_steps_changes_its_speed_and_goes_back_and_it_is_still_what_it_was_live(
    browser: LiveBrowser, recorded: tuple[Path, Path], tmp_path: Path
) -> None:
    with page_process(tmp_path, "replay", *recorded, "--verify", "-q", "--speed", "0.5") as process:
        browser.open(process.url)
        browser.wait("document.body.dataset.replayed > 0.5")
        browser.type(" ")
        browser.wait("document.body.dataset.pace === '0'")
        held = browser.value("+document.body.dataset.replayed")
        browser.press("ArrowRight", 5)
        stepped = browser.wait(f"(t => t > {held} + .4 && t)(+document.body.dataset.replayed)")
        assert stepped < held + 1
        browser.value(
            "(s => { s.value = '4'; s.dispatchEvent(new Event('change')); })(document.querySelector('input[type=range]'))"
        )
        browser.wait("document.body.dataset.replayed > 3.5")
        browser.wait("document.querySelector('.signal')?.dataset.points > 100")
        browser.press("Home")
        browser.wait("document.body.dataset.replayed < 1")
        assert browser.value("document.body.dataset.pace") == "0"
        browser.value(
            "(s => { s.value = '10'; s.dispatchEvent(new Event('change')); })(document.querySelector('select[aria-label=speed]'))"
        )
        assert browser.complaints == []
        assert process.process.wait(100) == 0, process.output
    assert "calf: identical to the recording" in process.output
