"""The ward: what a bed reports becomes a line, silence is noticed by its reason, alarms arrive once, graphs are rolled out and back."""

from __future__ import annotations

import json
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import uvicorn

from kinegraph.devices.lab.sessions import LabSession
from kinegraph.devices.nats.local_server import LocalServer
from kinegraph.devices.nats.server import NatsServer, account_of
from kinegraph.devices.page.access import Access
from kinegraph.devices.ward.agent import Agent, installed
from kinegraph.devices.ward.alarms import AlarmBook, Deliveries, MqttAlarms, webhook
from kinegraph.devices.ward.app import app_of, view_graph
from kinegraph.devices.ward.beds import SILENT_S, Trouble, WardBed, attention
from kinegraph.devices.ward.centre import Centre
from kinegraph.devices.ward.site import WardSite
from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.graph.reading.load import load_text
from tests.lab.test_lab_looks import axe as axe
from tests.lab.test_lab_looks import serious
from tests.support.browser import needs_browser
from tests.support.command_line import KINEGRAPH, Command
from tests.support.live_browser import live_browser
from tests.support.mosquitto import Mosquitto, eventually, free_port, listening
from tests.support.nats_site import folders, samples, sending, server, session, vanish
from tests.support.page_session import needs_page

__all__ = ["folders", "server"]

T = 1_767_000_000 * NS


def stream(last_s: float = 0.0, samples: int = 1, **row: Any) -> dict[str, Any]:
    return {"last": T + round(last_s * NS), "until": T, "samples": samples, "lost": 0, "row": row}


def bed(name: str = "bed1", reported_s: float = 100.0, **streams: Any) -> WardBed:
    status = {"streams": streams, "now": T, "free_bytes": 50 << 30, "pulse": "depth" if "depth" in streams else ""}
    return WardBed(name, status, reported_s)


@pytest.mark.parametrize(
    ("streams", "line"),
    [
        ({"s": stream(state="sleep"), "p": stream(state="in"), "b": stream(rate=14.2)}, "asleep 14/min"),
        ({"s": stream(state="wake"), "p": stream(state="in"), "b": stream(rate=None)}, "awake in bed"),
        ({"s": stream(state="sleep"), "p": stream(-600, state="out")}, "out of bed for 10 min"),
        ({"p": stream(state="in")}, "in bed"),
        ({"x": stream(cause="fall")}, "fall"),
        ({"x": stream(samples=7)}, "7 samples"),
    ],
)
def test_a_beds_state_is_one_line(streams: dict[str, Any], line: str) -> None:
    assert bed(**streams).row(101.0)["state"] == line


def test_silence_is_noticed_by_its_reason_within_a_minute() -> None:
    late = 100.0 + SILENT_S + 1
    assert late < 160 and bed().silence(100.0 + SILENT_S - 1) is None
    one = bed()
    assert one.row(140.0)["state"] == "silent for 40 s: process or network gone"
    one.agent, one.agent_s = {"running": False, "failed": True, "order": {}}, late
    assert one.troubles(late)[0].kind == "process gone"
    one.agent["running"] = True
    assert one.troubles(late)[0].kind == "process hangs"
    one.agent_s = 100.0
    assert one.troubles(late)[0].kind == "network gone"
    one.status["ended"] = True
    one.agent = {}
    assert one.troubles(late)[0].level == "note"
    camera = bed(depth=stream(-38.0), s=stream(state="sleep"))
    (trouble,) = camera.troubles(102.0)
    assert (trouble.kind, trouble.text) == ("sensor gone", "no samples of depth for 40 s")
    assert bed(depth=stream(-1.0)).troubles(101.0) == []
    begins = bed(depth={**stream(), "last": 0})  # no frame yet: a trouble once the session is old enough
    assert begins.troubles(101.0) == []
    begins.status["age_s"] = 25.0
    assert begins.troubles(101.0)[0].kind == "sensor gone"


def test_beds_that_need_attention_come_first_and_the_others_as_people_count() -> None:
    beds = [bed(f"bed{n}", depth=stream()) for n in (10, 2, 1)]
    beds += [bed("bed7", view=stream(what="moved")), bed("bed9", reported_s=0.0)]
    assert [row["bed"] for row in attention([one.row(101.0) for one in beds])] == [
        "bed9",
        "bed7",
        "bed1",
        "bed2",
        "bed10",
    ]


