"""Beds and a centre over one NATS server: a ledger of every sample under faults, how long an event takes, what a bed costs.

    python -m bench.machines                 ledger of 20 beds and 2 simulated minutes; latency and cost of 20, 60 and 120 beds
    python -m bench.machines --beds 200 --hours 24     the nightly ledger alone

The ledger: what beds offered = what the centre received + what was discarded, by its reason. Nothing lost silently, nothing twice, in
order. Stamps are sample time; what a bed sends goes as fast as the machine allows, and faults come at random between two rounds.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import random
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from kinegraph.devices.nats import StreamInlet, StreamOutlet, sender
from kinegraph.devices.nats import link as links
from kinegraph.devices.nats.link import Link, make_streams
from kinegraph.devices.nats.local_server import LocalServer
from kinegraph.devices.nats.messages import spec_text
from kinegraph.devices.nats.server import NatsServer
from kinegraph.devices.ward.centre import Centre as WardCentre
from kinegraph.stream.chunk import FOREVER, NEVER, NS, Array, Chunk, StreamSpec
from tests.support.mosquitto import free_port

START = 1_767_000_000 * NS
EPOCH = StreamSpec((), np.dtype([("number", "<i8"), ("state", "U7")]), units=("",))
"""One event every `STEP_NS`: as a bed's epochs, or its events, in which the number is what the ledger follows."""
PATIENCE_S = 120.0


def epochs(first: int, n: int, step_ns: int) -> Chunk:
    index = np.arange(first, first + n)
    data = np.empty(n, EPOCH.dtype)
    data["number"], data["state"] = index, "sleep"
    time = START + index * step_ns
    return Chunk(time, data, int(time[-1]))


class Bed:
    """A bed's outlet as a session drives it: checkpoints, crashes, and what follows the checkpoint once more, cut otherwise."""

    def __init__(
        self,
        name: str,
        server: LocalServer,
        folder: Path,
        step_ns: int,
        *,
        frame: StreamSpec | None = None,
        **given: Any,
    ) -> None:
        self.name, self.server, self.folder, self.step_ns, self.given = name, server, folder, step_ns, given
        self.specs = {"x": EPOCH} | ({"depth": frame} if frame else {})
        self.offered = 0
        self.dropped = 0
        self._at = 0
        self._kept: dict[str, Array] = {}
        self.outlet = self._made()
        self.outlet.begin()
        self.checkpoint()

    def _made(self) -> StreamOutlet:
        made = StreamOutlet(bed=self.name, server=NatsServer(self.server.url), spool=str(self.folder), **self.given)
        made.open(dict(self.specs))
        made.runtime.now = time.time_ns
        return made

    def feed(self, n: int) -> None:
        self.outlet.process("x", epochs(self.offered, n, self.step_ns))
        self.offered += n

    def checkpoint(self) -> None:
        self._kept, self._at = self.outlet.snapshot(), self.offered

    def crash(self, rng: random.Random) -> None:
        """The process is gone with all that was in memory; a new one goes on from the checkpoint."""
        vanish(self.outlet)
        self.outlet = self._made()
        self.outlet.restore(self._kept)
        self.outlet.begin()
        self.repeat(rng)

    def repeat(self, rng: random.Random) -> None:
        """What followed the checkpoint, once more."""
        at = self._at
        while at < self.offered:
            n = min(rng.randint(1, 40), self.offered - at)
            self.outlet.process("x", epochs(at, n, self.step_ns))
            at += n

    @property
    def waiting(self) -> int:
        runtime = self.outlet.runtime
        with runtime.lock:
            gathered = any(one._builder is not None for one in runtime.gatherings.values())
        return (runtime.sender.waiting if runtime.sender else 0) + gathered


def vanish(made: StreamOutlet) -> None:
    """As a killed process does: what is in memory is gone."""
    runtime = made.runtime
    assert runtime.sender and runtime.link
    one = runtime.sender
    one._stop.set()
    one._thread.join()
    one._spool.close()
    links.release(runtime.link)
    runtime.sender = runtime.link = None


