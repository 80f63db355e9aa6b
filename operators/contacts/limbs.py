"""Limbs as a dimension: which channels belong to which limb, events that name theirs, and one operator run for each limb."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any, Generic, TypeVar

import numpy as np

from kinegraph.stream.chunk import Array, Chunk, StreamSpec, Times
from kinegraph.stream.errors import InputError, ParameterError, nearest
from kinegraph.stream.operator import Operator

LIMB = "<U16"
"""The type of an event's field `limb`."""


@dataclass(slots=True)
class LimbsState:
    """
    parts   the state of each limb's operator
    lost    (limbs, ports) 1: samples were lost before this limb's next one
    """

    parts: list[Any]
    lost: Times


P = TypeVar("P", bound=Operator[Any])


class OnePerLimb(Operator[LimbsState], Generic[P]):
    """An operator that runs another one for each limb; equal stamps of several limbs come in the limbs' order."""

    __slots__ = ("parts",)
    parts: list[P]

    def share(self, port: str, limbs: Sequence[str], chunk: Chunk) -> list[Chunk]:
        """A chunk of events with a field `limb`, as each limb's operator sees it."""
        lost = self.state.lost[:, [*self.inputs].index(port)]
        if chunk.lost:
            lost[:] = 1
        made = []
        for i, limb in enumerate(limbs):
            mine = chunk.data["limb"] == limb
            gap = -1 if lost[i] and mine.any() else 0
            lost[i] = 0 if mine.any() else lost[i]
            made.append(Chunk(chunk.time[mine], chunk.data[mine], chunk.until, gap))
        return made


def merged(chunks: Sequence[Chunk]) -> Chunk:
    """What all limbs say up to the same time, in order of time, the first limb first."""
    time = np.concatenate([c.time for c in chunks])
    order = np.argsort(time, kind="stable")
    lost = -1 if any(c.lost for c in chunks) else 0
    return Chunk(time[order], np.concatenate([c.data for c in chunks])[order], chunks[0].until, lost)


def limbs_of(spec: StreamSpec) -> dict[str, tuple[str, ...]]:
    """The limbs of a stream of cycles, and the channels of each; {} where it is of one limb only."""
    return {str(limb): tuple(names) for limb, names in dict(spec.meta.get("limbs") or {}).items()}


def channels_of(limbs: Mapping[str, str], channels: Sequence[str]) -> dict[str, dict[str, str]]:
    """Each limb's channels, and the muscle that each stands for: with {left: "L_*"}, L_TA is the left TA.

    What fits no limb's pattern (a trunk muscle) is cut by the first limb, under its own name. Raises ParameterError.
    """
    made: dict[str, dict[str, str]] = {limb: {} for limb in limbs}
    for channel in channels:
        fits = [limb for limb, pattern in limbs.items() if fnmatchcase(channel, pattern)]
        if len(fits) > 1:
            raise ParameterError("limbs", dict(limbs), f"patterns of which one fits {channel}, not {len(fits)}")
        limb = fits[0] if fits else next(iter(limbs))
        made[limb][channel] = muscle_of(channel, limbs[limb]) if fits else channel
    return made


def muscle_of(channel: str, pattern: str) -> str:
    """What the pattern's star stands for."""
    before, _, after = pattern.partition("*")
    return channel[len(before) : len(channel) - len(after)]


@dataclass(slots=True)
class Belonging:
    """names (l,) of the limbs, empty if there is only one;  belongs (l, m): 1 where a muscle is the limb's."""

    names: list[str]
    belongs: Times

    @staticmethod
    def of(cycles: StreamSpec) -> Belonging:
        limbs = limbs_of(cycles)
        rows = [[int(name in mine) for name in cycles.channels] for mine in limbs.values()]
        return Belonging(list(limbs), np.array(rows, np.int64).reshape(len(limbs), cycles.shape[1]))

    def mine(self, row: Any) -> Array:
        """Which muscles (m,) a cycle's event speaks of."""
        if not self.names:
            return np.ones(self.belongs.shape[1], bool)
        return np.asarray(self.belongs[self.names.index(str(row["limb"]))] == 1)


def check_limbs(limbs: Mapping[str, str], channels: Sequence[str]) -> None:
    """Raise ParameterError unless there are limbs with short names, each with a pattern that fits a channel."""
    if not limbs:
        raise ParameterError("limbs", dict(limbs), "at least one limb, as in {left: L_*, right: R_*}")
    for limb, pattern in limbs.items():
        if not 1 <= len(limb) <= 16:
            raise ParameterError("limbs", limb, "names of 1 to 16 characters")
        if pattern.count("*") != 1:
            raise ParameterError("limbs", pattern, "a pattern with one *, which stands for the muscle, as in L_*")
        if not any(fnmatchcase(channel, pattern) for channel in channels):
            raise ParameterError("limbs", pattern, f"a pattern that fits a channel; {nearest(pattern, channels)}")


def check_named(specs: Mapping[str, StreamSpec], ports: Iterable[str]) -> None:
    """Raise InputError unless these inputs are contacts that name their limb."""
    for port in ports:
        if port in specs and not {"onset", "limb"} <= set(specs[port].dtype.names or ()):
            raise InputError(
                port,
                specs[port].describe(),
                "contact events with the fields onset and limb (operators.contacts.limb_contacts.LimbContacts)",
            )


def with_limb(rows: Array, dtype: np.dtype[Any], limb: str) -> Array:
    """Events (n,) with the field `limb` added."""
    made = np.zeros(len(rows), dtype)
    for name in rows.dtype.names or ():
        made[name] = rows[name]
    made["limb"] = limb
    return made
