"""The page's parts without a browser: messages, thinning, the bounded channel, who has access, what is offered, panels in YAML, metrics."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path
from typing import Any, get_args
from urllib.parse import urlsplit

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from prometheus_client.openmetrics.parser import text_string_to_metric_families

from kinegraph.devices.page.access import Access
from kinegraph.devices.page.address import Address, parsed
from kinegraph.devices.page.hub import Hub, Looking
from kinegraph.devices.page.metrics import openmetrics
from kinegraph.devices.page.transfer import messages
from kinegraph.devices.page.transfer.catalogue import default_panels, described, hello, kind_of, offered
from kinegraph.devices.page.transfer.channel import PageChannel, Portion
from kinegraph.devices.page.transfer.downsample import thinned
from kinegraph.devices.page.transfer.history import History
from kinegraph.devices.page.transfer.wire import Asked, asked, decode, encode
from kinegraph.stream.chunk import NS, Chunk, StreamSpec, grid
from kinegraph.stream.domain.humanoid import usual_body
from kinegraph.stream.domain.mesh import Topology
from kinegraph.stream.domain.skeleton import joints_of
from kinegraph.stream.errors import GraphError, KinegraphError
from kinegraph.stream.graph.reading.load import load, load_text

RATE_HZ = 1000.0
SIGNAL = StreamSpec((2,), rate_hz=RATE_HZ, channels=("a", "b"), units=("uV",))
BOARD = "nodes:\n  board: {use: devices.people.treadmill.Treadmill}\n"


def test_a_message_comes_back_as_it_was_sent_and_its_numbers_are_aligned() -> None:
    numbers = np.arange(5.0)
    message = encode({"t": "signal", "name": "µ"}, numbers.tobytes())
    header, rest = decode(message)
    assert header == {"t": "signal", "name": "µ"}
    assert (len(message) - len(rest)) % 8 == 0
    assert np.frombuffer(rest).tolist() == numbers.tolist()


@pytest.mark.parametrize("damaged", [b"", b"\1", b"\xff\xff\xff\xff{}", b"\2\0\0\0[]", b"\4\0\0\0{{{{"])
def test_what_is_no_message_is_refused(damaged: bytes) -> None:
    with pytest.raises(ValueError):
        decode(damaged)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        '{"do": "open", "path": "/etc/passwd"}',
        '{"do": "mark"}',
        '{"do": "mark", "text": ""}',
        '{"do": "mark", "text": 1}',
        '{"do": "mark", "text": "%s"}' % ("x" * 65),
        '{"do": "mark", "text": "a", "at": 1e300}',
        '{"do": "see", "streams": {"a": 1}}',
        '{"do": "see", "streams": {"0": -1}}',
        '{"do": "tell", "node": "a", "text": "1", "more": 1}',
        '{"do": "pace", "speed": -1}',
        '{"do": "look", "streams": [], "begin": 2, "end": 1, "at": 1, "points": 100}',
        '{"do": "look", "streams": [], "begin": 0, "end": 1, "at": 1, "points": 100000000}',
    ],
)
def test_what_a_client_may_not_ask_is_refused(text: str) -> None:
    with pytest.raises(ValueError):
        asked(text)


def pieces(n: int, cuts: list[int]) -> list[slice]:
    places = sorted({0, n, *(c % (n + 1) for c in cuts)})
    return [slice(a, b) for a, b in pairwise(places)]


@given(cuts=st.lists(st.integers(0, 500), max_size=12), width=st.sampled_from([0, 4_000_000, 16_777_216]))
def test_a_curve_does_not_depend_on_how_samples_were_cut(cuts: list[int], width: int) -> None:
    n = 500
    time, data = grid(RATE_HZ, n), np.random.default_rng(1).normal(size=(n, 2))
    whole = History(SIGNAL)
    whole.add(Chunk(time, data, int(time[-1])))
    expected, _ = whole.curve(0, width)
    history, number, got = History(SIGNAL), 0, []
    for part in pieces(n, cuts):
        history.add(Chunk(time[part], data[part], int(time[part.stop - 1])))
        curve, number = history.curve(number, width)
        got.append(curve)
    assert np.concatenate([c.time for c in got]).tolist() == expected.time.tolist()
    for side in ("low", "high") if width else ("low",):
        assert np.concatenate([getattr(c, side) for c in got]).tolist() == getattr(expected, side).tolist()


def test_a_bucket_holds_the_least_and_the_greatest_value_and_skips_what_is_no_number() -> None:
    data = np.array([[1.0], [5.0], [np.nan], [-2.0], [np.nan], [np.nan], [np.inf], [np.nan]])
    curve = thinned(np.arange(8), data, np.zeros(8, bool), 4)
    assert curve.high is not None
    assert curve.time.tolist() == [0, 4]
    assert (curve.low[0, 0], curve.high[0, 0]) == (-2.0, 5.0)
    assert np.isnan(curve.low[1, 0])


@pytest.mark.parametrize("width", [0, 4_000_000])
@pytest.mark.parametrize("kind", ["lost", "hole"])
def test_a_gap_is_a_gap_in_the_line(width: int, kind: str) -> None:
    history, time = History(SIGNAL), grid(RATE_HZ, 200)
    later = time[100:] + (NS if kind == "hole" else 0)
    history.add(Chunk(time[:100], np.ones((100, 2)), 0))
    history.add(Chunk(later, np.ones((100, 2)), 0, 7 if kind == "lost" else 0))
    curve, _ = history.curve(0, width)
    assert np.isnan(curve.low[:, 0]).sum() == 1
    assert curve.time[np.isnan(curve.low[:, 0])][0] <= later[0]


def test_an_irregular_stream_has_no_holes() -> None:
    history = History(StreamSpec((1,)))
    history.add(Chunk(np.array([1, 10**12]), np.ones((2, 1)), 0))
    assert not np.isnan(history.curve(0, 0)[0].low).any()


def test_a_history_is_bounded_and_keeps_the_newest() -> None:
    history = History(SIGNAL, max_bytes=25 * 1000)
    for k in range(40):
        history.add(Chunk(grid(RATE_HZ, 333, start_ns=k * 333_000_000), np.full((333, 2), float(k)), 0))
    assert history.end == 40 * 333
    assert len(history.time) == history.limit == 1000
    assert history.data[-1, 0] == 39
    assert len(history._time) <= 4096
    history.add(Chunk(grid(RATE_HZ, 5000), np.ones((5000, 2)), 0))
    assert (len(history.time), history.end) == (1000, 40 * 333 + 5000)


def lengths(channel: PageChannel) -> list[tuple[int, int]]:
    """Samples of each part that is taken, and what was lost before it."""
    return [(sum(len(c.time) for c in part.chunks), part.lost) for part in channel.take() if isinstance(part, Portion)]


def test_the_channel_drops_views_where_nobody_takes_them_and_the_stream_says_so() -> None:
    channel = PageChannel([False, True], max_bytes=10 * 160)
    channel.wanted[:] = [True, True]
    signal, picture = channel.observer(0), channel.observer(1)
    for k in range(25):
        signal(Chunk(grid(RATE_HZ, 10), np.full((10, 2), float(k)), k))
        picture(Chunk(np.array([k]), np.full((1, 4, 4), k), k))
    (part,), (newest,) = channel.take(), channel.pictures()
    assert isinstance(part, Portion)
    assert channel.dropped == 15
    assert part.lost == -1
    assert [chunk.data[0, 0] for chunk in part.chunks] == [*range(15, 25)]
    assert newest.chunks[0].data[0, 0, 0] == 24
    assert channel.take() == channel.pictures() == []


def test_the_channel_keeps_a_gap_between_two_chunks_and_takes_nothing_that_nobody_looks_at() -> None:
    channel = PageChannel([False])
    put = channel.observer(0)
    put(Chunk(grid(RATE_HZ, 3), np.ones((3, 2)), 0))
    assert channel.take() == []
    channel.wanted[0] = True
    for lost in (0, 0, 5, 0):
        put(Chunk(grid(RATE_HZ, 3), np.ones((3, 2)), 0, lost))
    assert lengths(channel) == [(6, 0), (6, 5)]


@pytest.mark.parametrize(
    ("host", "here", "ours"),
    [
        ("127.0.0.1:7790", True, True),
        ("localhost:7790", True, True),
        ("[::1]:7790", True, True),
        ("localhost:80", True, False),
        ("evil.example:7790", True, False),
        ("127.0.0.1.evil.example:7790", True, False),
        ("lab.example:7790", False, True),
    ],
)
def test_a_name_that_merely_leads_here_is_refused_on_loopback(host: str, here: bool, ours: bool) -> None:
    assert Access("x", 7790, here=here).host_is_ours(host) is ours


@pytest.mark.parametrize(
    ("origin", "ours"),
    [
        (None, True),
        ("http://localhost:7790", True),
        ("http://localhost", False),
        ("https://evil.example", False),
        ("null", False),
        ("", False),
    ],
)
def test_another_web_sites_page_is_refused(origin: str | None, ours: bool) -> None:
    assert Access("", 7790).origin_is_ours(origin, "localhost:7790") is ours


@pytest.mark.parametrize(
    ("path", "cookie", "known"),
    [
        ("/?token=s3cret", "", True),
        ("/", "kinegraph-7790=s3cret", True),
        ("/", "", False),
        ("/?token=", "", False),
        ("/?token=S3cret", "", False),
        ("/", "kinegraph-7790=", False),
        ("/?token=%ff", "", False),
        ("/", "a=b; kinegraph-7790=s3cret", True),
        ("/?token=sécret", "\0;;=", False),
        ("/", "kinegraph-7791=s3cret", False),
    ],
)
def test_the_token_is_asked_for(path: str, cookie: str, known: bool) -> None:
    assert Access("s3cret", 7790).knows_token(path, cookie) is known


@pytest.mark.parametrize(
    ("address", "host", "port", "outside"),
    [
        ("", "127.0.0.1", 7790, False),
        (":8000", "127.0.0.1", 8000, False),
        ("localhost", "localhost", 7790, False),
        ("0.0.0.0:0", "0.0.0.0", 0, True),
        ("[::1]:80", "::1", 80, False),
        ("[::]", "::", 7790, True),
        ("lab.example:1", "lab.example", 1, True),
    ],
)
def test_every_address_gets_a_token_unless_it_is_of_this_machine_and_asks_for_none(
    address: str, host: str, port: int, outside: bool
) -> None:
    found = parsed(address)
    assert (found.host, found.port, bool(found.token)) == (host, port, True)
    if outside:
        with pytest.raises(KinegraphError, match="--no-token"):
            parsed(address, no_token=True)
    else:
        assert parsed(address, no_token=True).token == ""


@pytest.mark.parametrize("everywhere", ["0.0.0.0", "::"])
def test_the_printed_address_is_one_that_a_browser_can_open(everywhere: str) -> None:
    host = urlsplit(Address(everywhere).url(7790)).hostname
    assert host and host not in ("0.0.0.0", "::")


def test_an_encrypted_pages_cookie_is_never_sent_in_the_clear() -> None:
    assert "Secure" in Access("s3cret", 7790, True).cookie and "Secure" not in Access("s3cret", 7790).cookie


@pytest.mark.parametrize("address", [":x", "a:-1", "a:70000", "a:"])
def test_an_address_that_is_none(address: str) -> None:
    with pytest.raises(KinegraphError, match="HOST:PORT"):
        parsed(address)


@pytest.mark.parametrize(
    ("spec", "kind"),
    [
        (SIGNAL, "signal"),
        (StreamSpec((3, 4), np.dtype("<u2")), "frame"),
        (StreamSpec((5, 3), channels=tuple("abcde"), units=("m",)), "points"),
        (StreamSpec((100, 2), channels=("a", "b"), channel_axis=1), "curves"),
        (StreamSpec((), np.dtype([("onset", "<i8")])), "events"),
        (StreamSpec((15, 20)), "frame"),
        (StreamSpec((2, 3, 4)), None),
        (usual_body().spec(30.0), "pose"),
        (Topology(3, np.array([[0, 1, 2]])).spec(30.0), "mesh"),
        (StreamSpec((1,), np.dtype("c16")), None),
    ],
)
def test_the_kind_of_a_stream(spec: StreamSpec, kind: str | None) -> None:
    assert kind_of(spec) == kind


@pytest.mark.parametrize("dtype", ["<u2", "<f8"])
def test_pictures_that_may_not_be_recorded_are_not_offered(dtype: str) -> None:
    picture = StreamSpec((3, 4), np.dtype(dtype), 30.0, units=("mm",))
    graph = load_text(BOARD)
    graph.nodes["board"].specs = {"out": picture}
    assert "board" not in offered(graph, outside=False)
    object.__setattr__(graph.page, "unrecorded_pictures", True)
    assert "board" in offered(graph, outside=False)
    assert "board" not in offered(graph, outside=True)


def test_what_lies_within_a_row_of_filters_is_not_offered_unless_it_is_asked_for() -> None:
    row = "  a: {use: operators.Rectify, from: board.emg}\n  b: {use: operators.Lowpass, from: a, cutoff_hz: 6}\n"
    assert not {"a"} & offered(load_text(BOARD + row), outside=False).keys()
    assert {"b"} & offered(load_text(BOARD + row), outside=False).keys()
    for more in ("record: [a]\n", "page: {panels: [{kind: signal, of: a}]}\n"):
        assert {"a"} & offered(load_text(more + BOARD + row), outside=False).keys()


def test_every_kind_of_stream_has_its_panel() -> None:
    specs = {
        "m.mean": StreamSpec((9, 2), channels=("a", "b"), channel_axis=1), "m.sd": StreamSpec((9, 2), channels=("a", "b"), channel_axis=1),
        "c": StreamSpec((9, 2), channels=("a", "b"), channel_axis=1), "s": SIGNAL, "d": StreamSpec((3, 4), np.dtype("<u2")),
        "p": StreamSpec((5, 3)), "e": StreamSpec((), np.dtype([("onset", "<i8")])),
    }  # fmt: skip
    body = {"first": usual_body().spec(30.0), "second": usual_body().spec(30.0)}
    assert [(p["kind"], p["of"]) for p in default_panels(body, {})] == [
        ("avatar", ["second"]), ("scene", ["first"]), ("scene", ["second"])
    ]  # fmt: skip
    panels = default_panels(specs, {"m": ["c", "e"]})
    assert {(p["kind"], *p["of"]) for p in panels} == {
        ("scene", "p"), ("frame", "d"), ("cycles", "m.mean", "m.sd", "c"), ("signal", "s"), ("events", "e"), ("table", "e"),
    }  # fmt: skip


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ("panels: 3", ["panels is the number 3", "list"]),
        ("panels: [a]", ["a panel is", "mapping"]),
        ("panels: [{of: board.emg}]", ["kind"]),
        ("panels: [{kind: sinal}]", ["kind", "'signal'"]),
        ("panels: [{kind: signal, of: board.egm}]", ["egm", "emg"]),
        ("panels: [{kind: signal, wide: 9}]", ["wide", "4"]),
        ("colour: red", ["unknown key 'colour'"]),
        ("panels: [{kind: signal, colour: red}]", ["unknown key 'colour'"]),
    ],
)
def test_what_is_wrong_in_the_section_is_told_with_its_line(section: str, words: list[str]) -> None:
    with pytest.raises(GraphError) as error:
        load_text(f"page: {{{section}}}\n{BOARD}")
    assert all(word in str(error.value) for word in [*words, "graph:1:"]), error.value


def test_panels_are_taken_as_they_are_written() -> None:
    graph = load_text("page: {panels: [{kind: signal, of: board.emg, wide: 2, window_s: 5}, {kind: log}]}\n" + BOARD)
    reported = hello(graph, outside=False, mode="live", t0_ns=0)
    assert [(p["kind"], p["of"]) for p in reported["panels"]] == [("signal", ["board.emg"]), ("log", [])]
    assert (reported["panels"][0]["wide"], reported["panels"][0]["window_s"]) == (2, 5)


def fed(spec: StreamSpec) -> tuple[Hub, list[dict[str, Any]]]:
    rows: list[dict[str, Any]] = []
    hub = Hub(rows.append)
    greeting = encode(
        {"t": "hello", "mode": "live", "specs": [spec.to_json()], "t0_ns": 0, "streams": [], "panels": []}
    )
    hub.receive(*decode(greeting))
    return hub, rows


def give(hub: Hub, chunk: Chunk) -> None:
    header = {"t": "chunk", "s": 0, "n": len(chunk.time), "lost": chunk.lost, "until": chunk.until}
    hub.receive(*decode(encode(header, chunk.time.tobytes(), chunk.data.tobytes())))
    hub.receive({"t": "tick"}, memoryview(b""))


def test_a_client_gets_all_that_it_has_not_been_sent_and_a_slow_one_gets_it_at_once() -> None:
    hub, reported = fed(SIGNAL)
    quick, slow = Looking(), Looking()
    hub.clients |= {quick, slow}
    for client in (quick, slow):
        hub.take(client, asked('{"do": "see", "streams": {"0": 0}}'))
    assert reported[-1] == {"do": "want", "streams": [0], "seen": True}
    quick.news.clear()
    counts = []
    for k in range(10):
        give(hub, Chunk(grid(RATE_HZ, 33, start_ns=k * 33_000_000), np.ones((33, 2)), 0))
        counts += [decode(m)[0]["n"] for m in hub.news_for(quick)]
        quick.news.clear()
    assert counts == [33] * 10
    assert [decode(m)[0]["n"] for m in hub.news_for(slow)] == [330]
    assert slow.skipped > quick.skipped == 0


def test_a_client_that_was_slow_for_so_long_that_samples_were_forgotten_sees_a_gap() -> None:
    hub, _ = fed(SIGNAL)
    hub.histories[0].limit = 100
    client = Looking()
    hub.clients.add(client)
    hub.take(client, asked('{"do": "see", "streams": {"0": 0}}'))
    give(hub, Chunk(grid(RATE_HZ, 50), np.ones((50, 2)), 0))
    hub.news_for(client)
    for k in range(1, 9):
        give(hub, Chunk(grid(RATE_HZ, 50, start_ns=NS + k * 50_000_000), np.ones((50, 2)), 0))
    header, numbers = decode(hub.news_for(client)[0])
    assert header["n"] == 101
    assert np.isnan(np.frombuffer(numbers[8 * 101 :], np.float32)[0])


def test_an_event_is_told_with_times_in_seconds_and_texts_as_they_are() -> None:
    dtype = np.dtype([("onset", "<i8"), ("text", "U16"), ("share", "<f8"), ("map", "<u2", (2, 2))])
    spec = StreamSpec((), dtype, units=("ns", "", "", ""))
    row = np.zeros(1, dtype)
    row[0]["onset"], row[0]["text"], row[0]["share"] = 5 * NS + (1 << 60), "<b>&", np.nan
    header, _ = decode(messages.events(0, 0, spec, np.array([(1 << 60) + 6 * NS]), row, 1 << 60))
    assert header["rows"] == [[6.0, 5.0, "<b>&", None]]


def test_a_pose_is_told_as_its_joints() -> None:
    tree = usual_body()
    rng = np.random.default_rng(3)
    turns = rng.normal(size=(len(tree.joints), 4))
    pose = np.r_[rng.normal(size=3), (turns / np.linalg.norm(turns, axis=1)[:, None]).ravel()]
    header, numbers = decode(messages.newest(0, tree.spec(30.0), 1, 0, pose, 0))
    assert (header["t"], header["shape"]) == ("points", [len(tree.joints), 3])
    found, turned = np.split(np.frombuffer(numbers, "<f4"), [3 * len(tree.joints)])
    assert np.allclose(found.reshape(-1, 3), joints_of(tree, pose[None])[1][0], atol=1e-6)
    assert np.allclose(turned, pose[3:], atol=1e-6)
    reported = described("pose", tree.spec(30.0))
    assert reported["channels"] == list(tree.joints)
    assert [[int(p), j] for j, p in enumerate(tree.parents) if p >= 0] == reported["bones"]


def test_a_mesh_with_a_vertex_that_is_missing_says_which() -> None:
    spec = Topology(3, np.array([[0, 1, 2]])).spec(30.0)
    vertices = np.array([[0, 0, 0], [1, 2, 3], [-1, 0.5, 1.0]])
    header, numbers = decode(messages.newest(0, spec, 1, 0, vertices, 0))
    whole = (
        np.frombuffer(numbers, "<u2").reshape(3, 3) / 65535 * np.subtract(header["high"], header["low"]) + header["low"]
    )
    assert np.allclose(whole, vertices, atol=1e-4)
    vertices[1, 2] = np.nan
    header, numbers = decode(messages.newest(0, spec, 1, 0, vertices, 0))
    assert header["type"] == "f4"
    assert np.array_equal(np.frombuffer(numbers, "<f4").reshape(3, 3), vertices.astype("<f4"), equal_nan=True)


@pytest.mark.parametrize("streams", ['{"1": 0}', '{"-1": 0}'])
def test_a_stream_that_is_not_there_cannot_be_looked_at(streams: str) -> None:
    hub, _ = fed(SIGNAL)
    with pytest.raises(ValueError):
        hub.take(Looking(), asked('{"do": "see", "streams": ' + streams + "}"))


def test_metrics_are_openmetrics() -> None:
    table = {
        'a"b\n': {"samples": 5, "rate_hz": 2.5, "p99_us": 20.0, "error": "gone"},
        "recording": {"bytes": 100, "error": ""},
    }
    lines = openmetrics("s", table, 2, 1).splitlines()
    assert lines[-1] == "# EOF"
    assert 'kinegraph_samples_total{session="s",node="a\\"b\\n"} 5' in lines
    assert 'kinegraph_call_p99_seconds{session="s",node="a\\"b\\n"} 2e-05' in lines
    assert 'kinegraph_failed{session="s",node="a\\"b\\n"} 1' in lines
    assert "kinegraph_page_dropped_views_total 1" in lines
    families = {family.name: family for family in text_string_to_metric_families("\n".join([*lines, ""]))}
    assert {sample.labels["node"] for sample in families["kinegraph_samples"].samples} == {'a"b\n'}
    assert len(families) == len([line for line in lines if line.startswith("# TYPE")])


def test_every_message_stands_in_the_docs() -> None:
    """What the server sends and takes, as the page's own TypeScript and the decoder know it."""
    folder = Path(__file__).resolve().parents[2]
    reported = (folder / "docs" / "lab" / "page-messages.md").read_text(encoding="utf-8")
    wire = (folder / "devices/page/web/wire.ts").read_text(encoding="utf-8")
    sent = {name for line in re.findall(r"\bt: ((?:\"\w+\"(?: \| )?)+)", wire) for name in re.findall(r"\w+", line)}
    assert len(sent) > 12
    assert {name for name in sent if f"`{name}`" not in reported} == set()
    asked_for = {kind.__struct_config__.tag for kind in get_args(Asked)}
    assert len(asked_for) > 6
    assert {name for name in asked_for if f'"do": "{name}"' not in reported} == set()


SHIPPED = {
    "avatar_markers": {"answer", "avatar", "scene", "signal", "state", "graph", "log"},
    "treadmill_emg": {"answer", "cycles", "signal", "events", "table", "state", "graph", "log"},
    "bedside_simulated": {"answer", "hypnogram", "weeks", "signal", "events", "table", "state", "graph", "log"},
    "bedside_sleep": {"answer", "hypnogram", "weeks", "signal", "events", "table", "state", "graph", "log"},
    "segment_mocap": {"answer", "similarity", "scene", "signal", "events", "table", "state", "graph", "log"},
}


@pytest.mark.parametrize(("name", "kinds"), SHIPPED.items())
def test_the_pages_of_the_shipped_graphs(name: str, kinds: set[str]) -> None:
    reported = hello(load(Path(name)), outside=False, mode="live", t0_ns=0)
    assert {panel["kind"] for panel in reported["panels"]} == kinds
    assert not [panel for panel in reported["panels"] if panel["missing"]]
    assert not [stream["name"] for stream in reported["streams"] if stream["kind"] == "frame"]