@dataclass
class Feed:
    """The centre's side of one bed: what its input log holds."""

    numbers: list[int] = field(default_factory=list)
    ends: list[tuple[int, int]] = field(default_factory=list)
    """After each chunk: how many samples there are, and its `until`."""
    lost: int = 0
    unknown: int = 0
    problems: Counter[str] = field(default_factory=Counter)
    arrived: Callable[[Chunk], None] = lambda chunk: None
    again = False
    losses: list[tuple[int, int]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._stop = threading.Event()

    def emit(self, chunk: Chunk, output: str = "out") -> None:
        if output != "out" or self._stop.is_set():
            return
        if chunk.lost:
            self.losses.append((len(self.numbers), chunk.lost))
        self.numbers.extend(chunk.data["number"].tolist())
        self.ends.append((len(self.numbers), chunk.until))
        self.arrived(chunk)

    def position(self, output: str = "out") -> int:
        return self.ends[-1][1] if self.ends else NEVER

    def crash(self, rng: random.Random) -> None:
        """The last chunks had not come to the disk."""
        keep = max(0, len(self.ends) - rng.randint(0, 5))
        self.ends = self.ends[:keep]
        n = self.ends[-1][0] if self.ends else 0
        del self.numbers[n:]
        self.losses = [one for one in self.losses if one[0] < n]
        self._stop = threading.Event()

    def stop(self) -> None:
        self._stop.set()

    @property
    def stopped(self) -> bool:
        return self._stop.is_set()

    def wait(self, seconds: float) -> bool:
        return self._stop.wait(seconds)

    def now(self) -> int:
        return time.time_ns()

    def saved(self) -> int:
        return FOREVER

    def ready(self) -> None: ...
    def listen(self, timeout_s: float) -> None: ...
    def identify(self, device: str, **facts: object) -> None: ...
    def tell(self, kind: str, **facts: object) -> None: ...
    def device_clock(self, **facts: float) -> None: ...
    def problem(self, kind: str, count: int = 1) -> None:
        self.problems[kind] += count


class Centre:
    """An inlet for each bed, in one process."""

    def __init__(self, server: LocalServer, folder: Path, beds: list[str]) -> None:
        self.server, self.folder = server, folder
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "x.json").write_text(spec_text(EPOCH))
        self.feeds = {bed: Feed() for bed in beds}
        self._threads: list[threading.Thread] = []
        self._depth: dict[str, Frames] = {}

    def start(self, depth: dict[str, Frames] | None = None) -> None:
        self._depth = depth or {}
        self._threads = [
            threading.Thread(target=self._read, args=(bed, feed, stream), daemon=True)
            for stream, feeds in (("x", self.feeds), ("depth", self._depth))
            for bed, feed in feeds.items()
        ]
        for thread in self._threads:
            thread.start()

    def _read(self, bed: str, feed: Feed, stream: str) -> None:
        StreamInlet(
            bed=bed,
            stream=stream,
            server=NatsServer(self.server.url),
            spec=str(self.folder / f"{stream}.json"),
            start="all",
            position=str(self.folder),
        ).read(feed)

    def stop(self) -> None:
        for feed in (*self.feeds.values(), *self._depth.values()):
            feed.stop()
        for thread in self._threads:
            thread.join()

    def crash(self, rng: random.Random) -> None:
        self.stop()
        for feed in self.feeds.values():
            feed.crash(rng)
        self.start()


@dataclass
class Ledger:
    """What became of every sample.

    silently   missing without a gap that says so
    twice      more than once
    """

    offered: int = 0
    received: int = 0
    discarded: Counter[str] = field(default_factory=Counter)
    silently: int = 0
    twice: int = 0
    in_order: bool = True
    repeated: int = 0
    faults: Counter[str] = field(default_factory=Counter)

    @property
    def balances(self) -> bool:
        total = self.received + sum(self.discarded.values())
        return self.offered == total and not self.silently and not self.twice and self.in_order

    def book(self, bed: Bed, feed: Feed) -> None:
        numbers = feed.numbers
        self.offered += bed.offered
        self.received += len(set(numbers))
        self.twice += len(numbers) - len(set(numbers))
        self.in_order &= all(a < b for a, b in pairwise(numbers))
        gaps = dict(feed.losses)
        before = -1
        for at, number in enumerate([*numbers, bed.offered]):
            missing = number - before - 1
            named = gaps.get(at, 0)
            reason = "the server lost its disk" if feed.problems["the server lost its disk"] else "the spool was full"
            if missing and (named == missing or named == -1):
                self.discarded[reason] += missing
            elif missing:
                self.silently += missing
            before = number
        self.repeated += feed.problems["repeated, left out"]

    def __str__(self) -> str:
        named = ", ".join(f"{n} {why}" for why, n in self.discarded.items()) or "0"
        faults = ", ".join(f"{n} {what}" for what, n in sorted(self.faults.items()))
        return (
            f"offered {self.offered} = received {self.received} + discarded {named}; lost silently {self.silently}, twice {self.twice}, "
            f"in order {self.in_order}; {self.repeated} second copies left out; faults: {faults}"
        )


