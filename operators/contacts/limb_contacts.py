"""Contacts of several limbs in one stream, each event with its limb's name, found by one of the contact detectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from kinegraph.operators.contacts.acceleration import AccelerationContacts
from kinegraph.operators.contacts.contacts import CONTACT, Contacts
from kinegraph.operators.contacts.force import ForceContacts, SwitchContacts
from kinegraph.operators.contacts.inertial import InertialContacts
from kinegraph.operators.contacts.limbs import LIMB, LimbsState, OnePerLimb, merged, with_limb
from kinegraph.operators.contacts.marker import MarkerContacts
from kinegraph.stream.chunk import Array, Chunk, Specs, StreamSpec
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.operator import Case, grid
from kinegraph.stream.params import build, param

LIMB_CONTACT = np.dtype([*CONTACT.descr, ("limb", LIMB)])
"""One contact: when it began, and of which limb."""

DETECTORS: dict[str, type[Contacts[Any]]] = {
    "force": ForceContacts,
    "switch": SwitchContacts,
    "marker": MarkerContacts,
    "inertial": InertialContacts,
    "acceleration": AccelerationContacts,
}


@dataclass(frozen=True, slots=True)
class LimbContacts(OnePerLimb[Contacts[Any]]):
    """One stream (force of all belts, all markers, all switches) in; touch-downs and lift-offs of all limbs out, in order of time.

    `detector` is one of the operators that find the contacts of one foot (docs/method/contacts.md: `force` is ForceContacts, `switch`
    SwitchContacts, `marker` MarkerContacts, `inertial` InertialContacts, `acceleration` AccelerationContacts), `common` its parameters,
    and `limbs` those that differ: {left: {channels: [Fz_left]}, right: {channels: [Fz_right]}}. An event's field `limb` is the name that
    stands there. Everything else, delay and errors included, is the detector's. Memory: one detector per limb.

    >>> line = np.tile([[0.0, 3.0], [3.0, 0.0]], (3, 1)).repeat(50, axis=0)
    >>> limbs = {"left": {"channels": ["l"]}, "right": {"channels": ["r"]}}
    >>> found = LimbContacts("switch", limbs, {"threshold": 1.5})(line, rate_hz=100, channels=["l", "r"])
    >>> found["touchdown"]["limb"].tolist()
    ['left', 'right', 'left', 'right', 'left']
    """

    outputs: ClassVar[tuple[str, ...]] = ("touchdown", "liftoff")

    detector: Literal["force", "switch", "marker", "inertial", "acceleration"] = param(help="what finds the contacts")
    limbs: dict[str, dict[str, Any]] = param(help="per limb, the detector's parameters")
    common: dict[str, Any] | None = param(None, help="parameters of the detector that hold for every limb")

    def open(self, specs: Specs) -> Specs:
        if not self.limbs or any(not 1 <= len(limb) <= 16 for limb in self.limbs):
            raise ParameterError("limbs", list(self.limbs), "at least one limb, with a name of 1 to 16 characters")
        found = DETECTORS[self.detector]
        parts: list[Contacts[Any]] = [build(found, {**(self.common or {}), **mine}) for mine in self.limbs.values()]
        made = [part.open(specs)["touchdown"] for part in parts]
        object.__setattr__(self, "parts", parts)
        self.set_state(
            LimbsState([part.state for part in parts], np.zeros((len(parts), 1), np.int64)),
            delay_s=max(part.delay_s for part in parts),
            decision_s=parts[0].decision_s,
        )
        meta = {k: v for k, v in made[0].meta.items() if k != "side"}
        spec = made[0].derive(
            dtype=LIMB_CONTACT, channels=(), units=("ns", ""), meta={**meta, "limb_names": list(self.limbs)}
        )
        return {"touchdown": spec, "liftoff": spec}

    def process(self, port: str, chunk: Chunk) -> Sequence[tuple[str, Chunk]]:
        found: dict[str, list[Chunk]] = {name: [] for name in self.outputs}
        for limb, part in zip(self.limbs, self.parts, strict=True):
            for name, made in part.process(port, chunk):
                rows: Array = with_limb(made.data, LIMB_CONTACT, limb)
                found[name].append(Chunk(made.time, rows, made.until, made.lost))
        return [(name, merged(chunks)) for name, chunks in found.items()]

    @classmethod
    def cases(cls) -> Sequence[Case]:
        n, rng = 1760, np.random.default_rng(6)
        loads = []
        for begins in (0.7, 0.2):
            phase = (np.arange(n) / 220.0 + begins) % 1.0
            loads.append(700 * np.clip(6.0 * np.minimum(phase, 0.6 - phase), 0.0, 1.0) + rng.normal(0.0, 0.7, n))
        spec = StreamSpec((2,), rate_hz=200.0, channels=("Fz_left", "Fz_right"), units=("N",))
        limbs = {side: {"channels": [f"Fz_{side}"]} for side in ("left", "right")}
        force: Literal["force"] = "force"
        return [
            Case(cls(force, limbs), {"in": (spec, grid(200.0, n), np.stack(loads, axis=1))}, least=24),
            Case(
                cls(force, limbs, {"zero": "none"}), {"in": (spec, grid(200.0, n), np.stack(loads, axis=1))}, least=24
            ),
        ]
