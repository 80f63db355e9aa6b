"""A stream of another machine's graph as a source, over NATS JetStream."""

from __future__ import annotations

import json
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
import structlog
from platformdirs import user_state_path

from kinegraph.devices.nats import link as links
from kinegraph.devices.nats.clock import BedClock, ClockMapping
from kinegraph.devices.nats.messages import (
    DAMAGE,
    Position,
    StreamReader,
    differences,
    digest_of,
    spec_text,
    subject,
)
from kinegraph.devices.nats.server import NatsServer, account_of, check_bed
from kinegraph.devices.nats.subscription import Received, Subscription
from kinegraph.stream.chunk import NEVER, NS, Chunk, Specs, StreamSpec, empty
from kinegraph.stream.errors import DeclarationError, DeviceError, ParameterError
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source
from kinegraph.stream.system.atomic_file import private_folder, write_complete

CLOCK = np.dtype([("offset", "<i8"), ("uncertainty", "<i8")])
"""What was added to the bed's stamps to have this machine's, had it been applied, and how far that may be off."""
TURN_S = 0.25
KEPT_S = 1.0
"""How often the position is written down."""
LOOK_S = 2.0

log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class StreamInlet(Source):
    """A stream that another kinegraph publishes with `devices.nats.StreamOutlet`: the same samples, stamps, gaps and watermark.

    out      the stream
    clock    events: this machine's clock minus the bed's (`offset`), and how far that may be off (`uncertainty`); measured every 10 s

    It goes on where it stopped, in order, each sample once: after an outage of the network, the server, this session (`--resume`) or, with
    `start: continue`, a session before. An outage is delay and nothing else: nothing passes for silence, and whoever waits for this stream
    waits. What the server or the bed's spool no longer had is a gap with its count; where the bed's session is another one, a gap of
    unknown size.

    What the stream is must be known before the start, as between nodes: from `spec`, a file that `kinegraph ward spec` writes, or
    from the server, where the bed publishes it; without a server what was found there last counts. A stream that is another is refused.

    Stamps are the bed's. With `stamps: centre` they are moved by the measured offset of the clocks; a new offset is taken over at 1 % of
    the pace of time.
    """

    outputs: ClassVar[tuple[str, ...]] = ("out", "clock")
    continues: ClassVar[bool] = True

    bed: str = param(help="what the other machine is called there")
    stream: str = param(help="what the stream is called at the outlet")
    account: str = param(
        "", help="a server.yaml with the server and the account, as `kinegraph ward` writes it into its folder"
    )
    server: NatsServer = param(NatsServer(), help="the NATS server and the account there, without `account`")
    spec: str = param("", help="a file with the stream's spec as JSON")
    start: Literal["continue", "all", "new"] = param(
        "continue",
        help="a new session goes on where the last one stopped, or takes all that the server has, or only what is new",
    )
    stamps: Literal["bed", "centre"] = param(
        "bed", help="whether stamps stay as they are or are moved to this machine's clock"
    )
    ends: bool = param(False, help="the source ends with the bed's session")
    position: str = param(
        "", help="the folder that remembers how far it read; left out: one in the user's folder of states"
    )

    @property
    def live(self) -> bool:
        return False

    @property
    def at(self) -> NatsServer:
        """The server and the account."""
        return account_of(Path(self.account))[1] if self.account else self.server

    def specs(self) -> Specs:
        check_bed(self.bed)
        if not self.spec:
            self.at.check()
        return {"out": self._declared(), "clock": StreamSpec((), CLOCK, units=("ns", "ns"))}

    @property
    def may_appear(self) -> bool:
        return True

    def missing(self) -> str:
        link = links.shared(self.at, "kinegraph")
        try:
            return (
                "" if link.wait(LOOK_S) else f"NATS server {self.at.url} does not answer ({link.error or 'no reason'})"
            )
        finally:
            links.release(link)

    def read(self, feed: Feed) -> None:
        link = links.shared(self.at, "kinegraph")
        try:
            while not link.wait(TURN_S):
                if feed.stopped:
                    return
            _Reading(self, self._declared(), link, feed).run()
        finally:
            links.release(link)

    # what the stream is --------------------------------------------------------------------------------------------------

    def _declared(self) -> StreamSpec:
        kept = user_state_path("kinegraph") / "specs" / f"{digest_of(self.at.url)}.{self.bed}.{self.stream}.json"
        try:
            if self.spec:
                return StreamSpec.from_json(json.loads(Path(self.spec).read_text(encoding="utf-8")))
        except (OSError, *DAMAGE) as error:
            raise ParameterError("spec", self.spec, f"a file with a stream's spec ({error})") from None
        text = self._asked()
        try:
            if text is not None:
                private_folder(kept.parent)
                write_complete(kept, text)
            return StreamSpec.from_json(json.loads(kept.read_text(encoding="utf-8") if text is None else text))
        except (OSError, *DAMAGE):
            raise DeviceError(
                f"nothing is known of stream {self.stream!r} of bed {self.bed!r} at {self.at.url}; start the bed's graph once,"
                " or name a file with `spec`"
            ) from None

    def _asked(self) -> str | None:
        """The spec as the server has it."""
        link = links.shared(self.at, "kinegraph")
        try:
            if not link.wait(LOOK_S):
                return None
            found = link.call(links.fact(link, f"{self.bed}.facts.spec.{self.stream}"))
            return found.decode() if found else None
        except (OSError, UnicodeDecodeError):
            return None
        finally:
            links.release(link)

    @property
    def place(self) -> Path:
        """The file that remembers how far it has read."""
        folder = Path(self.position) if self.position else user_state_path("kinegraph") / "positions"
        return folder / f"{digest_of(self.at.url)}.{self.bed}.{self.stream}.json"