FAULTS = ("bed", "bed", "bed", "centre", "server", "partition", "duplicates", "refusing", "disk")


def ledger(
    beds: int,
    seconds: float,
    folder: Path,
    *,
    seed: int = 1,
    rounds: int = 24,
    faults: int = 12,
    step_s: float = 0.5,
    spool_mb: float = 100.0,
) -> Ledger:
    """Run `seconds` of sample time in `rounds`, with so many faults between them."""
    rng, found = random.Random(seed), Ledger()
    server = LocalServer(folder / "server", free_port()).start()
    step_ns = round(step_s * NS)
    with quick(), linked(server) as link:
        link.call(make_streams(link))
        names = [f"bed{k}" for k in range(beds)]
        ward = [Bed(name, server, folder / "spool", step_ns, spool_mb=spool_mb) for name in names]
        centre = Centre(server, folder / "centre", names)
        centre.start()
        each = max(1, round(seconds / step_s / rounds))
        due = sorted(rng.sample(range(1, rounds), min(faults, rounds - 1)))
        kinds = [*FAULTS[: len(due)], *(rng.choice(FAULTS[:-1]) for _ in range(len(due) - len(FAULTS)))]
        rng.shuffle(kinds)
        for k in range(rounds):
            if k in due:
                kind = kinds.pop()
                found.faults[kind] += 1
                fault(kind, server, link, ward, centre, rng, outage(rng, seconds / rounds, step_s))
            for bed in ward:
                bed.feed(each)
                if rng.random() < 0.3:
                    bed.checkpoint()
        for bed in ward:
            bed.feed(1)
        until = time.monotonic() + PATIENCE_S
        while time.monotonic() < until and any(
            bed.waiting or centre.feeds[bed.name].numbers[-1:] != [bed.offered - 1] for bed in ward
        ):
            time.sleep(0.02)
        centre.stop()
        for bed in ward:
            bed.outlet.close()
            found.book(bed, centre.feeds[bed.name])
    server.stop()
    return found


def outage(rng: random.Random, round_s: float, step_s: float) -> int:
    """For how many events an outage lasts: 1 s to four rounds, an hour at most; short ones are as frequent as long ones."""
    longest_s = min(3600.0, 4 * round_s)
    return max(1, round(math.pow(longest_s, rng.random()) / step_s))


