"""At the pace of a device: 2000 Hz in 10-sample chunks; how long after a sample was due its result is there, and what it costs."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from bench.engines import EngineError, Field
from bench.report import Goal, Section, short
from bench.work import RATE_HZ
from bench.worker import KERNELS, OWN, RECORDED, SCIPY, SESSION, UNRECORDED

CHUNK = 10


@dataclass(slots=True)
class Entry:
    """One row: latencies in ns since the chunk's last sample was due, and since the chunk was handed out; share of one processor."""

    engine: str
    style: str
    label: str
    due: list[int] = field(default_factory=list)
    made: list[int] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)

    def ms(self, q: float) -> float:
        return float(np.percentile(self.due, q)) / 1e6

    def cpu_times(self, other: Entry) -> float:
        """How many times another's processor time it takes: the median over the rounds, for the machine's speed changes between them."""
        return float(np.median(np.array(self.cpu) / np.array(other.cpu)))

    def made_ms(self, q: float) -> float:
        return float(np.percentile(self.made, q)) / 1e6


def entries() -> list[Entry]:
    return [
        Entry("bare", KERNELS, "bare loop over the same kernels"),
        Entry("bare", RECORDED, "the same, which records what comes in"),
        Entry("bare", SCIPY, "bare loop over scipy"),
        Entry("kinegraph", SESSION, "**kinegraph**, whole session, recorded"),
        Entry("kinegraph", UNRECORDED, "kinegraph, whole session, nothing recorded"),
        Entry("csp", KERNELS, "csp, same kernels"),
        Entry("streamz", KERNELS, "streamz, same kernels"),
        Entry("timeflux", KERNELS, "timeflux, same kernels, bare arrays"),
        Entry("timeflux", OWN, "timeflux, its own nodes"),
        Entry("ezmsg", KERNELS, "ezmsg, same kernels, one process"),
        Entry("ezmsg", OWN, "ezmsg-sigproc's units, one process"),
    ]


def paced(field: Field, rounds: int, seconds: float) -> Section:
    """Every round gives every contender `seconds` of real time, one after the other."""
    taking = entries()
    count = max(20, round(seconds * RATE_HZ / CHUNK))
    for counted in field.rounds(rounds):
        for e in [e for e in taking if e.engine in field.engines]:
            try:
                answer = field.engines[e.engine].ask(
                    style=e.style, chunk=CHUNK, count=count if counted else 20, paced=True, timeout_s=seconds + 60
                )
            except EngineError as error:
                field.drop(e.engine, error)
                continue
            if counted:
                e.due += answer["due_ns"]
                e.made += answer["made_ns"]
                e.cpu.append(answer["cpu"])
    return _section([e for e in taking if e.engine in field.engines], rounds * seconds)


def _section(taking: list[Entry], seconds: float) -> Section:
    by_style = {e.style: e for e in taking if e.engine in ("bare", "kinegraph")}
    bare = by_style[KERNELS]
    section = Section(
        f"Paced: 2000 Hz in 10-sample chunks, {seconds:g} s each; from when a chunk's last sample is due to the sink",
        [
            "",
            "p50, times bare",
            "p99, times bare",
            "CPU, times bare",
            "p50 ms",
            "p99 ms",
            "max ms",
            "since handed out: p50 ms",
            "CPU %",
        ],
    )
    for e in taking:
        ratios = [e.ms(50) / bare.ms(50), e.ms(99) / bare.ms(99), e.cpu_times(bare)]
        times = [e.ms(50), e.ms(99), e.ms(100), e.made_ms(50)]
        section.rows.append([e.label, *map(short, ratios), *map(short, times), short(100 * float(np.median(e.cpu)))])
    session, unrecorded = by_style[SESSION], by_style[UNRECORDED]
    section.goals = [
        Goal("paced p50 latency, a whole session, against the bare loop", session.ms(50) / bare.ms(50), 1.5, "times"),
        Goal("paced p99 latency, a whole session, against the bare loop", session.ms(99) / bare.ms(99), 1.5, "times"),
        Goal("paced CPU, nothing recorded, against the bare loop", unrecorded.cpu_times(bare), 1.5, "times"),
        Goal(
            "paced CPU, recorded, against a bare loop that records", session.cpu_times(by_style[RECORDED]), 1.5, "times"
        ),
    ]
    return section
