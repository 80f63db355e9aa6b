"""The pipe between a session and its page's server: whole messages in order, a writer that never waits, a reader that may stop or end."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from kinegraph.devices.page.transfer.channel import TICK, PageChannel
from kinegraph.devices.page.transfer.pipe import MAX_BUFFERS, ServerPipe
from kinegraph.devices.page.transfer.wire import LENGTH, decode, encode
from kinegraph.stream.chunk import Chunk, grid

pytestmark = pytest.mark.quick


@dataclass
class PipeEnds:
    """A pipe; `read` gives the whole messages that have arrived, `close` ends the reader."""

    pipe: ServerPipe
    reader: int
    came: bytes = b""

    def read(self) -> list[bytes]:
        while True:
            try:
                self.came += os.read(self.reader, 1 << 20)
            except BlockingIOError:
                break
        found = []
        while len(self.came) >= LENGTH.size:
            end = LENGTH.size + LENGTH.unpack_from(self.came)[0]
            if len(self.came) < end:
                break
            found.append(self.came[LENGTH.size : end])
            self.came = self.came[end:]
        return found

    def close(self) -> None:
        os.close(self.reader)
        self.reader = -1


@pytest.fixture
def ends() -> Iterator[PipeEnds]:
    reader, writer = os.pipe()
    os.set_blocking(reader, False)
    made = PipeEnds(ServerPipe(writer), reader)
    yield made
    os.close(writer)
    if made.reader >= 0:
        made.close()


def test_messages_come_whole_and_in_order_however_full_the_pipe_was(ends: PipeEnds) -> None:
    rng = np.random.default_rng(1)
    sent, came, full = [], [], 0
    for _ in range(60):
        array = rng.normal(size=(int(rng.integers(0, 5000)), 3))
        small = [bytes([k % 256]) for k in range(int(rng.integers(0, 2 * MAX_BUFFERS)))]
        ends.pipe.write([[b"", array, *small], [b"end"]])
        sent += [array.tobytes() + b"".join(small), b"end"]
        full += not ends.pipe.flush()
        if rng.random() < 0.02:
            came += ends.read()
    assert full > 5
    while not ends.pipe.flush():
        came += ends.read()
    assert came + ends.read() == sent


@pytest.mark.parametrize("dtype", ["S8", "U8", "<f4", "?", "<u2"])
def test_samples_of_any_type_come_as_their_bytes_though_cut_in_their_midst(ends: PipeEnds, dtype: str) -> None:
    samples = np.zeros(300_000, np.dtype([("a", dtype), ("b", "<i8")]))
    samples["b"] = np.arange(len(samples))
    ends.pipe.write([[samples]])
    assert not ends.pipe.flush()
    came = ends.read()
    while not ends.pipe.flush():
        came += ends.read()
    assert (came + ends.read())[0] == samples.tobytes()


def test_who_writes_to_a_reader_that_has_ended_hears_of_it(ends: PipeEnds) -> None:
    ends.close()
    with pytest.raises(BrokenPipeError):
        ends.pipe.write([[b"a"]])


def chunk(k: int, n: int = 1) -> Chunk:
    return Chunk(grid(100.0, n, start_ns=k * 10**7), np.full((n, 1), float(k)), k * 10**7)


def handed_over(ends: PipeEnds) -> list[tuple[str, list[float], int]]:
    """What arrived but ticks: of chunks the samples and what was lost before them."""
    rows = [decode(message) for message in ends.read()]
    return [
        (h["t"], np.frombuffer(n, np.float64, offset=8 * h.get("n", 0)).tolist(), h.get("lost", 0))
        for h, n in rows
        if h["t"] != "tick"
    ]


def test_who_puts_hands_over_what_has_come_together_and_what_was_announced_stands_between(ends: PipeEnds) -> None:
    channel = PageChannel([False])
    channel.lead_to(ends.pipe)
    channel.wanted[0] = channel.seen = True
    put = channel.observer(0)
    put(chunk(0))
    assert handed_over(ends) == [("chunk", [0.0], 0)]
    channel._due_s = float("inf")
    put(chunk(1))
    put(chunk(2))
    assert handed_over(ends) == [], "what comes soon after waits for more"
    channel.announce(encode({"t": "again"}))
    put(chunk(3))
    channel.hand_over([encode({"t": "state"})])
    assert handed_over(ends) == [("chunk", [1.0, 2.0], 0), ("again", [], 0), ("chunk", [3.0], 0), ("state", [], 0)]


def test_a_server_that_stands_still_costs_views_and_no_more_memory(ends: PipeEnds) -> None:
    channel = PageChannel([False], max_bytes=1 << 20)
    channel.lead_to(ends.pipe)
    channel.wanted[0] = True
    put = channel.observer(0)
    for k in range(500):  # 80 kB of samples each: 40 MB
        channel._due_s = 0.0
        put(chunk(k, 10_000))
    assert channel.dropped > 400
    assert not channel.hand_over([encode({"t": "state"})])
    reported = handed_over(ends)
    for _ in range(20):
        channel.hand_over()
        reported += handed_over(ends)
    seen = [values[0] for _, values, _ in reported] + [values[-1] for _, values, _ in reported[-1:]]
    assert seen == sorted(seen) and seen[-1] == 499
    assert sum(len(values) for _, values, _ in reported) == 10_000 * (500 - channel.dropped)
    assert [lost for _, _, lost in reported].count(-1) == 1, "the line has a gap where views were dropped"


def test_a_server_that_ends_costs_its_views_and_nothing_else(ends: PipeEnds) -> None:
    channel = PageChannel([False])
    channel.lead_to(ends.pipe)
    channel.wanted[0] = True
    put = channel.observer(0)
    ends.close()
    put(chunk(0))
    assert not channel.is_led
    channel._due_s = 0.0
    put(chunk(1))
    channel.lead_to(None)
    assert channel.wanted == [False]


def test_without_writev_only_the_thread_that_may_wait_writes(ends: PipeEnds, monkeypatch: pytest.MonkeyPatch) -> None:
    """As on Windows."""
    monkeypatch.delattr(os, "writev")
    pipe = ServerPipe(os.dup(ends.reader))  # never written to
    os.close(pipe._handle)
    channel, written = PageChannel([False]), bytearray()
    monkeypatch.setattr(os, "write", lambda _, view: written.extend(view[:1000]) or min(len(view), 1000))
    channel.lead_to(pipe)
    channel.wanted[:], channel.seen = [True], True
    time = grid(1000.0, 2000)
    channel.observer(0)(Chunk(time, np.ones((2000, 2)), int(time[-1])))
    assert not channel.hand_over(wait=False) and not written and channel.is_left
    assert channel.hand_over()
    assert written.endswith(np.ones(1).tobytes() + LENGTH.pack(len(TICK)) + TICK) and len(written) > 2000 * 24
