"""Alarms about the contacts of several limbs: each limb is watched by itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from kinegraph.operators.contacts.limbs import LimbsState, OnePerLimb, limbs_of, merged, with_limb
from kinegraph.operators.cycles.limb_cycles import LIMB_CLOSED
from kinegraph.operators.monitors.cycle_watch import CycleWatch
from kinegraph.stream.chunk import NS, Chunk, Specs, StreamSpec
from kinegraph.stream.domain.alarm import alarms_spec
from kinegraph.stream.errors import InputError
from kinegraph.stream.operator import Case, Input
from kinegraph.stream.params import param


@dataclass(frozen=True, slots=True)
class LimbWatch(OnePerLimb[CycleWatch]):
    """Cycles of several limbs (`closed` of `operators.cycles.limb_cycles.LimbCycles`) and their signal in, alarms out.

    Each limb has the alarms of `operators.monitors.cycle_watch.CycleWatch`, by the same parameters; their subject is the limb.

    >>> given, made = tried(LimbWatch)
    >>> len(given["closed"]), made[["subject", "state", "what"]][0].item()
    (79, ('left', 'on', 'no contact for 2.0 s'))
    """

    inputs = {"signal": Input(), "closed": Input()}

    silent_cycles: float = param(2.0, above=1.0, most=20.0, help="this many cycles' time without a contact is an alarm")
    first_s: float = param(10.0, above=0.0, help="the same before the first cycle")
    off_pace: float = param(1.6, above=1.0, help="cycles this many times longer or shorter than before are an alarm")
    min_covered: float = param(0.7, least=0.0, most=1.0, help="the part of a session that cycles must cover")
    max_uneven: float = param(0.1, above=0.0, help="the part by which a cycle may differ from the one before it")

    def open(self, specs: Specs) -> Specs:
        closed = specs["closed"]
        limbs = list(limbs_of(closed))
        if "limb" not in (closed.dtype.names or ()) or not limbs:
            raise InputError(
                "closed",
                closed.describe(),
                "cycles of several limbs (`closed` of operators.cycles.limb_cycles.LimbCycles)",
            )
        shared = {f.name: getattr(self, f.name) for f in fields(self)}
        parts = [CycleWatch(**shared, subject=limb) for limb in limbs]
        for part in parts:
            part.open(specs)
        object.__setattr__(self, "parts", parts)
        state = LimbsState([part.state for part in parts], np.zeros((len(parts), 2), np.int64))
        self.set_state(state, decision_s=parts[0].decision_s)
        return alarms_spec(closed.meta)

    def process(self, port: str, chunk: Chunk) -> Sequence[tuple[str, Chunk]]:
        limbs = [part.subject for part in self.parts]
        shares = [chunk] * len(limbs) if port == "signal" else self.share(port, limbs, chunk)
        pieces = [[c for _, c in part.process(port, share)] for part, share in zip(self.parts, shares, strict=True)]
        made = merged([Chunk(c.time, c.data, chunk.until) for parts in pieces for c in parts])
        gap = min((parts[0].until + 1 for parts in pieces if len(parts) > 1), default=None)
        if gap is None:
            return [("out", made)]
        k = int(np.searchsorted(made.time, gap))
        early = Chunk(made.time[:k], made.data[:k], gap - 1)
        return [("out", early), ("out", Chunk(made.time[k:], made.data[k:], made.until, -1))]

    @classmethod
    def cases(cls) -> list[Case]:
        given = CycleWatch.cases()[0].inputs
        _, time, rows = given["closed"]
        meta = {"limbs": {"left": ["L_TA"], "right": ["R_TA"]}, "longest_s": 4.0}
        late = time + 500 * NS // 1000
        both = np.concatenate([with_limb(rows, LIMB_CLOSED, "left"), with_limb(rows[:30], LIMB_CLOSED, "right")])
        when = np.concatenate([time, late[:30]])
        order = np.argsort(when, kind="stable")
        closed = StreamSpec((), LIMB_CLOSED, units=("",), meta=meta)
        return [Case(cls(), {"signal": given["signal"], "closed": (closed, when[order], both[order])}, least=6)]