def test_an_alarm_is_raised_once_as_long_as_it_lasts_and_passed_on_once(tmp_path: Path) -> None:
    book, got = AlarmBook(tmp_path / "a.sqlite"), []
    refuses = True

    def deliver(alarm: dict[str, Any]) -> bool:
        if refuses:
            return False
        got.append(alarm["id"])
        return True

    gone = Trouble("alarm", "process gone", "silent for 20 s")
    for second in range(5):
        book.update("bed1", [gone, Trouble("note", "waiting", "…")], second)
    deliveries = Deliveries(book, {"x": deliver})
    deliveries.turn()
    refuses = False
    deliveries.turn()
    deliveries.turn()
    (alarm,) = book.open()
    assert got == [alarm["id"]] and alarm["raised"] == 0
    book.update("bed1", [], 6)
    assert book.open()[0]["over"] == 6
    assert book.acknowledge(alarm["id"], "nurse", 7) and not book.acknowledge(alarm["id"], "nurse", 8)
    assert not book.acknowledge("absent", "nurse", 8) and book.open() == []
    book.close()
    again = AlarmBook(tmp_path / "a.sqlite")  # a ward that is started again passes nothing on a second time
    again.update("bed1", [gone], 9)
    Deliveries(again, {"x": deliver}).turn()
    assert len(got) == 2 and len(again.open()) == 1
    again.close()


def test_what_may_have_arrived_before_comes_again_under_its_id_and_as_a_further_attempt(tmp_path: Path) -> None:
    """The ward ends between the receiver's answer and the note of it: the one case in which an alarm is sent twice."""
    book, got = AlarmBook(tmp_path / "a.sqlite"), []

    class Ended(BaseException): ...

    def answers_then_the_ward_ends(alarm: dict[str, Any]) -> bool:
        got.append((alarm["id"], alarm["attempt"]))
        raise Ended

    book.update("bed1", [Trouble("alarm", "process gone", "gone")], 1.0)
    with pytest.raises(Ended):
        Deliveries(book, {"x": answers_then_the_ward_ends}).turn()
    book.close()
    again = AlarmBook(tmp_path / "a.sqlite")
    again.update(
        "bed1", [Trouble("alarm", "process gone", "still gone")], 2.0
    )  # as long as it lasts it is the same alarm
    for _ in range(2):
        Deliveries(again, {"x": lambda alarm: bool(got.append((alarm["id"], alarm["attempt"])) or True)}).turn()
    (alarm,) = again.open()
    assert got == [(alarm["id"], 1), (alarm["id"], 2)]
    again.close()


def test_an_alarm_is_attempted_only_where_there_is_a_connection(tmp_path: Path) -> None:
    """While a broker is away, nothing is sent to it, and the first that arrives is attempt 1."""
    book, got, connected = AlarmBook(tmp_path / "a.sqlite"), [], []
    book.update("bed1", [Trouble("alarm", "process gone", "gone")], 1.0)
    mqtt = {"mqtt": lambda alarm: bool(connected) and not got.append(alarm["attempt"])}
    deliveries = Deliveries(book, mqtt, reachable={"mqtt": lambda: bool(connected)})
    for _ in range(3):
        deliveries.turn()
    connected.append(True)
    deliveries.turn()
    assert got == [1] and not book.due("mqtt")
    book.close()


class Hook(BaseHTTPRequestHandler):
    """Refuses the first request."""

    got: ClassVar[list[tuple[str, Any]]] = []
    asked = 0

    def do_POST(self) -> None:
        body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        Hook.asked += 1
        self.send_response(503 if Hook.asked == 1 else 204)
        self.end_headers()
        if Hook.asked > 1:
            Hook.got.append((self.headers["Idempotency-Key"], body["text"]))

    def log_message(self, *_: object) -> None: ...


