"""How samples may arrive: cut into chunks anywhere, empty ones among them, each `until` anywhere it may be, the inputs in any turn."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import cycle
from typing import TypeAlias

from kinegraph.stream.chunk import FOREVER, NS, Chunk, empty
from kinegraph.stream.laws.case_samples import CaseSamples, Draw, Tapes, span

Delivery: TypeAlias = list[tuple[str, Chunk]]
"""Chunks, each with its port, in the order in which they arrive."""


def whole(tapes: Tapes) -> Delivery:
    """As few chunks as the gaps allow, one input after the other; then the streams end."""
    return anyhow(lambda least, most: least, tapes)


def anyhow(draw: Draw, tapes: Tapes) -> Delivery:
    """Any cutting and any turns that respect each input's own order; then the streams end."""
    _, horizon = span(tapes)
    waiting = {port: list(_chunks(draw, tape, horizon)) for port, tape in tapes.items()}
    turns = cycle([draw(0, len(tapes) - 1) for _ in range(5 if len(tapes) > 1 else 1)])
    order: Delivery = []
    while waiting := {port: chunks for port, chunks in waiting.items() if chunks}:
        port = list(waiting)[next(turns) % len(waiting)]
        order.append((port, waiting[port].pop(0)))
    return order


def _chunks(draw: Draw, tape: CaseSamples, horizon: int) -> Iterator[Chunk]:
    """One input's chunks. `horizon`: up to where all inputs are complete before they end."""
    gaps = [k for k in range(len(tape)) if tape.lost[k]]
    cuts = sorted([*gaps, *_places(draw, len(tape)), *(k for k in gaps for _ in range(draw(0, 1)))])
    slack = cycle([draw(0, 2) for _ in range(3)])
    promised = (int(tape.time[0]) if len(tape) else horizon) - 2 * NS
    ends_at_once = bool(draw(0, 1))
    for start, stop in zip([0, *cuts], [*cuts, len(tape)], strict=True):
        most = int(tape.time[stop]) - 1 if stop < len(tape) else horizon
        least = max(promised, min(int(tape.time[stop - 1]), most)) if stop > start else min(promised, most)
        promised = max(promised, least + (most - least) * next(slack) // 2)
        lost = int(tape.lost[start]) if stop > start else 0
        if stop == len(tape):
            promised = FOREVER if ends_at_once else horizon
        yield Chunk(tape.time[start:stop], tape.data[start:stop], promised, lost)
    yield empty(tape.spec, FOREVER)


def _places(draw: Draw, n: int) -> list[int]:
    """Where to cut: nowhere, anywhere (twice at the same place: an empty chunk), each sample of a stretch, or at even steps."""
    kind = draw(0, 3)
    if kind == 0 or n == 0:
        return []
    if kind == 3:
        size = draw(1, 40)
        return list(range(size, n, max(size, n // 400)))
    places = [draw(0, n) for _ in range(draw(0, 8))]
    if kind == 2:
        start = draw(0, n - 1)
        places += range(start, min(n, start + draw(1, 60)))
    return places


def steps(tapes: Tapes, size: int, whole_until: int = 0, *, ends: bool = True) -> Delivery:
    """Chunks of `size` samples, promptly, in order of time; but the first `whole_until` samples of each input at once."""
    _, horizon = span(tapes)
    order: Delivery = []
    entries: list[tuple[int, int, str, Chunk]] = []
    for rank, (port, tape) in enumerate(tapes.items()):
        order.append((port, empty(tape.spec, int(tape.time[0]) - 1 if len(tape) else horizon)))
        gaps = [k for k in range(len(tape)) if tape.lost[k]]
        cuts = sorted({*gaps, *range(min(whole_until, len(tape)), len(tape), size)} - {0})
        for start, stop in zip([0, *cuts], [*cuts, len(tape)], strict=True):
            if stop > start:
                until = int(tape.time[stop]) - 1 if stop < len(tape) else horizon
                chunk = Chunk(tape.time[start:stop], tape.data[start:stop], until, int(tape.lost[start]))
                entries.append((int(tape.time[stop - 1]), rank, port, chunk))
    order += [(port, chunk) for _, _, port, chunk in sorted(entries, key=lambda e: e[:2])]
    return [*order, *((port, empty(tape.spec, FOREVER)) for port, tape in tapes.items())] if ends else order


def describe(delivery: Delivery) -> str:
    """The cutting on one line: chunk sizes per input, with what was lost before a chunk: "'in': 12 0 (lost 3)40"."""
    sizes: dict[str, list[str]] = {}
    for port, chunk in delivery:
        sizes.setdefault(port, []).append(f"{f'(lost {chunk.lost})' if chunk.lost else ''}{len(chunk)}")
    return "; ".join(f"'{port}': {_runs(texts)}" for port, texts in sizes.items())


def _runs(texts: list[str]) -> str:
    """ "7 7 7 1" as "3x7 1", shortened."""
    runs: list[tuple[str, int]] = []
    for text in texts:
        count = runs.pop()[1] if runs and runs[-1][0] == text else 0
        runs.append((text, count + 1))
    lines = [text if count == 1 else f"{count}x{text}" for text, count in runs]
    return " ".join(lines if len(lines) <= 30 else [*lines[:20], f"... ({len(lines) - 25} more) ...", *lines[-5:]])
