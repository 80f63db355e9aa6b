"""Contacts of two legs that come as streams of their own (events of a C3D file, two sensors), in one stream that names the leg."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.operators.contacts.limb_contacts import LIMB_CONTACT
from kinegraph.operators.contacts.limbs import with_limb
from kinegraph.stream.chunk import NEVER, Array, Chunk, Specs, StreamSpec, Times
from kinegraph.stream.errors import InputError
from kinegraph.stream.operator import Case, Input, Operator

LEGS = ("left", "right")


@dataclass(slots=True)
class LegContactsState:
    """stamps, rows: touch-downs, and lift-offs, that wait until all inputs have passed them;  lost (2,): -1 where some may be missing
    before the next;  known (2,): up to when both are known downstream."""

    stamps: list[Times]
    rows: list[Array]
    lost: Times
    known: Times


@dataclass(frozen=True, slots=True)
class LegContacts(Operator[LegContactsState]):
    """Touch-downs of the left and of the right leg in, lift-offs where they are known; the same in two streams out, in order of time.

    Each event gets the field `limb`, left or right, as `operators.contacts.limb_contacts.LimbContacts` gives it, so that cycles,
    footfalls and
    what follows have limbs as a dimension. Of equal stamps the left leg's come first. Nothing is delayed beyond what the inputs are.

    >>> found = apply(LegContacts(), left_touchdown=events([1, 2]), right_touchdown=events([1.5]))
    >>> found["touchdown"]["limb"].tolist()
    ['left', 'right', 'left']
    """

    inputs = {
        "left_touchdown": Input(),
        "right_touchdown": Input(),
        "left_liftoff": Input(optional=True),
        "right_liftoff": Input(optional=True),
    }
    outputs: ClassVar[tuple[str, ...]] = ("touchdown", "liftoff")

    def open(self, specs: Specs) -> Specs:
        for port, given in specs.items():
            if "onset" not in (given.dtype.names or ()):
                raise InputError(port, given.describe(), "contact events, with the field onset")
            if (side := str(given.meta.get("side", ""))) and not port.startswith(side):
                raise InputError(port, f"contacts of the {side} leg", f"those of the {port.partition('_')[0]} one")
        empty, never = np.empty(0, LIMB_CONTACT), np.empty(0, np.int64)
        state = LegContactsState([never, never], [empty, empty], np.zeros(2, np.int64), np.full(2, NEVER))
        self.set_state(state, decision_s={"touchdown": 0.0, "liftoff": 0.0})
        first = specs["left_touchdown"]
        meta = {k: v for k, v in first.meta.items() if k not in ("side", "label")}
        settling_s = max(given.settling_s for given in specs.values())
        made = StreamSpec(
            (), LIMB_CONTACT, units=("ns", ""), settling_s=settling_s, meta={**meta, "limb_names": list(LEGS)}
        )
        return {"touchdown": made, "liftoff": made}

    def process(self, port: str, chunk: Chunk) -> Sequence[tuple[str, Chunk]]:
        s, (leg, _, kind) = self.state, port.partition("_")
        k = self.outputs.index(kind)
        if len(chunk.time):
            s.stamps[k] = np.concatenate([s.stamps[k], chunk.time])
            s.rows[k] = np.concatenate([s.rows[k], with_limb(chunk.data[["onset"]], LIMB_CONTACT, leg)])
        s.lost[k] = -1 if chunk.lost else s.lost[k]
        return [(name, self._due(i, chunk.until)) for i, name in enumerate(self.outputs) if chunk.until > s.known[i]]

    def _due(self, k: int, until: int) -> Chunk:
        """What all inputs have passed, in order of time, the left leg first."""
        s = self.state
        order = np.lexsort([s.rows[k]["onset"], s.rows[k]["limb"], s.stamps[k]])
        n = int((s.stamps[k] <= until).sum())
        time, rows = s.stamps[k][order], s.rows[k][order]
        s.stamps[k], s.rows[k], s.known[k] = time[n:], rows[n:], until
        lost, s.lost[k] = int(s.lost[k]) if n else 0, 0 if n else s.lost[k]
        return Chunk(time[:n], rows[:n], until, lost)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        given = {}
        contact = np.dtype([("onset", "<i8")])
        for port, begin in (
            ("left_touchdown", 0.0),
            ("right_touchdown", 0.5),
            ("left_liftoff", 0.6),
            ("right_liftoff", 0.1),
        ):
            onset = (1e9 * (2 + begin + np.arange(14) * 1.0)).astype(np.int64)
            late = onset + 30_000_000
            given[port] = (StreamSpec((), contact, units=("ns",)), late, onset.view(contact))
        same = dict(given)
        same["right_touchdown"] = given["left_touchdown"]
        bare = {port: each for port, each in same.items() if port.endswith("touchdown")}
        return [Case(cls(), given, least=50), Case(cls(), bare, least=26)]