def test_alarms_arrive_once_by_webhook_and_by_mqtt_and_are_acknowledged_there(tmp_path: Path) -> None:
    from kinegraph.devices.mqtt.link import Broker

    book, mosquitto = AlarmBook(tmp_path / "a.sqlite"), Mosquitto(tmp_path).start()
    for kind in ("process gone", "disk"):
        book.update(f"bed {kind}", [Trouble("alarm", kind, kind)], 1.0)
    hook = HTTPServer(("127.0.0.1", 0), Hook)
    threading.Thread(target=hook.serve_forever, daemon=True).start()
    mqtt = MqttAlarms(Broker("127.0.0.1", mosquitto.port), lambda id: book.acknowledge(id, "mqtt", 2.0))
    with listening(mosquitto.port) as client:
        deliveries = Deliveries(book, {"hook": webhook(f"http://127.0.0.1:{hook.server_port}/"), "mqtt": mqtt.deliver})

        def arrived() -> bool:
            deliveries.turn()
            return not book.due("hook") and not book.due("mqtt")

        eventually(arrived)
        deliveries.turn()
        eventually(lambda: len([m for m in client.messages if "/alarm/" in m[0]]) == 2)
        ids = [json.loads(text)["id"] for topic, text, _ in client.messages if "/alarm/" in topic]
        client.client.publish("kinegraph/ward/acknowledge", ids[0], qos=1)
        eventually(lambda: len(book.open()) == 1)
    assert sorted(key for key, _ in Hook.got) == sorted(ids)
    mqtt.stop()
    mosquitto.stop()
    hook.shutdown()
    hook.server_close()
    book.close()


@pytest.fixture
def centre(server: LocalServer, tmp_path: Path) -> Iterator[Centre]:
    made = connected(server, tmp_path)
    yield made
    made.stop()


def connected(server: LocalServer, tmp_path: Path, *, long_ago: bool = True) -> Centre:
    """A ward's centre that has been connected for a while, or only just."""
    made = Centre(tmp_path / "ward", NatsServer(server.url))
    assert made.link.wait(100)
    made.turn()
    made.listening_s -= 3600 if long_ago else 0
    return made


def test_a_ward_that_starts_again_neither_forgets_an_alarm_nor_raises_it_twice(
    server: LocalServer, tmp_path: Path
) -> None:
    """Who was there before and is silent is an alarm; a bed is given the time of a report first; the alarm of before is still the same."""
    gone, well, now = "gone", "well", time.monotonic()
    first = connected(server, tmp_path)
    first.beds = {gone: bed(gone, now - 60, x=stream()), well: bed(well, now, x=stream())}
    first.turn()
    (before,) = first.book.open()
    assert before["bed"] == gone
    first.stop()
    second = connected(server, tmp_path, long_ago=False)
    second.turn()
    assert [row["state"] for row in second.state()["beds"]] == ["the ward waits for its report"] * 2
    assert second.book.open() == [before]
    second.beds[well].status_s = time.monotonic() + 1  # it reports; the other one does not
    second.listening_s -= SILENT_S + 1
    second.turn()
    (after,) = second.book.open()
    assert (after["id"], after["over"]) == (before["id"], None)
    second.beds[well].status_s -= 60  # one that went while the ward was away
    second.turn()
    assert {one["bed"] for one in second.book.open()} == {gone, well}
    second.stop()


def test_a_ward_that_was_cut_off_does_not_raise_an_alarm_for_every_bed(server: LocalServer, centre: Centre) -> None:
    centre.beds["bed1"] = bed("bed1", time.monotonic() - 300, x=stream())
    centre._connection -= 1  # as after a new connection
    centre.turn()
    assert centre.book.open() == [] and centre.state()["beds"][0]["level"] == "note"


EVENT = StreamSpec((), np.dtype([("state", "U8")]))


