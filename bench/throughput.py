"""As fast as it goes: the cost of a message, and of the five-operator chain; rounds interleaved over all contenders."""

from __future__ import annotations

from dataclasses import dataclass, field
from statistics import median

from bench.engines import EngineError, Field
from bench.report import Goal, Section, short
from bench.worker import FED, KERNELS, OWN, PROFILED, SCIPY, SESSION, STAMPED

CHUNKS = (1, 10, 40, 200)
FEW, MANY = 5, 50
MOST = 10_000
"""At most so many chunks make a block."""


@dataclass(slots=True)
class Entry:
    """One row: who does it and how; microseconds per chunk of every round, by what was asked."""

    engine: str
    style: str
    label: str
    rounds: dict[int, list[float]] = field(default_factory=dict)
    hashes: set[str] = field(default_factory=set)

    def us(self, key: int) -> float:
        return median(self.rounds[key])


def chain_entries() -> list[Entry]:
    return [
        Entry("bare", KERNELS, "bare loop over the same kernels"),
        Entry("bare", SCIPY, "bare loop over scipy"),
        Entry("kinegraph", FED, "**kinegraph**, fed as in a replay"),
        Entry("kinegraph", SESSION, "**kinegraph**, whole session, recorded"),
        Entry("csp", PROFILED, "csp, same kernels and stamps, its profiler on"),
        Entry("csp", STAMPED, "csp, same kernels and stamps, no metrics"),
        Entry("csp", KERNELS, "csp, same kernels on bare arrays, no stamps, no metrics"),
        Entry("csp", SCIPY, "csp, scipy in nodes"),
        Entry("streamz", KERNELS, "streamz, same kernels"),
        Entry("streamz", SCIPY, "streamz, scipy in maps"),
        Entry("timeflux", KERNELS, "timeflux, same kernels, bare arrays"),
        Entry("timeflux", OWN, "timeflux, its own nodes"),
        Entry("ezmsg", KERNELS, "ezmsg, same kernels, one process"),
        Entry("ezmsg", OWN, "ezmsg-sigproc's units, one process"),
    ]


def overhead_entries() -> list[Entry]:
    return [
        Entry("kinegraph", FED, "**kinegraph**, fed as in a replay (metrics and recorder on)"),
        Entry("kinegraph", SESSION, "**kinegraph**, whole session, each chunk of the source (metrics and recorder on)"),
        Entry("csp", PROFILED, "csp (its profiler on)"),
        Entry("streamz", KERNELS, "streamz (has no metrics)"),
        Entry("timeflux", KERNELS, "timeflux (has no metrics)"),
        Entry("ezmsg", KERNELS, "ezmsg (its counters on)"),
    ]


def overhead(field: Field, rounds: int, block_s: float) -> Section:
    """Cost of a message: the slope between a few and many identity operators that a user wrote, 10 samples x 16 channels each.

    In a whole session chunks that come in a burst enter as one, and so cost one message together.
    """
    entries = _measure(field, overhead_entries(), [FEW, MANY], rounds, block_s, operators=True)
    slopes = {
        id(e): [(many - few) / (MANY - FEW) for few, many in zip(e.rounds[FEW], e.rounds[MANY], strict=True)]
        for e in entries
    }
    ours = median(slopes[id(entries[0])])
    section = Section(
        f"Cost of a message: the slope between {FEW} and {MANY} identity operators (10 samples x 16 channels)",
        ["", "times kinegraph's", "us, median", "us, worst round"],
    )
    for e in entries:
        us = slopes[id(e)]
        section.rows.append([e.label, short(median(us) / ours), short(median(us)), short(max(us))])
    section.notes = ["In a whole session the chunks of a burst, up to 128, are one message."]
    section.goals = [Goal("cost of a message, fed", ours, 1.0, "us")]
    least = [median(slopes[id(e)]) for e in entries[2:]]
    if least:
        section.goals.append(Goal("cheapest peer's message against ours", min(least) / ours, 1.0, "times", least=True))
    return section


