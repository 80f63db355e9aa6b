"""One record at a time goes a shorter way than several: it gives the same, bit for bit, whatever the device does."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.frames.decoder import FoundFrames
from kinegraph.devices.frames.packet_decoder import PacketDecoder
from kinegraph.devices.frames.reading import FrameReading
from kinegraph.devices.frames.source import Binary
from kinegraph.devices.osc.inlet import OscInlet
from kinegraph.devices.osc.protocol import OscError, OscReader, read_osc
from kinegraph.stream.chunk import NS
from kinegraph.stream.params import build
from tests.support.device_feed import Kept

COUNTER, TIME = {"type": "u16", "role": "counter"}, {"type": "u32", "role": "time", "unit": "us"}
DATA = [{"type": "i16", "name": "a", "scale": 0.25}, {"type": "f32", "name": "b", "offset": 1.0}]


class At(Kept):
    """Records come when `at` says."""

    at = NS

    def now(self) -> int:
        return self.at


def through_several(reading: FrameReading) -> FrameReading:
    """The same reading, in which every single record goes the way of several."""

    def emit_all(kind: int, frame: bytes, feed: Any) -> None:
        reading._emit_all(FoundFrames(kinds=[kind], frames={kind: bytearray(frame)}), feed)

    reading._emit_one = emit_all  # type: ignore[method-assign]
    return reading


def arrivals(rng: np.random.Generator) -> list[tuple[int, int, int]]:
    """(arrival, counter, device's time in us) of records at 100 Hz, lost, doubled and late, of a device that starts again."""
    found, at, number = [], NS, int(rng.integers(65536))
    for i in range(1200):
        at += 10_000_000
        number += 1
        what = rng.random()
        if what < 0.02:
            continue
        if i == 700:
            number = 3
        late = int(rng.exponential(2e6))
        found.append((at + late, number % 65536, (number * 10_000) % (1 << 32)))
        if what > 0.98:
            found.append((at + late + 1000, number % 65536, (number * 10_000) % (1 << 32)))
    return sorted(found)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("fields", "form"), [([COUNTER], "H"), ([TIME], "T"), ([COUNTER, TIME], "HT"), ([], "")])
def test_a_frame_alone_is_read_as_several_are(fields: list[dict[str, Any]], form: str, seed: int) -> None:
    frame = {"name": "m", "sync": "", "rate_hz": 100, "endian": "big", "fields": [*fields, *DATA]}
    source = build(Binary, {"port": "udp://127.0.0.1:9", "frames": [frame], "rate_mismatch": "warn"})
    kept = []
    for change in (lambda reading: reading, through_several):
        reading, feed = change(FrameReading(source, PacketDecoder(source.layouts()))), At()
        feed.again = True
        for i, (arrival, counter, us) in enumerate(arrivals(np.random.default_rng(seed))):
            head = b"".join({"H": struct.pack(">H", counter), "T": struct.pack(">I", us)}[c] for c in form)
            feed.at = arrival
            reading.take(head + struct.pack(">hf", i % 30000, i / 7), feed)
        kept.append(feed)
    one, several = kept
    assert one.problems == several.problems and one.lost("m") == several.lost("m")
    for output in ("m", "timing"):
        assert one.time(output).tobytes() == several.time(output).tobytes()
        assert one.data(output).tobytes() == several.data(output).tobytes()
    assert one.count("m") > 1000 and (not form or one.problems)


NUMBERS = [
    ("u8", "B", 200),
    ("i8", "b", -3),
    ("u16", "H", 40000),
    ("i32", "i", -(1 << 30)),
    ("u64", "Q", (1 << 64) - 1),
    ("i64", "q", -1),
]