def fault(
    kind: str, server: LocalServer, link: Link, ward: list[Bed], centre: Centre, rng: random.Random, events: int
) -> None:
    """One fault, during which the beds go on with so many events."""
    some = rng.sample(ward, max(1, len(ward) // 4))

    def go_on(times: int) -> None:
        for _ in range(times):
            for bed in ward:
                bed.feed(1)

    if kind == "bed":
        for bed in some:
            bed.crash(rng)
    elif kind == "centre":
        centre.crash(rng)
    elif kind == "duplicates":
        for bed in some:
            bed.repeat(rng)
    elif kind in ("server", "disk"):
        server.kill()
        go_on(events)
        if kind == "disk":
            server.lose_disk()
        server.start()
    elif kind == "partition":
        server.pause()
        go_on(events)
        time.sleep(rng.uniform(0.1, 0.5))
        server.resume()
    elif kind == "refusing":  # as a full disk: the server takes no more
        limit(link, 1)
        go_on(events)
        time.sleep(0.3)
        limit(link, -1)


def limit(link: Link, most_messages: int) -> None:
    """Have the server refuse messages beyond so many, or none."""
    from nats.js.api import DiscardPolicy

    from kinegraph.devices.nats.messages import DATA

    async def change() -> None:
        info = await link.stream.stream_info(DATA)
        config = info.config
        config.discard = DiscardPolicy.NEW if most_messages > 0 else DiscardPolicy.OLD
        config.max_msgs = max(info.state.messages, 1) if most_messages > 0 else -1
        await link.stream.update_stream(config)

    assert link.wait(20)
    until = time.monotonic() + PATIENCE_S
    while True:
        try:
            link.call(change(), 10)
            return
        except OSError:  # its disk was lost, and the stream is not made again yet
            if time.monotonic() > until:
                raise
            time.sleep(0.05)


@contextmanager
def linked(server: LocalServer) -> Iterator[Link]:
    link = Link(NatsServer(server.url), "bench")
    try:
        assert link.wait(20)
        yield link
    finally:
        link.close()


@contextmanager
def quick() -> Iterator[None]:
    """Beds that share a process look for work less often, and so many threads leave one another alone."""
    before, sender.TICK_S = sender.TICK_S, 0.1
    try:
        yield
    finally:
        sender.TICK_S = before


# how long an event takes, what a bed costs ----------------------------------------------------------------------------


def latency(
    beds: int, seconds: float, folder: Path, *, depth: int = 0, frame: StreamSpec | None = None
) -> dict[str, float]:
    """Events at one a second and bed, in real time, of which `depth` beds also send 2 frames a second: p50 and p99 (s) from the outlet to
    the centre's input and to the page, and what the centre costs. Beds are a process of their own, as the server is."""
    server = LocalServer(folder / "server", free_port()).start()
    took: list[float] = []
    n, frame = round(seconds), frame or BLOCKS
    with quick(), linked(server) as link:
        link.call(make_streams(link))
        names = [f"bed{k}" for k in range(beds)]
        context = multiprocessing.get_context("spawn")
        sent = context.RawArray("d", beds * n)
        there = context.Process(
            target=_beds_in_real_time, args=(server.port, folder, beds, depth, frame.to_json(), n, sent)
        )
        centre = Centre(server, folder / "centre", names)
        (folder / "centre" / "depth.json").write_text(spec_text(frame))
        frames = [Frames() for _ in range(depth)]
        for k, feed in enumerate(centre.feeds.values()):
            feed.arrived = _timed(k * n, sent, took)
        centre.start(dict(zip(names, frames, strict=False)))
        shown = Shown(server, folder, {name: k * n for k, name in enumerate(names)}, sent)
        there.start()
        while not sent[0]:
            time.sleep(0.05)
        processes = [
            psutil.Process(),
            psutil.Process(there.pid),
            psutil.Process(server._process.pid if server._process else 0),
        ]
        cpu, began = [sum(one.cpu_times()[:2]) for one in processes], time.monotonic()
        time.sleep(seconds)
        lasted = time.monotonic() - began
        cpu = [100 * (sum(one.cpu_times()[:2]) - before) / lasted for one, before in zip(processes, cpu, strict=True)]
        there.join()
        time.sleep(2.0)
        centre.stop()
        shown.stop()
    server.stop()
    page = np.percentile(shown.took, [50, 99]) if shown.took else (np.nan, np.nan)
    centres = np.percentile(took, [50, 99]) if took else (np.nan, np.nan)
    return {
        "beds": beds,
        "with_depth": depth,
        "missing": beds * n - len(took),
        "missing_frames": depth * 2 * n - sum(one.count for one in frames),
        **{name: round(float(value), 2) for name, value in zip(("p50_s", "p99_s"), centres, strict=True)},
        **{name: round(float(value), 2) for name, value in zip(("page_p50_s", "page_p99_s"), page, strict=True)},
        **{
            f"cpu_percent_{name}": round(value, 1)
            for name, value in zip(("centre", "beds", "server"), cpu, strict=True)
        },
    }


BLOCKS = StreamSpec((50, 80), rate_hz=2.0, units=("mm",))
"""Depth of 640 x 400 as blocks of 8 x 8 pixels: what is simplified."""
SIMPLIFIED = StreamSpec((400, 640), dtype=np.dtype("<u2"), rate_hz=2.0, units=("mm",))
"""The same as a picture with all its pixels."""


def _beds_in_real_time(
    port: int, folder: Path, beds: int, depth: int, frame: dict[str, Any], n: int, sent: Any
) -> None:
    """Beds as one process: an event a second each, at times spread over the second; two frames a second of the first `depth`."""
    server, spec = LocalServer(folder / "server", port), StreamSpec.from_json(frame)
    levels = np.random.default_rng(1).normal(2000, 300, (50, 80))
    picture = np.kron(levels, np.ones((spec.shape[0] // 50, spec.shape[1] // 80))).astype(spec.dtype)
    with quick():
        ward = [Bed(f"bed{k}", server, folder / "spool", NS, frame=spec if k < depth else None) for k in range(beds)]
        began = time.monotonic() + 1.0
        for k in range(n):
            for j, bed in enumerate(ward):
                time.sleep(max(0.0, began + k + j / beds - time.monotonic()))
                sent[j * n + k] = time.monotonic()
                bed.feed(1)
                if j < depth:
                    time_ns = START + (2 * k + np.arange(2)) * NS // 2
                    bed.outlet.process("depth", Chunk(time_ns, np.stack([picture, picture]), int(time_ns[-1])))
        for bed in ward:
            bed.outlet.close()


@dataclass
class Frames(Feed):
    """The centre's side of a bed's depth."""

    count: int = 0

    def emit(self, chunk: Chunk, output: str = "out") -> None:
        if output == "out" and not self._stop.is_set():
            self.count += len(chunk)
            self.ends.append((self.count, chunk.until))


class Shown(threading.Thread):
    """What the ward's page is given every half second, as a browser asks for it; `took`: from the event until it is there."""

    def __init__(self, server: LocalServer, folder: Path, first: dict[str, int], sent: Any) -> None:
        super().__init__(daemon=True)
        self._ward, self._first, self._sent = WardCentre(folder / "ward", NatsServer(server.url)), first, sent
        self._known: dict[str, int] = {}
        self._over = threading.Event()
        self.took: list[float] = []
        self._ward.start()
        self.start()

    def run(self) -> None:
        while not self._over.wait(0.5):
            rows = json.loads(json.dumps(self._ward.state()))["beds"]
            now = time.monotonic()
            for row in rows:
                newest = row["streams"].get("x", {}).get("row", {}).get("number", -1)
                for number in range(self._known.get(row["bed"], -1) + 1, newest + 1):
                    self.took.append(now - self._sent[self._first[row["bed"]] + number])
                self._known[row["bed"]] = newest

    def stop(self) -> None:
        self._over.set()
        self.join()
        self._ward.stop()


def _timed(first: int, sent: Any, took: list[float]) -> Callable[[Chunk], None]:
    def arrived(chunk: Chunk) -> None:
        now = time.monotonic()
        took.extend(now - sent[first + n] for n in chunk.data["number"].tolist())

    return arrived


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--beds", type=int, default=20)
    parser.add_argument("--hours", type=float, default=0.0)
    parser.add_argument("--latency", type=int, nargs="*", default=[20, 60, 120])
    parser.add_argument("--seconds", type=float, default=20.0, help="of latency")
    parser.add_argument("--depth", type=int, default=0, help="so many of the beds also send 2 frames a second")
    parser.add_argument("--pictures", action="store_true", help="frames of 640 x 400 pixels rather than 80 x 50 blocks")
    parser.add_argument("--no-ledger", action="store_true")
    asked = parser.parse_args()
    if not asked.no_ledger:
        with tempfile.TemporaryDirectory() as folder:
            began = time.monotonic()
            if asked.hours:
                found = ledger(asked.beds, asked.hours * 3600, Path(folder), rounds=96, faults=48, step_s=30.0)
            else:
                found = ledger(asked.beds, 120.0, Path(folder))
            print(f"{asked.beds} beds, {time.monotonic() - began:.0f} s: {found}")
            assert found.balances
    if not asked.hours:
        for beds in asked.latency:
            with tempfile.TemporaryDirectory() as folder:
                print(
                    latency(
                        beds,
                        asked.seconds,
                        Path(folder),
                        depth=min(asked.depth, beds),
                        frame=SIMPLIFIED if asked.pictures else None,
                    )
                )


if __name__ == "__main__":
    main()