class _Reading:
    """One opening of the inlet."""

    def __init__(self, of: StreamInlet, spec: StreamSpec, link: links.Link, feed: Feed) -> None:
        self._of, self._spec, self._link, self._feed = of, spec, link, feed
        self._known = {digest_of(spec_text(spec))}
        self._clock = BedClock(link, of.bed, feed.now)
        self._measured = 0
        self._stale = NEVER
        """Up to here the recording goes where the index is of earlier: that counts what is missing once messages were read again."""
        position, created, applied = self._start()
        self._mapping = ClockMapping(applied)
        self._reader = StreamReader(spec, position)
        self._subscription = Subscription(link, subject(of.bed, "data", of.stream), position.sequence, created)
        self._passed: deque[tuple[int, str]] = deque()
        """What the recording may have on its disk soon: when it was emitted, and the position as it is written down."""
        self._written_s = 0.0
        self._error = ""
        self._counted = self._lost_disk = self._noticed = self._repeated = 0

    def _start(self) -> tuple[Position, str, int | None]:
        """Where to begin: the position, in the stream made when, and the offset that was applied."""
        of, until = self._of, self._feed.position("out")
        begins = until == NEVER
        try:
            kept = json.loads(of.place.read_text(encoding="utf-8"))
            created, offset = str(kept.pop("created")), kept.pop("offset")
            position = Position(**kept)
        except (OSError, *DAMAGE):
            created, offset, position = "", None, Position()
        mapped = (offset or 0) if of.stamps == "centre" else 0
        if begins and of.start == "continue" and position.sequence:
            return position, created, offset
        if begins:
            return Position(index=0 if of.start == "all" or not position.sequence else -1), "", offset
        until -= mapped - (self._spec.period_ns // 2 if of.stamps == "centre" else 0)
        if position.until <= until:
            self._stale = until if position.until < until else NEVER
            position.until = until
            return position, created, offset
        self._stale = until
        return Position(until=until), created, offset

    def run(self) -> None:
        feed, of = self._feed, self._of
        if of.start == "new" and feed.position("out") == NEVER:
            self._subscription.from_now()
            self._reader.position.index = -1
        feed.ready()
        feed.identify("kinegraph bed", bed=of.bed, stream=of.stream, server=of.at.url)
        try:
            while not feed.stopped and not (of.ends and self._reader.ended):
                self._clock.ask()
                received = self._subscription.take(TURN_S)
                for one in received:
                    self._take(one)
                self._report()
                self._keep()
        finally:
            self._subscription.close()
            self._keep(last=True)

    def _take(self, one: Received) -> None:
        self._check(one.spec)
        if self._subscription.lost_disk > self._noticed:
            self._noticed = self._subscription.lost_disk
            if (
                NEVER != self._stale == self._reader.position.until
            ):  # nothing was read since: how many are missing is not known
                self._reader.position.index = -1
        try:
            chunks = self._reader.read(one.sequence, one.session, one.body)
        except DAMAGE as error:
            raise DeviceError(
                f"message {one.sequence} of {self._of.bed}.{self._of.stream} is damaged ({error})"
            ) from None
        for chunk in chunks:
            self._feed.emit(self._moved(chunk))
        position = self._reader.position
        facts = {**position.to_json(), "created": self._subscription.created, "offset": self._mapping.applied}
        self._passed.append((self._feed.now(), json.dumps(facts)))

    def _moved(self, chunk: Chunk) -> Chunk:
        if self._of.stamps == "bed":
            return chunk
        target = self._clock.offset.ns if self._clock.offset else None
        offset = self._mapping.move(target, int(chunk.time[0]) if len(chunk) else chunk.until)
        return Chunk(chunk.time + offset, chunk.data, chunk.until + offset, chunk.lost)

    def _check(self, digest: str) -> None:
        """Raises DeclarationError for a stream that is not what the graph was checked with."""
        if digest in self._known:
            return
        of = self._of
        found = self._link.call(links.fact(self._link, f"{of.bed}.facts.spec.{of.stream}"))
        wrong = ["its spec is another"]
        if found and digest_of(found) == digest:
            wrong = differences(self._spec, StreamSpec.from_json(json.loads(found)))
        if wrong:
            raise DeclarationError(
                f"stream {of.stream!r} of bed {of.bed!r} is not what the graph was checked with: {'; '.join(wrong)}; check the graph again"
            )
        log.warning("the stream's facts have changed", bed=of.bed, stream=of.stream)
        self._known.add(digest)

    def _report(self) -> None:
        feed, reader, offset = self._feed, self._reader, self._clock.offset
        if self._subscription.error != self._error:
            self._error = self._subscription.error
            tell = log.warning if self._error else log.info
            tell("NATS stream", bed=self._of.bed, stream=self._of.stream, error=self._error or "no more")
        if reader.discarded > self._counted:
            feed.tell("discarded before it was read", samples=reader.discarded - self._counted, bed=self._of.bed)
            feed.problem("discarded before it was read", reader.discarded - self._counted)
            self._counted = reader.discarded
        if reader.repeated > self._repeated:
            feed.problem("repeated, left out", reader.repeated - self._repeated)
            self._repeated = reader.repeated
        if reader.before:
            feed.tell("a session of the bed begins before the last one ended", samples=reader.before, bed=self._of.bed)
            feed.problem("stamped before the last session's end", reader.before)
            reader.before = 0
        if self._subscription.lost_disk > self._lost_disk:
            feed.problem("the server lost its disk", self._subscription.lost_disk - self._lost_disk)
            self._lost_disk = self._subscription.lost_disk
        now = feed.now()
        if offset and offset.at > self._measured:
            self._measured = offset.at
            feed.device_clock(offset_s=offset.ns / NS, uncertainty_s=offset.uncertainty_ns / NS)
            row = np.array([(offset.ns, offset.uncertainty_ns)], CLOCK)
            feed.emit(Chunk(np.array([now]), row, now), "clock")
        else:
            feed.emit(empty(StreamSpec((), CLOCK), now), "clock")

    def _keep(self, *, last: bool = False) -> None:
        """Write down how far the recording has it on its disk."""
        if not last and time.monotonic() - self._written_s < KEPT_S:
            return
        self._written_s = time.monotonic()
        saved, newest = self._feed.saved(), ""
        while self._passed and self._passed[0][0] <= saved:
            newest = self._passed.popleft()[1]
        if newest:
            try:
                private_folder(self._of.place.parent)
                write_complete(self._of.place, newest)
            except OSError as error:
                log.warning("the position cannot be written", path=str(self._of.place), error=error.strerror)