@pytest.mark.parametrize("endian", ["little", "big"])
def test_a_row_is_that_of_a_table(endian: str) -> None:
    order = "<" if endian == "little" else ">"
    fields = [{"type": "u8"}, *({"type": kind, "name": kind, "scale": 0.1, "offset": 3.0} for kind, _, _ in NUMBERS)]
    frame = {"name": "m", "sync": "aa", "endian": endian, "fields": [*fields, {"type": "f64", "name": "d"}]}
    for more in ([], [{"type": "u16", "name": "other", "endian": "big" if endian == "little" else "little"}],
                 [{"type": "u12", "name": "p"}, {"type": "i12", "name": "q"}]):  # fmt: skip
        whole = {**frame, "fields": [*frame["fields"], *more]}
        (layout,) = build(Binary, {"port": "COM1", "frames": [whole]}).layouts()
        body = b"\xaa\x07" + b"".join(struct.pack(order + form, number) for _, form, number in NUMBERS)
        packet = (body + struct.pack(order + "d", 0.1)).ljust(layout.size, b"\x9c")
        assert layout.row(packet).tobytes() == layout.values(layout.table(packet)).tobytes()


def text(words: str) -> bytes:
    raw = words.encode()
    return raw + b"\0" * (4 - len(raw) % 4)


def test_messages_of_any_shape_after_any_other() -> None:
    rng, reader = np.random.default_rng(5), OscReader()
    shapes = [
        ("/a", ",fff"),
        ("/a", ",ff"),
        ("/ab", ",fff"),
        ("/a", ",ifd"),
        ("/a", ",sf"),
        ("/a", ",hT"),
        ("/a", ","),
        ("/long/address", ",ft"),
    ]
    for _ in range(3000):
        address, types = shapes[int(rng.integers(len(shapes)))]
        data = text(address) + text(types)
        for tag in types[1:]:
            data += {"f": struct.pack(">f", rng.random()), "i": struct.pack(">i", 7), "d": struct.pack(">d", rng.random()),
                     "h": struct.pack(">q", -1), "t": struct.pack(">Q", 1), "s": text("word"), "T": b""}[tag]  # fmt: skip
        if rng.random() < 0.1:
            data = data[: int(rng.integers(len(data)))] + bytes(int(rng.integers(3)))
        if rng.random() < 0.1:
            more = text("/b") + text(",f") + bytes(4) if rng.random() < 0.5 else b""
            data = (
                b"#bundle\0"
                + bytes(8)
                + struct.pack(">i", len(data))
                + data
                + (struct.pack(">i", len(more)) + more if more else b"")
            )
        assert decoded(reader.read, data) == decoded(read_osc, data)


def decoded(read: Any, data: bytes) -> Any:
    try:
        return [(address, list(arguments)) for address, arguments in read(data)]
    except OscError as error:
        return str(error)


def test_what_waits_is_read_at_once_where_a_clock_bears_it() -> None:
    def pause(hz: float | None, *fields: dict[str, Any], **more: Any) -> float:
        frame = {"name": "m", "sync": "", "rate_hz": hz, "fields": [*fields, *DATA]}
        return build(Binary, {"port": "udp://127.0.0.1:9", "frames": [frame], **more}).datagrams_s

    assert pause(100.0, COUNTER) == pause(100.0, TIME) == 0.025
    assert pause(100.0) == pause(60.0, COUNTER) == pause(None, TIME) == 0, "few, or stamped by their arrival"
    assert pause(100.0, COUNTER, gather_s=0.0) == 0 and pause(100.0, gather_s=0.05) == 0.05
    arguments = [{"name": "x"}, {"role": "counter"}]

    def osc(*hz: float | None, clock: bool = True) -> OscInlet:
        made = [
            {"name": f"s{i}", "address": f"/{i}", "rate_hz": r, "arguments": arguments[: 1 + clock]}
            for i, r in enumerate(hz)
        ]
        return build(OscInlet, {"streams": made})

    assert osc(100.0).gathered_s == osc(200.0, 100.0).chunk_s == 0.025
    assert osc(100.0, 30.0).gathered_s == osc(100.0, clock=False).gathered_s == osc(None).gathered_s == 0