def chain(field: Field, rounds: int, block_s: float) -> Section:
    """The five-operator chain at several chunk sizes."""
    entries = _measure(field, chain_entries(), list(CHUNKS), rounds, block_s, operators=False)
    _hash(field, entries)
    bare = next(e for e in entries if e.engine == "bare" and e.style == KERNELS)
    section = Section(
        "Five operators: 16 channels at 2000 Hz, rectify, low-pass, decimate, moving mean, count",
        ["", "times the bare loop @10", *(f"us/chunk @{n}" for n in CHUNKS), "one answer for all sizes"],
    )
    for e in entries:
        us = [e.us(n) for n in CHUNKS]
        same = "yes" if len(e.hashes) == 1 else f"no, {len(e.hashes)}"
        section.rows.append([e.label, short(e.us(10) / bare.us(10)), *map(short, us), same])
    ours, session = (next(e for e in entries if e.style == style) for style in (FED, SESSION))
    section.goals = [
        Goal("chain at 10 samples, fed, against the bare loop", ours.us(10) / bare.us(10), 3.0, "times"),
        Goal(
            "chain at 10 samples, a whole recorded session, against the bare loop",
            session.us(10) / bare.us(10),
            2.5,
            "times",
        ),
    ]
    others = [e for e in entries if e.engine not in ("bare", "kinegraph")]
    same_work = [e for e in others if (e.engine, e.style) != ("csp", KERNELS)]
    for among, which in ((same_work, "fastest peer"), (others, "fastest peer, also without stamps and metrics,")):
        if among:
            best = min(e.us(n) / ours.us(n) for e in among for n in CHUNKS)
            section.goals.append(Goal(f"{which} against ours, any chunk size", best, 1.0, "times", least=True))
    return section


def every_chunk_size(field: Field, sizes: list[int], total: int) -> Section:
    """One hash of the chain's output for every chunk size, and the same as from the bare loop."""
    hashes = {_digest(field, "kinegraph", FED, size, total) for size in sizes}
    bare = _digest(field, "bare", KERNELS, 10, total)
    section = Section(f"Chunk sizes {sizes[0]} to {sizes[-1]} ({len(sizes)} of them)")
    section.notes = [
        f"The chain's output has {len(hashes)} hash{'es' if len(hashes) != 1 else ''} over all sizes"
        f"{', the bare loop gives the same' if hashes == {bare} else ', the bare loop gives ANOTHER'}."
    ]
    section.goals = [Goal(f"different answers over {len(sizes)} chunk sizes", len(hashes | {bare}), 1, "")]
    return section


def _digest(field: Field, engine: str, style: str, size: int, total: int) -> str:
    answer = field.engines[engine].ask(style=style, chunk=size, count=0, keep=total)
    return str(answer["hash"])


def _measure(
    field: Field, entries: list[Entry], keys: list[int], rounds: int, block_s: float, *, operators: bool
) -> list[Entry]:
    """Microseconds per chunk: every round asks every entry for every key (a chunk size, or a number of operators) in turn."""
    counts: dict[tuple[int, int], int] = {}
    for counted in field.rounds(rounds):
        for key in keys:
            for e in [e for e in entries if e.engine in field.engines]:
                order = {"operators": key, "chunk": 10} if operators else {"chunk": key}
                count = counts[id(e), key] if counted else 200 if operators else 200 + 1600 // key
                try:
                    answer = field.engines[e.engine].ask(style=e.style, count=count, **order)
                except EngineError as error:
                    field.drop(e.engine, error)
                    continue
                us = answer["seconds"] / count * 1e6
                if not counted:  # how many chunks fill a block
                    counts[id(e), key] = int(min(max(block_s * 1e6 / us, 200 if operators else 1000 // key), MOST))
                else:
                    e.rounds.setdefault(key, []).append(us)
    return [e for e in entries if e.engine in field.engines]


def _hash(field: Field, entries: list[Entry], total: int = 8000) -> None:
    """Whether an entry's answer depends on the chunks."""
    for e in entries:
        e.hashes = {_digest(field, e.engine, e.style, size, total) for size in CHUNKS}