def test_a_bed_shows_itself_at_the_centre_with_its_clock_and_its_night(
    server: LocalServer, centre: Centre, tmp_path: Path
) -> None:
    from kinegraph.devices.reports.night import archive

    night = tmp_path / "nights" / "2026-11-27"
    night.mkdir(parents=True)
    facts = archive.Facts(
        "2026-11-27",
        T,
        30.0,
        closed=True,
        session={"subject": "Ada Lovelace"},
        numbers={"tst": 421.0, "se": 91.0, "end": T},
    )
    (night / archive.FACTS).write_text(json.dumps({**archive.asdict(facts), "version": archive.VERSION}))
    (night / archive.EPOCHS).write_text(",".join(archive.COLUMNS) + "\n")
    with sending(
        "shown",
        server,
        specs={"x": EVENT},
        nights=str(night.parent),
        identifiers={"subject": "S07"},
        clock_ahead_ns=-2 * NS,
    ) as outlet:
        outlet.process("x", Chunk(samples(0, 1).time, np.array([("sleep",)], EVENT.dtype), samples(0, 1).until))

        def known() -> bool:
            centre.turn()
            one = centre.beds.get("shown")
            return bool(
                one
                and one.status
                and one.row(0.0)["streams"]["x"]["samples"]
                and one.offset_s is not None
                and one.night
            )

        eventually(known)
        row = centre.state()["beds"][0]
        assert (
            row["state"] == "asleep" and row["night"].startswith("7") and row["offset_s"] == pytest.approx(2.0, abs=0.5)
        )
        kept = (centre.home / "nights" / "shown" / "2026-11-27" / archive.FACTS).read_text()
        assert "S07" in kept and "Ada" not in kept
        graph = json.loads(view_graph(centre, "shown"))
        assert graph["nodes"]["x"]["stream"] == "x"
        vanish(outlet)
    centre.beds["shown"].status_s -= 30
    centre.turn()
    assert [one["kind"] for one in centre.state()["alarms"]] == ["silent"]


ARRANGED = """
page:
  panels:
  - {{kind: signal, of: [envelope, person.emg], title: muscle, wide: 3}}
  - {{kind: answer, show: [{{of: person.touchdown, count: true, label: steps}}, {{of: person.emg, field: TA}}]}}
  - {{kind: signal, of: person.emg, title: not sent}}
  - {{kind: state}}
nodes:
  person: {{use: devices.people.treadmill.Treadmill, realtime: false, duration_s: 5, muscles: [TA]}}
  envelope: {{use: operators.emg.Envelope, from: person.emg}}
  centre:
    use: devices.nats.StreamOutlet
    bed: arranged
    server: {{url: "{url}"}}
    from: {{steps: person.touchdown, muscle.envelope: envelope}}
"""


def test_a_beds_page_at_the_centre_has_the_beds_own_panels_of_what_it_sends(
    server: LocalServer, centre: Centre
) -> None:
    assert session(ARRANGED.format(url=server.url)).run().error is None
    made = load_text(view_graph(centre, "arranged"))
    signal, answer = made.page.panels
    assert signal == {"kind": "signal", "of": ["muscle_envelope"], "title": "muscle", "wide": 3}
    assert answer["show"] == [{"of": "steps", "count": True, "label": "steps"}]


