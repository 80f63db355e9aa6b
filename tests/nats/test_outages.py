"""Outages between a bed and the centre: delay and nothing else, or a gap with its count."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from kinegraph.devices.nats import local_server
from kinegraph.devices.nats.inlet import StreamInlet, _Reading
from kinegraph.devices.nats.link import Link
from kinegraph.devices.nats.local_server import LocalServer, program
from kinegraph.devices.nats.messages import DATA, Gathering, Position, StreamReader, digest_of, spec_text, subject
from kinegraph.devices.nats.server import NatsServer
from kinegraph.devices.nats.subscription import Received
from kinegraph.stream.chunk import NEVER, NS, Chunk
from tests.support.device_feed import Kept
from tests.support.mosquitto import eventually, free_port
from tests.support.nats_site import SPEC, folders, make, numbers, receiving, samples, sending, server, vanish

__all__ = ["folders", "server"]


@pytest.fixture
def mortal(tmp_path: Path, server: LocalServer) -> Iterator[LocalServer]:
    """A server that a test may kill."""
    made = LocalServer(tmp_path / "mortal", free_port()).start()
    make(made)
    yield made
    made.stop()


def test_a_killed_server_is_delay_and_nothing_else(mortal: LocalServer) -> None:
    with sending("bed", mortal) as bed, receiving("bed", mortal) as centre:
        bed.process("x", samples(0, 50))
        eventually(lambda: len(numbers(centre)) == 50)
        mortal.kill()
        for at in range(50, 500, 10):
            bed.process("x", samples(at, 10))
        mortal.start()
        bed.process("x", samples(500, 10))
        eventually(lambda: len(numbers(centre)) >= 510)
    assert numbers(centre) == list(range(510)) and not centre.lost("out")


def test_a_bed_that_is_behind_sends_larger_messages_so_that_a_slow_link_catches_up(mortal: LocalServer) -> None:
    """Every message waits for the one before to be confirmed: over a far link 20 a second, where two streams make as many."""
    with sending("bed", mortal) as bed, receiving("bed", mortal) as centre:
        mortal.kill()
        now = 0
        bed.runtime.now = lambda: now
        sender = bed.runtime.sender
        assert sender
        for k in range(300):  # 30 s of the bed's clock
            now += NS // 10
            bed.process("x", samples(10 * k, 10))
            sender.post(bed._due())
        assert sender.waiting < 60
        now += NS
        mortal.start()
        eventually(lambda: len(numbers(centre)) >= 3000)
    assert numbers(centre) == list(range(3000)) and not centre.lost("out")


@contextmanager
def small_disk(folder: Path, mb: int) -> Iterator[tuple[Path, str]]:
    """Within: a file system of a few MB at the folder, which only programs begun by the script (second) and root's view (first) see."""
    folder.mkdir(parents=True)
    mount = f"mount -t tmpfs -o size={mb}m tmpfs {folder} && echo mounted && exec sleep 600"
    try:
        there = subprocess.Popen(
            ["unshare", "-Urm", "sh", "-c", mount], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )
    except FileNotFoundError:
        pytest.skip("there is no unshare here")
    try:
        assert there.stdout is not None
        if b"mounted" not in there.stdout.readline():
            pytest.skip("a user may not mount a file system of his own here")
        script = folder.with_name("nats-server-there")
        script.write_text(f'#!/bin/sh\nexec nsenter -t {there.pid} -U -m --preserve-credentials {program()} "$@"\n')
        script.chmod(0o700)
        yield Path(f"/proc/{there.pid}/root{folder}"), str(script)
    finally:
        there.kill()
        there.communicate()


