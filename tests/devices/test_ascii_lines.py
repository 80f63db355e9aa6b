"""Lines of numbers: cuts, garbage, headers; the source against a simulated Arduino."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinegraph.devices.clocks.device_clock import DeviceClock
from kinegraph.devices.clocks.device_time import DeviceTime
from kinegraph.devices.clocks.stamps import Stamps
from kinegraph.devices.lines.protocol import LineDecoder
from kinegraph.devices.lines.simulator import LinesModel
from kinegraph.devices.lines.simulator import SimulatedAsciiLines as Simulated
from kinegraph.devices.lines.source import AsciiLines, LinesReading
from kinegraph.devices.simulation.cable import line_at
from kinegraph.devices.simulation.fault_injection import GOOD, FaultInjection
from kinegraph.devices.simulation.serve import Server
from kinegraph.stream.chunk import NS
from kinegraph.stream.errors import DeviceError, ParameterError
from kinegraph.stream.params import build
from tests.support.device_feed import Kept, check, cut, reading, wait_for

ROWS = np.random.default_rng(1).integers(-9999, 9999, (80, 3))
LINES = [f"{a},{b},{c}\r\n".encode() for a, b, c in ROWS]


def decoded(pieces: list[bytes], **given: object) -> tuple[list[list[float]], int]:
    """(rows, rejected) of all pieces."""
    decoder = LineDecoder(given.pop("columns", ("a", "b", "c")), **given)  # type: ignore[arg-type]
    lines = [decoder.feed(piece) for piece in pieces]
    return [row for found in lines for row in found.rows.tolist()], sum(found.rejected for found in lines)


@given(st.lists(st.integers(0, 10**4), max_size=20))
def test_any_cut_gives_the_same_rows_and_the_first_line_is_dropped(cuts: list[int]) -> None:
    rows, rejected = decoded(cut(b"".join(LINES), cuts))
    assert rows == ROWS[1:].tolist() and rejected == 0


def test_byte_by_byte() -> None:
    data = b"".join(LINES)
    assert decoded([data[i : i + 1] for i in range(len(data))]) == (ROWS[1:].tolist(), 0)


@given(
    st.lists(st.tuples(st.integers(1, 80), st.binary(max_size=30)), max_size=5),
    st.lists(st.integers(0, 10**4), max_size=12),
)
def test_garbage_costs_at_most_the_line_it_stands_before(garbage: list[tuple[int, bytes]], cuts: list[int]) -> None:
    pieces = list(LINES)
    for at, noise in garbage:
        pieces.insert(at, noise)
    data = b"".join(pieces)
    rows, rejected = decoded([data])
    assert decoded(cut(data, cuts)) == (rows, rejected)
    there = {tuple(row) for row in rows}
    missing = [i for i in range(1, 80) if tuple(float(v) for v in ROWS[i]) not in there]
    assert len(missing) <= len(garbage)


@given(st.binary(max_size=3000), st.lists(st.integers(0, 3000), max_size=6), st.booleans())
def test_no_bytes_whatever_make_it_fail(data: bytes, cuts: list[int], header: bool) -> None:
    assert decoded([data], header=header) == decoded(cut(data, cuts), header=header)


@pytest.mark.parametrize(
    ("line", "good"),
    [
        (b"1,2,3", True),
        (b" 1 , 2.5 ,\t-3e-2 ", True),
        (b".5,+7.,1E3", True),
        (b"nan,inf,-INF", True),
        (b"1,2", False),
        (b"1,2,3,4", False),
        (b"1,,3", False),
        (b"1,2,3,", True),
        (b"1,2,3 , ", True),
        (b"1,2,3,,", False),
        (b"a:1,b:2,c:3", True),
        (b"c: 3 , a=1,b : 2,", True),
        (b"a:1,b:2,c:3,d:4", True),
        (b"a:1,b:2", False),
        (b"a:1,b:2,c:x", False),
        (b"a:1,b:2,c:3,b:5", False),
        (b"a:1,2,c:3", False),
        (b"1,x,3", False),
        (b"1_0,2,3", False),
        (b"1;2;3", False),
        (b"0x1,2,3", False),
        (b"1,2,\xff", False),
        (b"1,2,3e9999", False),
    ],
)
def test_what_a_line_may_be(line: bytes, good: bool) -> None:
    rows, rejected = decoded([b"\n" + line + b"\n"])
    assert (len(rows), rejected) == ((1, 0) if good else (0, 1))


@given(st.lists(st.integers(0, 10**4), max_size=20), st.sampled_from([",", ";", "\t", " "]))
def test_labelled_lines_in_any_order_and_any_cut(cuts: list[int], delimiter: str) -> None:
    lines = [delimiter.join((f"c:{c}", "x:0.5", f"a:{a}", f"b:{b}")) + "\n" for a, b, c in ROWS]
    data = "".join(lines).encode()
    whole = decoded([data], delimiter=delimiter)
    assert whole == (ROWS[1:].tolist(), 0)
    assert decoded(cut(data, cuts), delimiter=delimiter) == whole
    assert decoded([data[i : i + 1] for i in range(len(data))], delimiter=delimiter) == whole


def test_blank_lines_and_comments_are_passed_over_and_a_line_without_end_is_rejected() -> None:
    rows, rejected = decoded([b"\n\n# hello\n1,2,3\r\r\n4,5,6\n" + b"7" * 5000, b"7,8,9\n10,11,12\n"])
    assert rows == [[1, 2, 3], [4, 5, 6], [10, 11, 12]] and rejected == 1


def test_delimiters() -> None:
    for delimiter, line in ((";", b"1;2;3"), ("\t", b"1\t2\t3"), (" ", b"1   2 \t3"), ("|", b"1| 2|3")):
        assert decoded([b"\n" + line + b"\n"], delimiter=delimiter)[0] == [[1, 2, 3]]


def test_a_header_tells_where_each_column_stands() -> None:
    data = b"9,9,9\n8,8,8\nt,b,a,x\n1,2,3,4\n5,6,7\nt,a,b\n10,11,12\n"
    rows, rejected = decoded([data], columns=("a", "b"), header=True)
    assert rows == [[3, 2], [11, 12]] and rejected == 1
    assert decoded([b"a,b,c\n1,2,3\n"], header=True)[0] == [[1, 2, 3]], "the header may be the first line"
    assert decoded([b"\na,b,c\n1,2,3\n"]) == ([[1, 2, 3]], 0), "one that was not asked for is passed over"


# the device's time ---------------------------------------------------------------------------------------------------


def test_time_that_begins_again_at_32_bits_grows_on() -> None:
    wraps = (1 << 32) * 1000
    clock = DeviceTime(DeviceClock(), wraps)
    values = [clock.read((wraps - 5_000_000 + i * 2_000_000) % wraps, i * 2_000_000) for i in range(10)]
    assert np.diff([v for v in values if v is not None]).tolist() == [2_000_000] * 9


def test_a_long_silence_counts_the_turns() -> None:
    clock = DeviceTime(DeviceClock(), 60 * NS)
    clock.read(10 * NS, 0)
    assert clock.read(20 * NS, 190 * NS) == 200 * NS


def test_one_wrong_number_is_left_out_and_a_restart_is_believed_after_three() -> None:
    clock = DeviceTime(DeviceClock())
    assert [clock.read(v * NS, i * NS) for i, v in enumerate([100, 101, 991, 103, 4, 105])] == [
        100 * NS, 101 * NS, None, 103 * NS, None, 105 * NS,
    ]  # fmt: skip
    after = [(clock.read(v * NS, (6 + i) * NS), clock.restarted) for i, v in enumerate([0, 1, 2, 3])]
    assert after == [(None, False), (None, False), (2 * NS, True), (3 * NS, False)]


def test_without_any_clock_stamps_lie_evenly_before_the_arrival() -> None:
    stamps = Stamps(100.0)
    first = stamps.take(3, 1000 * NS)
    assert (1000 * NS - first.stamp).tolist() == [20_000_000, 10_000_000, 0]
    crowded = stamps.take(4, 1000 * NS + 10_000_000).stamp
    assert (np.diff(np.concatenate([first.stamp, crowded])) >= 0).all() and crowded[-1] == 1000 * NS + 10_000_000
    assert (first.device == -1).all() and (first.number == -1).all()


# the source ----------------------------------------------------------------------------------------------------------


def served(faults: FaultInjection = GOOD, address: str = "", **given: object) -> Server:
    return Server(Simulated(**given).brain(), line_at(address), faults)  # type: ignore[arg-type]


@pytest.mark.parametrize("address", ["", "tcp://127.0.0.1:0"])
def test_lines_with_time_become_samples(address: str) -> None:
    with served(columns=("micros", "ta", "so"), address=address) as server:
        source = AsciiLines(
            server.address,
            ("micros", "ta", "so"),
            time="micros",
            rate_hz=500.0,
            scale=(2.0,),
            offset=(-1024.0, 0.0),
            units=("mV",),
        )
        with reading(source) as feed:
            wait_for(lambda: feed.count("out") >= 600)
        brain = server.brain
    assert isinstance(brain, LinesModel) and feed.error is None and not feed.problems
    check(source, feed)
    number = np.round(feed.data("timing")["device"] / NS * 500).astype(int)
    assert (np.diff(number) == 1).all()
    truth = np.stack([brain.counts(n) for n in number]) * 2.0 + [-1024.0, 0.0]
    assert np.array_equal(feed.data("out"), truth)
    assert abs(np.median(np.diff(feed.time("out"))) - 2e6) < 1e4
    assert source.specs()["out"].channels == ("ta", "so")


def test_lost_and_broken_lines_are_told_by_a_counter() -> None:
    wrong = FaultInjection(lose=0.05, corrupt=0.05, duplicate=0.03, seed=1)
    with served(wrong, columns=("n", "a"), counter="n", counter_bits=8, time="", rate_hz=200.0) as server:
        source = AsciiLines(server.address, ("n", "a"), counter="n", counter_bits=8, rate_hz=200.0)
        with reading(source) as feed:
            wait_for(lambda: feed.count("out") >= 500)
    check(source, feed)
    assert feed.problems["bad line"] > 5 and feed.problems["lost line"] > 20
    assert feed.problems["repeated line or wrong time"] > 5
    assert sum(v for v in feed.lost("out").values() if v > 0) == feed.problems["lost line"]
    elapsed = (feed.time("out")[-1] - feed.time("out")[0]) / NS
    made = feed.count("out") + feed.problems["lost line"]
    assert made == pytest.approx(elapsed * 200, rel=0.15), "a wrong counter may deceive for a moment, not for long"


def test_lost_lines_are_told_by_steps_of_time() -> None:
    with served(
        FaultInjection(lose=0.1, seed=2), columns=("ms", "a"), time="ms", time_unit="ms", rate_hz=100.0
    ) as server:
        source = AsciiLines(server.address, ("ms", "a"), time="ms", time_unit="ms", rate_hz=100.0)
        with reading(source) as feed:
            wait_for(lambda: feed.count("out") >= 200)
    ms = np.round(feed.data("timing")["device"] / 1e6).astype(int)
    gaps = {i + 1: int(d // 10 - 1) for i, d in enumerate(np.diff(ms)) if d > 10}
    assert feed.lost("out") == gaps and len(gaps) > 5


def test_a_device_that_is_switched_on_again_is_followed() -> None:
    with served(FaultInjection(reset_every_s=0.8), columns=("micros", "a")) as server:
        source = AsciiLines(server.address, ("micros", "a"), time="micros", rate_hz=500.0)
        with reading(source) as feed:
            wait_for(lambda: feed.problems["device restarted"] >= 2)
    check(source, feed)
    assert -1 in feed.lost("out").values()
    late = feed.data("timing")["arrival"] - feed.time("out")
    assert np.abs(late).max() < 0.2 * NS


def test_a_device_without_clock_and_rate_is_stamped_by_arrival() -> None:
    with served(columns=("a",), time="", rate_hz=100.0) as server:
        source = AsciiLines(server.address, ("a",))
        with reading(source) as feed:
            wait_for(lambda: feed.count("out") >= 50)
    check(source, feed)
    assert source.specs()["out"].rate_hz is None and (feed.data("timing")["device"] == -1).all()


def test_a_header_is_awaited_and_its_absence_told(monkeypatch: pytest.MonkeyPatch) -> None:
    with served(columns=("t", "a", "b"), time="t", header=True) as server:
        with reading(AsciiLines(server.address, ("b", "t"), header=True, time="t", rate_hz=500.0)) as feed:
            wait_for(lambda: feed.count("out") >= 50)
        monkeypatch.setattr("kinegraph.devices.lines.source.HEADER_S", 0.5)
        with reading(AsciiLines(server.address, ("b", "c"), header=True)) as feed:
            wait_for(lambda: feed.error is not None)
    assert isinstance(feed.error, DeviceError) and "a line that names b,c; came" in str(feed.error)


def test_lines_of_another_kind_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kinegraph.devices.lines.source.FIRST_LINE_S", 0.4)
    with served(columns=("a", "b")) as server, reading(AsciiLines(server.address, ("a", "b", "c"))) as feed:
        wait_for(lambda: feed.error is not None)
    assert "expected 3 numbers, a,b,c; came" in str(feed.error) and feed.problems["bad line"] > 10


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"columns": ["t"], "time": "t"}, "at least one of which is data"),
        ({"columns": ["a", "a"]}, "different names"),
        ({"columns": ["a"], "time": "t"}, "one of the columns: a"),
        ({"columns": ["a", "b"], "scale": [1, 2, 3]}, "one for each of a, b"),
        ({"columns": ["a", "n"], "counter": "n"}, "rate_hz"),
        ({"columns": ["a"], "delimiter": "1"}, "delimiter"),
        ({"columns": ["a"], "time_unit": "min"}, "time_unit"),
    ],
)
def test_what_cannot_be_is_refused(given: dict[str, object], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        build(AsciiLines, {"port": "/dev/ttyACM0", **given}).specs()


@pytest.mark.parametrize(("port", "asked"), [("/dev/ttyACM0", True), ("tcp://10.0.0.2:4001", False)])
def test_the_baud_rate_is_asked_after_only_where_there_is_one(port: str, asked: bool) -> None:
    reported = LinesReading(AsciiLines(port, ("a", "b"))).wrong(9.0, b"1,2,3\r\n")
    assert reported.startswith(f"no good line from {port} within 9 s") and ("baud" in reported) == asked


def test_a_line_that_comes_twice_is_recorded_once_where_only_the_devices_time_tells() -> None:
    source = AsciiLines(port="x", columns=("t", "a"), time="t", time_unit="ms", rate_hz=100.0)
    feed, reading = Kept(), LinesReading(source)
    lines = [f"{10 * i},{i % 7}\n".encode() for i in range(40)]
    twice = [*lines[:20], lines[19], *lines[20:30], lines[29], lines[29], *lines[30:]]
    for i, line in enumerate(twice):
        reading.take((b"\n" if not i else b"") + line, feed)
    assert np.concatenate([chunk.data[:, 0] for chunk in feed.chunks["out"]]).tolist() == [i % 7 for i in range(40)]
    assert feed.problems["repeated line or wrong time"] == 3


def test_two_samples_within_the_clocks_resolution_are_two() -> None:
    source = AsciiLines(port="x", columns=("t", "a"), time="t", time_unit="ms", rate_hz=2000.0)
    feed, reading = Kept(), LinesReading(source)
    for i in range(400):
        reading.take((b"\n" if not i else b"") + f"{i // 2},7\n".encode(), feed)
    assert feed.count("out") == 400 and not feed.problems