@contextmanager
def served(centre: Centre, token: str = "secret") -> Iterator[str]:
    """The ward's server, without a process of its own."""
    place = socket.socket()
    place.bind(("127.0.0.1", 0))
    place.listen()
    port = place.getsockname()[1]
    app = app_of(centre, Access(token, port))
    made = uvicorn.Server(uvicorn.Config(app, log_config=None, lifespan="off", ws="websockets-sansio"))
    thread = threading.Thread(target=made.run, args=([place],), daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{port}"
    finally:
        made.should_exit = True
        thread.join(20)
        place.close()


def ask(url: str, body: object = None, token: str = "secret") -> tuple[int, Any]:
    headers = {"Cookie": f"kinegraph-{url.split(':')[2].split('/')[0]}={token}", "Content-Type": "application/json"}
    data = None if body is None else json.dumps(body).encode()
    try:
        with urllib.request.urlopen(urllib.request.Request(url, data, headers), timeout=100) as answer:
            return answer.status, json.loads(answer.read())
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read().decode()


def test_only_who_has_the_token_sees_the_ward_and_acknowledges(centre: Centre) -> None:
    centre.beds["bed1"] = bed("bed1", reported_s=time.monotonic() - 60)
    centre.turn()
    with served(centre) as url:
        assert ask(f"{url}/api/ward", token="other")[0] == 403
        found = ask(f"{url}/api/ward")[1]
        assert found["beds"][0]["level"] == "alarm"
        (alarm,) = found["alarms"]
        assert ask(f"{url}/api/alarms/{alarm['id']}/acknowledge", {"by": "nurse"}) == (200, {"acknowledged": True})
        assert ask(f"{url}/api/ward")[1]["alarms"] == []
        assert ask(f"{url}/api/orders", {"beds": ["absent"], "graph": "x"})[0] == 400
        assert ask(f"{url}/api/beds/absent/open", {})[0] == 400


def many(n: int) -> dict[str, WardBed]:
    """Beds in every state that a ward may show."""
    now, beds = time.monotonic(), {}
    for k in range(1, n + 1):
        streams = {
            "s": stream(state="sleep" if k % 3 else "wake"),
            "p": stream(state="in"),
            "b": stream(rate=12.0 + k % 6),
        }
        if k % 9 == 0:
            streams = {"p": stream(-60.0 * k, state="out")}
        one = bed(f"bed{k}", reported_s=now - (1 if k % 20 else 45), **streams)
        one.status |= {
            "version": "0.1.0",
            "graph": "bedside_sleep",
            "digest": "5f0c9a12" if k % 7 else "aa31c0de",
            "recording": "session",
        }
        one.status |= {"free_bytes": (10 + k) << 30} if k != 31 else {"free_bytes": 1 << 30}
        one.offset_s, one.uncertainty_s, one.night = (
            0.0013 * (k % 5),
            0.0004,
            f"{6 + k % 3}:{k % 60:02d} asleep, {80 + k % 15} %",
        )
        beds[one.name] = one
    beds["bed14"].status["streams"]["view"] = stream(what="moved")
    return beds


@needs_page
@needs_browser
def test_60_beds_are_legible_in_a_browser_those_that_need_attention_first(centre: Centre, tmp_path: Path) -> None:
    centre.beds = many(60)
    centre.turn()
    with served(centre) as url, live_browser(tmp_path / "browser") as browser:
        browser.open(f"{url}/?token=secret", 1600, 1900)
        browser.wait("document.querySelectorAll('table.beds tbody tr').length === 60")
        first = browser.value(
            "[...document.querySelectorAll('table.beds tbody th a')].slice(0, 6).map(a => a.textContent).join()"
        )
        assert first == "bed20,bed40,bed60,bed14,bed31,bed1"
        assert browser.value("document.documentElement.scrollWidth <= innerWidth")
        smallest = browser.value(
            "Math.min(...[...document.querySelectorAll('table.beds td, table.beds th')].map(e => parseFloat(getComputedStyle(e).fontSize)))"
        )
        assert smallest >= 12
        browser.picture(tmp_path / "ward-60-beds.png")
        click = "[...document.querySelectorAll('{}')].find(e => e.textContent.includes('{}')).click()"
        browser.value(
            click.format(".wardtop button", "8 × aa31c0")
        )  # a mixed fleet is visible: the few with another graph
        browser.wait("document.querySelectorAll('table.beds tbody tr').length === 8")
        browser.value(click.format(".wardtop button", "roll out"))
        browser.wait("!!document.querySelector('table.beds input')")
        browser.value(click.format(".wardtop button", "all 8 shown"))
        browser.wait("document.querySelector('.wardtop + .wardtop strong').textContent === '8 chosen'")
        browser.value(click.format(".wardtop + .wardtop button", "roll back"))
        eventually(lambda: sum(one.order.get("state") == "sent" for one in centre.beds.values()) == 8)
        browser.value(click.format(".wardtop + .wardtop button", "done"))
        browser.value(
            "[...document.querySelectorAll('.alarms button')].find(b => b.textContent === 'acknowledge all').click()"
        )
        browser.wait("!document.querySelector('.alarms')")
        assert not browser.complaints


@needs_page
@needs_browser
@pytest.mark.nightly
def test_the_ward_is_accessible_light_and_dark_and_fits_a_phone(centre: Centre, axe: str, tmp_path: Path) -> None:
    centre.beds = many(20)
    centre.turn()
    with served(centre) as url, live_browser(tmp_path / "browser") as browser:
        browser.ask("Page.setBypassCSP", enabled=True)  # of what the test itself puts in
        browser.open(f"{url}/?token=secret", 1280, 800)
        browser.wait(
            "document.querySelectorAll('table.beds tbody tr').length === 20 && !!document.querySelector('.alarms')"
        )
        assert serious(browser, axe) == []
        themes = "document.documentElement.dataset.theme"
        before = browser.value(themes)
        browser.value("document.querySelector('.top .theme').click()")
        assert {before, browser.value(themes)} == {"light", "dark"}
        browser.picture(tmp_path / "ward-theme.png")
        browser.size(390, 844)
        browser.wait("innerWidth === 390")
        assert browser.value("document.documentElement.scrollWidth <= innerWidth"), "nothing sticks out of a phone"
        browser.picture(tmp_path / "ward-phone.png")


STUB = """
import sys, time
command, text = sys.argv[1], open(next(a for a in sys.argv if a.endswith(".yaml"))).read()
if command == "check":
    sys.exit("node 'x': no such operator" if "wrong" in text else 0)
if "breaks" in text:
    sys.exit(4)
time.sleep(600)
"""


def test_a_graph_is_rolled_out_watched_and_rolled_back(server: LocalServer, centre: Centre, tmp_path: Path) -> None:
    stub, first = tmp_path / "stub.py", tmp_path / "first.yaml"
    stub.write_text(STUB)
    first.write_text("first")
    agent = Agent("rolled", tmp_path / "home", NatsServer(server.url), command=(sys.executable, str(stub)), watch_s=0.3)
    agent.use(first)
    thread = threading.Thread(target=agent.serve)
    thread.start()
    try:
        eventually(lambda: agent.running and "rolled" in centre.beds)
        for graph, state in (("second", "done"), ("wrong", "refused"), ("breaks", "rolled back")):
            id = centre.roll_out(["rolled"], {"graph": graph})
            eventually(
                lambda id=id, state=state: (
                    centre.beds["rolled"].order == {**centre.beds["rolled"].order, "id": id, "state": state}
                )
            )
        assert (tmp_path / "home" / agent.kept["graph"]).read_text() == "second"
        eventually(lambda: agent.running)
        order = centre.beds["rolled"].order
        assert "ended within" in order["text"] and centre.beds["rolled"].row(0.0)["order"] == order
        id = centre.roll_out(["rolled"], {"version": "9.9"})
        eventually(
            lambda: (
                centre.beds["rolled"].order == {"id": id, "state": "refused", "text": "this bed installs no versions"}
            )
        )
        with pytest.raises(KinegraphError, match="there is no bed absent"):
            centre.roll_out(["absent"], {"back": True})
    finally:
        agent.stop()
        thread.join(30)
    assert not agent.running


INSTALL = "import pathlib, sys; pathlib.Path('version.txt').write_text(sys.argv[1])"
OF_A_VERSION = """
import pathlib, sys, time
if pathlib.Path(__file__).with_name("version.txt").read_text() == "9.9":
    sys.exit(4)
time.sleep(600)
"""


def test_a_version_that_does_not_run_is_rolled_back_under_the_same_graph(
    server: LocalServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    stub, graph, version = tmp_path / "stub.py", tmp_path / "first.yaml", tmp_path / "version.txt"
    stub.write_text(OF_A_VERSION)
    graph.write_text("first")
    version.write_text("before")
    account, run = NatsServer(server.url), (sys.executable, str(stub))
    agent = Agent(
        "versions", tmp_path / "home", account, command=run, install=(sys.executable, "-c", INSTALL), watch_s=0.3
    )
    agent.use(graph)
    running = agent.kept["graph"]
    try:
        agent.turn()

        def became(state: str) -> bool:
            agent.turn()
            return bool(agent.kept["order"]["state"] == state)

        for order, state, there in (
            ({"version": "9.9"}, "rolled back", installed()),
            ({"version": "9.8"}, "done", "9.8"),
            ({"back": True}, "rolled back", installed()),
        ):
            agent._orders.append({"id": f"{order}", **order})
            eventually(lambda state=state: became(state))
            assert version.read_text() == there and agent.kept["graph"] == running and agent.running
    finally:
        agent.stop()
        agent.serve()


def test_an_agent_reports_also_where_a_failed_installation_left_no_version(monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(package: str) -> str:
        raise PackageNotFoundError(package)

    monkeypatch.setattr("kinegraph.devices.ward.agent.installed_version", gone)
    assert installed() == ""


def test_a_sites_accounts_open_its_server_and_others_do_not(
    kinegraph: Command, server: LocalServer, tmp_path: Path
) -> None:
    pytest.importorskip("cryptography")
    port = free_port()
    code, out, err = kinegraph("ward", "add", "bed1", "bed2", "--host", "127.0.0.2", "--port", port, "--home", "site")
    # 127.0.0.2 counts as this machine: no certificate; a name of the network has one
    assert code == 0 and "site/beds/bed1: copy this folder to bed1" in out, err
    assert kinegraph("ward", "add", "bad.name", "--home", "site")[0] == 2
    first = tmp_path / "site/beds/bed1/server.yaml"
    assert f"nats://127.0.0.2:{port}" in first.read_text()
    for option, value, url in (
        ("--host", "ward.example", f"tls://ward.example:{port}"),
        ("--port", 4299, "tls://ward.example:4299"),
    ):
        code, _, err = kinegraph("ward", "add", "bed2", option, value, "--home", "site")
        assert code == 0 and "copy the folders below site/beds to them again" in err
        assert (
            url in first.read_text()
            and (first.parent / "ca.pem").read_bytes() == (first.parents[2] / "certificate.pem").read_bytes()
        )
    site = WardSite(tmp_path / "other", "ward.example", port)
    site.add("bed1")
    assert site.encrypted and site.beds == ("bed1",)
    bed, account = account_of(tmp_path / "other" / "beds" / "bed1" / "server.yaml")
    assert (bed, account.user, account.url) == ("bed1", "bed1", f"tls://ward.example:{port}")
    local = site.local_server().start()
    try:
        from kinegraph.devices.nats.link import Link

        for one, opens in (
            (NatsServer(f"tls://127.0.0.1:{port}", "bed1", account.password_file, ca_file=account.ca_file), True),
            (site.server, True),
        ):
            link = Link(one, "test")
            assert link.wait(100) is opens, link.error
            link.close()
    finally:
        local.stop()


def test_the_wards_words_for_what_is_missing(kinegraph: Command) -> None:
    assert "name the beds to add" in kinegraph("ward", "add")[2]
    assert "needs a graph and its account" in kinegraph("ward", "agent", "x.yaml")[2]
    assert "holds no nights yet" in kinegraph("ward", "nights")[2]
    assert "cannot be read as an account" in kinegraph("ward", "agent", "x.yaml", "--server", "absent.yaml")[2]


RUNNING = """
nodes:
  person: {use: devices.people.treadmill.Treadmill, muscles: [TA], duration_s: 120}
  envelope: {use: operators.emg.Envelope, from: person.emg}
  centre: {use: devices.nats.StreamOutlet, account: ward/beds/bed1/server.yaml, from: {envelope: envelope, touchdown: person.touchdown}}
"""


@pytest.mark.nightly
@needs_page
@needs_browser
def test_a_bed_opens_its_own_page_in_the_ward(kinegraph: Command, server: LocalServer, tmp_path: Path) -> None:
    """The commands as people type them: add, serve, run, and a click on the bed."""
    port = free_port()
    assert kinegraph("ward", "add", "bed1", "bed2", "--port", port)[0] == 0
    (tmp_path / "bed.yaml").write_text(RUNNING)
    log = (tmp_path / "ward.txt").open("w+")
    ward = subprocess.Popen([KINEGRAPH, "ward", "--no-browser", "--at", ":0"], stderr=log, stdout=log)
    bed = subprocess.Popen([KINEGRAPH, "run", "bed.yaml", "--no-record", "--view", "none"], stderr=log, stdout=log)
    try:
        eventually(lambda: "ward: " in Path(log.name).read_text())
        (url,) = re.findall(r"ward: (http\S+)", Path(log.name).read_text())
        with live_browser(tmp_path / "browser", allowed="WebSocket|status of 40") as browser:
            browser.open(url, 1400, 900)
            browser.wait("!!document.querySelector('table.beds tr.well')")
            browser.value("[...document.querySelectorAll('table.beds a')].find(a => a.textContent === 'bed1').click()")
            browser.wait("!!document.querySelector('iframe.page')")
            browser.wait(
                "/envelope/.test(document.querySelector('iframe.page')?.contentDocument?.body?.innerText ?? '')"
            )
            browser.picture(tmp_path / "ward-bed.png")
    finally:
        for process in (bed, ward):
            process.send_signal(signal.SIGINT)
            process.wait(60)
        log.close()
    view = LabSession(tmp_path / "ward" / "sessions" / "bed-bed1")
    eventually(lambda: not view.runs)  # the bed's page ends with the ward
