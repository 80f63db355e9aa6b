"""`kinegraph sleep check`: a minute out of bed, a minute in it for each sleeper, and whether a night can be seen like that."""

from __future__ import annotations

import struct
import sys
from contextlib import nullcontext
from itertools import accumulate
from pathlib import Path
from time import monotonic, sleep
from typing import Annotated, Any

import numpy as np
import typer

from kinegraph.operators.bed.breath_watch import CONFIDENT, STILL_MM_S
from kinegraph.operators.bed.setup.graph import SetupGraph
from kinegraph.operators.bed.setup.judgement import BedFinding
from kinegraph.stream.chunk import FOREVER, NEVER, NS, Chunk
from kinegraph.stream.cli.commands.json_option import AsJson, print_json
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.text.safe_text import say

BREATH_S = 30.0
LOOK_S, MOST_COLUMNS = 0.2, 160


def check(
    config: Annotated[Path, typer.Argument(help="the graph, such as bedside.yaml", metavar="CONFIG")],
    settings: Annotated[list[str] | None, typer.Option("--set", metavar="NODE.PARAMETER=VALUE")] = None,
    out_s: Annotated[float, typer.Option("--out", min=10.0, help="how long to stay out of bed, in s")] = 60.0,
    between_s: Annotated[float, typer.Option("--between", min=0.0, help="how long lying down may take, in s")] = 30.0,
    in_s: Annotated[float, typer.Option("--in", min=10.0, help="how long to lie still, in s")] = 60.0,
    simulate: Annotated[
        bool, typer.Option("--simulate", help="a simulated camera in the place of the real one")
    ] = False,
    look: Annotated[
        bool,
        typer.Option(
            "--look", help="for a screen: write thinned frames to standard output until it is closed, and judge nothing"
        ),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Set up a camera over a bed: whether the region holds, noise, light, breath, and where to go on.

    Stay out of bed for a minute, lie down, and lie still for a minute.

    Several sleepers lie down one after the other, in the order of their names; anyone whom their region does not hold learns where it is.

    Nothing is stored. Exit codes: 0 all is well; 2 something is not, or the graph is wrong; 3 the camera is missing.
    """
    from kinegraph.operators.bed.setup.graph import small
    from kinegraph.stream.cli.commands import logs
    from kinegraph.stream.cli.commands.run import simulated

    logs.set_up(json=False, verbose=False)
    made = small(config, settings or [])
    if look:
        with simulated(made.graph) if simulate else nullcontext():
            Preview(_seeing(made).graph).run()
        return
    findings = looked(made, out_s, between_s, in_s, simulate=simulate, quiet=as_json)
    notes = [broker_note(host, port) for host, port in made.brokers] if not simulate else []
    if as_json:
        print_json({"findings": findings, "notes": notes})
    if not all(finding.well for finding in findings):
        raise KinegraphError("the night would not be recorded properly; correct this, and check again")
    if not as_json:
        for note in [*notes, f"next: kinegraph run {config}, or the service of docs/use/bedside.md"]:
            say(note)


def looked(
    made: SetupGraph, out_s: float, between_s: float, in_s: float, *, simulate: bool, quiet: bool = False
) -> list[BedFinding]:
    """The minutes out of bed and in it, and what they show; printed unless `quiet`."""
    from kinegraph.operators.bed.setup.judgement import judge
    from kinegraph.stream.cli.commands.run import simulated

    with simulated(made.graph) if simulate else nullcontext():
        looks = Looks(_seeing(made).graph, out_s, between_s, in_s, quiet=quiet)
        looks.run()
    stays = dict(zip(looks.sleepers, looks.minutes[1:], strict=True))
    findings = judge(looks.minutes[0], stays, looks.regions, looks.block, made.rise_mm, made.min_share)
    findings += [found for name in looks.sleepers if (found := looks.breath(name)) is not None]
    findings += [BedFinding(False, f"the camera says: {problem}") for problem in looks.problems]
    for finding in findings if not quiet else ():
        say(f"{'well' if finding.well else 'NOT WELL'}: {finding.text}")
    return findings


def _seeing(made: SetupGraph) -> SetupGraph:
    """Raises KinegraphError where its camera sees nothing at night."""
    camera: Any = made.graph.nodes["camera"].part
    if complaint := getattr(camera, "blind_at_night", ""):
        raise KinegraphError(f"node 'camera': {complaint}")
    return made


def broker_note(host: str, port: int) -> str:
    """Whether anything answers where the graph publishes."""
    import socket

    try:
        with socket.create_connection((host, port), timeout=2.0):
            return f"well: something answers at {host}:{port}, where the broker should be"
    except OSError as error:
        return f"note: no broker answers at {host}:{port} ({error.strerror or error}): no live states, the rest works"


class Looks:
    """A feed that hands the camera's frames straight to the operators, tells people what to do, and keeps each one's minute."""

    again = False

    def __init__(self, graph: Any, out_s: float, between_s: float, in_s: float, *, quiet: bool = False) -> None:
        from kinegraph.operators.bed.breath_cells import BreathCells
        from kinegraph.operators.bed.setup.judgement import Minute
        from kinegraph.stream.engine.pipeline import Pipeline
        from kinegraph.stream.system.clock import SessionClock

        self.graph, self.pipeline, self._clock = graph, Pipeline(graph), SessionClock()
        self.stopped = False
        self.sleepers: tuple[str, ...] = graph.nodes["bed"].part.sleepers
        self.regions: dict[str, tuple[int, int, int, int]] = {}
        self.problems: list[str] = []
        blocks = self.pipeline.stages["simplify"].edges["blocks"]
        self.block = int(blocks.spec.meta["simplified"]["block"])
        self.minutes = [Minute.of(blocks.spec.shape) for _ in range(1 + len(self.sleepers))]
        """Out of bed, then each in bed, beside those before."""
        lengths, words = [out_s], [f"stay out of bed for {out_s:g} s, and out of the camera's way"]
        for name in self.sleepers:
            who = f"{name}: " if len(self.sleepers) > 1 else ""
            lengths += [between_s, in_s]
            words += [f"{who}lie down as you sleep; you have {between_s:g} s", f"{who}lie still for {in_s:g} s"]
        self._ends, self._words = [round(s * NS) for s in accumulate(lengths)], words
        self._said, self._begun, self._quiet = -1, -1, quiet
        self._cells = [
            BreathCells.of(blocks.spec.shape, blocks.spec.rate_hz or 1.0, BREATH_S, 0, STILL_MM_S)
            for _ in self.sleepers
        ]
        self._lay = [0] * len(self.sleepers)
        """When each was last seen lying still (ns); 0: never."""
        blocks.observers.append(self._blocks)
        self.pipeline.stages["view"].edges["out"].observers.append(self._views)
        self.pipeline.stages["bed"].edges["out"].observers.append(self._bed)

    def run(self) -> None:
        camera = self.graph.nodes["camera"].part.unopened()
        camera.prepare()
        camera.read(self)

    def _phase(self, time: int) -> int:
        """0: out of bed, 1: the first lies down, 2: is in bed, 3: the second lies down, ...; as many as there are words: over."""
        if self._begun < 0:
            self._begun = time
        phase = sum(time - self._begun >= end for end in self._ends)
        while self._said < min(phase, len(self._words) - 1):
            self._said += 1
            say(self._words[self._said], err=self._quiet)
        self.stopped = phase == len(self._words)
        return phase

    def _blocks(self, chunk: Chunk) -> None:
        for time, frame in zip(chunk.time.tolist(), chunk.data, strict=True):
            phase = self._phase(time)
            if phase % 2 == 0 and not self.stopped:
                self.minutes[phase // 2].add(np.asarray(frame))
                if phase:
                    self._cells[phase // 2 - 1].add(np.asarray(frame, np.float64), time)
                    self._lay[phase // 2 - 1] = time

    def _views(self, chunk: Chunk) -> None:
        for event in chunk.data:
            stay = min((self._phase(int(event["onset"])) + 1) // 2, len(self.sleepers))
            self.minutes[stay].views.append(str(event["what"]))

    def _bed(self, chunk: Chunk) -> None:
        if self._said > 0:
            return  # a bed that is found with somebody in it is not the empty one
        for e in chunk.data:
            row, column, rows, columns = (int(e[name]) // self.block for name in ("row", "column", "rows", "columns"))
            if rows:
                self.regions[str(e["sleeper"])] = row, column, max(1, rows), max(1, columns)

    def breath(self, sleeper: str) -> BedFinding | None:
        """Whether this sleeper's breath was seen in the last half minute of lying still; None: the region is not known."""
        k = self.sleepers.index(sleeper)
        region = self.regions.get(sleeper)
        if region is None or not self._lay[k]:
            return None
        (found,) = self._cells[k].breaths(self._lay[k] - round(BREATH_S * NS), np.array([region], np.int64))
        who = f" ({sleeper})" if len(self.sleepers) > 1 else ""
        if found.moved:
            return BedFinding(True, f"breath{who} was not looked for: something moved in the last half minute")
        if found.confidence >= CONFIDENT:
            return BedFinding(True, f"breath is seen{who}: {found.rate:.1f} per minute")
        return BedFinding(
            False, f"no breath is seen{who}: come nearer, choose a lighter blanket, or a camera with less noise"
        )

    # what a source needs of a feed
    def emit(self, chunk: Chunk, output: str = "out") -> None:
        stream = f"camera.{output}"
        if not self.stopped:
            self.pipeline.feed(stream, chunk)

    def now(self) -> int:
        return self._clock.now()

    def wait(self, seconds: float) -> bool:
        sleep(0.0 if self.stopped else seconds)
        return self.stopped

    def ready(self) -> None: ...

    def listen(self, timeout_s: float) -> str | None:
        return None

    def identify(self, device: str, **facts: str | float) -> None: ...

    def problem(self, kind: str, count: int = 1) -> None:
        if kind.startswith("no ") and kind not in self.problems:
            self.problems.append(kind)

    def tell(self, kind: str, **facts: str | float) -> None: ...

    def device_clock(self, **facts: float) -> None: ...

    def position(self, output: str = "out") -> int:
        return NEVER

    def saved(self) -> int:
        return FOREVER


class Preview(Looks):
    """A feed that writes the camera's frames to standard output, thinned, a few in a second: sides and step, 4 bytes each, then uint16 mm.

    A camera that is simulated faster than time is held back to it.
    """

    def __init__(self, graph: Any) -> None:
        super().__init__(graph, 1.0, 1.0, 1.0, quiet=True)
        source = self.graph.nodes["simplify"].inputs["in"]
        self._stream, self._first, self._next_s, self._began_s = str(source), -1, 0.0, 0.0

    def emit(self, chunk: Chunk, output: str = "out") -> None:
        if f"camera.{output}" != self._stream or not len(chunk.time) or self.stopped:
            return
        now_s = monotonic()
        if self._first < 0:
            self._first, self._began_s = int(chunk.time[0]), now_s
        ahead_s = (int(chunk.time[-1]) - self._first) / NS - (now_s - self._began_s)
        if ahead_s > 0:
            sleep(min(ahead_s, LOOK_S))
        if monotonic() < self._next_s:
            return
        self._next_s = monotonic() + LOOK_S
        frame = np.asarray(chunk.data[-1])
        step = max(1, -(-frame.shape[1] // MOST_COLUMNS))
        thin = np.ascontiguousarray(frame[::step, ::step], "<u2")
        try:
            sys.stdout.buffer.write(struct.pack("<3I", *thin.shape, step) + thin.tobytes())
            sys.stdout.buffer.flush()
        except OSError:  # who looked has left
            self.stopped = True