@pytest.mark.nightly
@pytest.mark.usefixtures("server")
def test_a_servers_full_disk_is_delay_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file system that is full in earnest. The server then takes no more until it is started again, with room."""
    with small_disk(tmp_path / "small" / "store", 16) as (disk, script):
        monkeypatch.setattr(local_server, "program", lambda: script)
        full = LocalServer(tmp_path / "small", free_port(), disk_mb=1000).start()
        make(full)
        with sending("bed", full) as bed, receiving("bed", full) as centre:
            bed.process("x", samples(0, 50))
            eventually(lambda: len(numbers(centre)) == 50)
            with suppress(OSError), (disk / "else").open("wb") as other:
                while True:
                    other.write(bytes(1 << 12))
                    other.flush()
            at = 50
            while not (
                bed.runtime.sender and bed.runtime.sender.error
            ):  # it takes some, as long as its last block has room
                bed.process("x", samples(at, 500))
                at += 500
                time.sleep(0.02)
            for _ in range(10):
                bed.process("x", samples(at, 10))
                at += 10
            (disk / "else").unlink()
            full.stop()
            full.start()
            eventually(lambda: len(numbers(centre)) >= at)
        full.stop()
    assert numbers(centre) == list(range(at)) and not centre.lost("out")


def test_a_network_that_is_gone_for_a_while_is_delay_and_nothing_else(mortal: LocalServer) -> None:
    with sending("bed", mortal) as bed, receiving("bed", mortal) as centre:
        mortal.pause()
        for at in range(0, 400, 10):
            bed.process("x", samples(at, 10))
        mortal.resume()
        eventually(lambda: len(numbers(centre)) >= 400)
    assert numbers(centre) == list(range(400)) and not centre.lost("out")


def test_a_bed_that_starts_without_a_server_sends_later(mortal: LocalServer) -> None:
    mortal.stop()
    with sending("bed", mortal) as bed:
        bed.process("x", samples(0, 100))
    assert not bed.undelivered
    mortal.start()
    with sending("bed", mortal) as bed, receiving("bed", mortal) as centre:
        bed.process("x", samples(200, 10))
        eventually(lambda: len(numbers(centre)) == 110)
    assert numbers(centre) == [*range(100), *range(200, 210)]
    assert centre.lost("out") == {100: -1}  # between two sessions, an unknown number


def test_what_a_full_spool_drops_is_a_gap_with_its_count(mortal: LocalServer) -> None:
    mortal.stop()
    with sending("bed", mortal, spool_mb=0.05) as bed:
        for at in range(0, 10_000, 100):
            bed.process("x", samples(at, 100))
            bed.snapshot()  # brings to the disk what waits
        mortal.start()
        with receiving("bed", mortal) as centre:
            eventually(lambda: numbers(centre)[-1:] == [9999])
    came, lost = numbers(centre), centre.lost("out")
    assert came == list(range(10_000 - len(came), 10_000)) and lost == {0: 10_000 - len(came)} and len(came) < 3000
    assert "was full" in bed.undelivered


def test_what_the_servers_limits_discarded_is_a_gap_with_its_count(mortal: LocalServer) -> None:
    with sending("bed", mortal) as bed:
        with receiving("bed", mortal, start="continue") as centre:
            bed.process("x", samples(0, 10))
            eventually(lambda: len(numbers(centre)) == 10)
        for at in range(10, 60, 10):
            bed.process("x", samples(at, 10))
            bed.snapshot()
        eventually(lambda: not bed.runtime.sender or not bed.runtime.sender.waiting)
        link = Link(NatsServer(mortal.url), "test")
        assert link.wait(100)
        last = link.call(link.stream.stream_info(DATA)).state.last_seq
        link.call(link.stream.purge_stream(DATA, seq=last))
        link.close()
        with receiving("bed", mortal, start="continue") as centre:
            eventually(lambda: bool(numbers(centre)))
    assert numbers(centre) == list(range(50, 60)) and centre.lost("out") == {0: 40}
    assert centre.problems["discarded before it was read"] == 40


def test_a_server_that_loses_its_disk_costs_what_was_not_read_and_that_is_counted(mortal: LocalServer) -> None:
    with sending("bed", mortal) as bed:
        with receiving("bed", mortal, start="continue") as centre:
            bed.process("x", samples(0, 10))
            eventually(lambda: len(numbers(centre)) == 10)
        bed.process("x", samples(10, 30))
        eventually(lambda: not bed.runtime.sender or bed.runtime.sender.sent == 2)
        mortal.kill()
        mortal.lose_disk()
        mortal.start()
        with receiving("bed", mortal, start="continue") as centre:
            bed.process("x", samples(40, 10))
            eventually(lambda: len(numbers(centre)) == 10)
    assert numbers(centre) == list(range(40, 50)) and centre.lost("out") == {0: 30}


def test_a_killed_bed_goes_on_where_its_checkpoint_was_and_nothing_comes_twice(server: LocalServer) -> None:
    with receiving("killed", server) as centre:
        with sending("killed", server) as bed:
            bed.process("x", samples(0, 50))
            kept = bed.snapshot()
            bed.process("x", samples(50, 50))
            eventually(lambda: len(numbers(centre)) == 100)
            bed.process("x", samples(100, 20))
            vanish(bed)
        with sending("killed", server, begun=False) as bed:
            bed.restore(kept)
            bed.begin()
            for at in range(50, 140, 30):  # cut otherwise than before
                bed.process("x", samples(at, 30))
            eventually(lambda: len(numbers(centre)) >= 140)
    assert numbers(centre) == list(range(140)) and not centre.lost("out")
    assert centre.problems["repeated, left out"] >= 50


def test_a_session_that_is_resumed_reads_on_where_its_recording_ends(server: LocalServer) -> None:
    with sending("resumed", server) as bed:
        for at in range(0, 100, 10):
            bed.process("x", samples(at, 10))
            bed.snapshot()
        with receiving("resumed", server, start="continue") as centre:
            eventually(lambda: len(numbers(centre)) == 100)
        for until, first in (
            (samples(0, 43).until, 43),
            (samples(0, 100).until, 100),
        ):  # behind what was written down, and at it
            bed.process("x", samples(100, 10)) if first == 100 else None
            feed = Kept()
            feed.position = lambda output="out", until=until: until  # type: ignore[method-assign]
            with receiving("resumed", server, feed, start="continue") as centre:
                eventually(lambda: bool(numbers(centre)) and numbers(centre)[-1] in (99, 109))
            assert numbers(centre)[0] == first and not centre.lost("out")


def message(*chunks: Chunk, first: int, session: str = "s") -> bytes:
    gathering = Gathering(SPEC, subject("b", "data", "x"), session, first)
    for chunk in chunks:
        assert not list(gathering.add(chunk, 0, NEVER))
    return next(gathering.due(0, last=True)).body


def test_a_disk_that_is_lost_while_a_crashed_centre_reads_again_is_a_gap_of_unknown_size(tmp_path: Path) -> None:
    """The position is ahead of the 80 samples on the centre's disk; 50 of them are read again when the server loses the rest."""
    feed, nobody = Kept(), cast(Any, SimpleNamespace(there=False))
    feed.position = lambda output="out": samples(0, 80).until  # type: ignore[method-assign]
    inlet = StreamInlet(bed="bed", stream="x", position=str(tmp_path))
    ahead = Position(9, "s", 90, samples(0, 90).until)
    inlet.place.write_text(json.dumps({**ahead.to_json(), "created": "", "offset": None}))
    reading = _Reading(inlet, SPEC, nobody, feed)
    spec = digest_of(spec_text(SPEC))
    reading._take(Received(1, "s", spec, message(samples(0, 50), first=0)))
    reading._subscription.lost_disk += 1
    reading._take(Received(1, "s", spec, message(samples(100, 10), first=100)))
    assert numbers(feed) == list(range(100, 110)) and feed.lost("out") == {0: -1}


def test_a_reader_decides_by_stamps_what_is_new_and_by_the_index_what_is_missing() -> None:
    reader = StreamReader(SPEC, Position(index=0))
    assert len(reader.read(1, "s", message(samples(0, 5), samples(5, 5), first=0))) == 2
    assert reader.read(2, "s", message(samples(0, 10), first=0)) == []
    (rest,) = reader.read(3, "s", message(samples(8, 4), first=8))
    assert rest.data[:, 0].tolist() == [10, 11] and rest.lost == 0
    (after,) = reader.read(4, "s", message(samples(20, 2), first=20))
    assert after.lost == 8 and reader.discarded == 8
    # after a power cut the bed has forgotten samples that came here: the index is lower, the stamps are new
    (new,) = reader.read(5, "s", message(samples(30, 2), first=18))
    assert new.data[:, 0].tolist() == [30, 31] and new.lost == 0
    assert reader.read(6, "t", message(samples(31, 1), first=0, session="t")) == [] and reader.before == 1
    (other,) = reader.read(7, "t", message(samples(40, 2), first=1, session="t"))
    assert other.lost == -1
