"""The laws of DESIGN on one case of one operator: any cutting, replay, snapshots, memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np

from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.laws.case_samples import Draw, Tapes, repeat, span, tapes_of, with_faults
from kinegraph.stream.laws.chunking import Delivery, anyhow, describe, steps, whole
from kinegraph.stream.laws.play import Player, differ
from kinegraph.stream.laws.violations import RULES, Broken
from kinegraph.stream.laws.watch import compiling
from kinegraph.stream.operator import Case, Operator

ROUNDS = 8
"""How often a case is repeated to see whether the state stops growing."""


class Conformance:
    """One case of an operator, held to the laws. Making it is the warm-up; every method raises `Broken`."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.tapes = tapes_of(case)
        self.excused = type(case.operator).exemptions
        if unknown := self.excused.keys() - RULES.keys():
            raise Broken("cases", f"`exemptions` names {sorted(unknown)}, which are not rules")
        if not self.tapes or not any(len(tape) for tape in self.tapes.values()):
            raise Broken("cases", "the case has no samples")
        self._leaves_specs_alone()
        self._pristine = _copy(self.tapes)
        self.reference = self.play(whole(self.tapes))
        self._enough()
        self.operator: Operator[Any] = self.reference.operator
        limits = [v for name, v in _parameters(case.operator).items() if name.endswith("gap_s") and v is not None]
        self.limit_s = float(max([1.0, *limits]))

    def _leaves_specs_alone(self) -> None:
        specs = deepcopy({port: tape.spec for port, tape in self.tapes.items()})
        self.case.operator.unopened().open(dict(specs))
        if any(spec.to_json() != self.tapes[port].spec.to_json() for port, spec in specs.items()):
            raise Broken("inputs", "`open` changed the spec of an input")

    def _enough(self) -> None:
        count = sum(len(output) for output in self.reference.outputs.values())
        least = max(self.case.least, 1 if self.reference.outputs else 0)
        if count < least:
            raise Broken("cases", f"{count} samples came out, the case promises at least {least}")

    def player(self) -> Player:
        """A fresh instance under watch."""
        return Player(self.case, _jitter_ns(self.tapes), frozenset(self.excused))

    def play(self, delivery: Delivery, tapes: Tapes | None = None) -> Player:
        """A run from the beginning to the end; afterwards the inputs must be as they were."""
        before = None if tapes is None else _copy(tapes)
        player = self.player().play(delivery)
        for port, tape in (self.tapes if tapes is None else tapes).items():
            old = (self._pristine if before is None else before)[port]
            if old.time.tobytes() != tape.time.tobytes() or old.data.tobytes() != tape.data.tobytes():
                raise Broken("inputs", f"the samples given to input '{port}' were changed")
        return player

    @contextmanager
    def warm(self, how: str = "") -> Iterator[None]:
        """Nothing compiles meanwhile, and whatever is broken is reported with `how` it was brought about."""
        with compiling() as kernels:
            try:
                yield
            except Broken as broken:
                raise Broken(broken.rule, broken.what, broken.how or how) from broken.__cause__
        if kernels:
            raise Broken("compile", f"met for the first time: {'; '.join(kernels)}", how)

    def attempt(self, draw: Draw) -> None:
        """Laws 1 to 3: faults and a cutting drawn by chance, once straight through, and through snapshots."""
        tapes, faults = with_faults(draw, self.tapes, self.limit_s)
        delivery = anyhow(draw, tapes)
        places = {draw(0, len(delivery) - 1) for _ in range(draw(1, 3))}
        by_file = bool(draw(0, 1))
        cutting = "\n".join([f"chunks: {describe(delivery)}", *faults])
        with self.warm(cutting):
            reference = self.play(whole(tapes), tapes)
            if difference := differ(reference, straight := self.play(delivery, tapes)):
                raise Broken("cuts", difference)
        how = f"{cutting}\nsnapshot before chunk {sorted(places)}, {'through a file' if by_file else 'in memory'}"
        with self.warm(how):
            resumed = self._play_with_snapshots(delivery, places, by_file)
            if difference := differ(straight, resumed):
                raise Broken("state", difference)

    def _play_with_snapshots(self, delivery: Delivery, places: set[int], by_file: bool) -> Player:
        player = self.player()
        for k, (port, chunk) in enumerate(delivery):
            if k in places:
                player.hand_over(by_file=by_file)
            player.feed(port, chunk)
        player.close()
        return player

    def replay(self) -> None:
        """Law 2: two fresh instances, and one that has worked and was put back to its start, give the same chunks, `until` included."""
        with self.warm():
            delivery = steps(self.tapes, max(1, self.longest // 20))
            one, two = self.play(delivery), self.play(delivery)
            if one.log != two.log:
                k = next((k for k, (a, b) in enumerate(zip(one.log, two.log, strict=False)) if a != b), -1)
                raise Broken("replay", f"the second run differs in emission {k}. {differ(one, two)}")
            if difference := differ(self.reference, one):
                raise Broken("cuts", difference, f"chunks: {describe(delivery)}")
            if one.log != (back := self._put_back(delivery)).log:
                raise Broken("state", f"put back to its start, it gives something else. {differ(one, back)}")

    def _put_back(self, delivery: Delivery) -> Player:
        """The delivery once more, by an operator that has worked through it and was given its first snapshot: as the warm-up does."""
        used = self.player()
        start = used.operator.snapshot()
        for port, chunk in delivery:
            used.feed(port, chunk)
        back = self.player()
        back.operator = used.operator
        back.operator.restore(start)
        return back.play(delivery)

    def memory(self) -> None:
        """Law 4: the case again and again; the snapshot's size in the second half stays within that of the first.

        A single late step (room that doubles, a rare long cycle) is given the benefit of four times as many rounds.
        """
        for rounds in (ROUNDS, 4 * ROUNDS):
            sizes = self._sizes(rounds)
            first, second = max(sizes[: len(sizes) // 2]), max(sizes[len(sizes) // 2 :])
            if second <= first:
                return
        raise Broken(
            "memory",
            f"a snapshot takes up to {second} bytes, it took at most {first} in the first {rounds // 2} of {rounds} rounds",
        )

    def _sizes(self, rounds: int) -> list[int]:
        """What a snapshot takes after each chunk, while the case is repeated."""
        player = self.player()
        sizes = []
        with self.warm(f"the case {rounds} times in a row"):
            for port, chunk in steps(repeat(self.tapes, rounds), max(1, self.longest // 10), ends=False):
                player.feed(port, chunk)
                sizes.append(player.state_bytes)
        return sizes

    @property
    def longest(self) -> int:
        return max(len(tape) for tape in self.tapes.values())

    @property
    def last(self) -> int:
        return span(self.tapes)[1]


def trials(cls: type[Operator[Any]]) -> list[Callable[[], Conformance]]:
    """What makes a trial of each case of a class; raises `Broken` if it has no case."""
    try:
        cases = list(cls.cases())
    except KinegraphError:
        raise
    except Exception as error:
        raise Broken("cases", f"cases() raised {type(error).__name__}: {error}") from error
    if not cases:
        raise Broken("cases", f"{cls.__name__} has no cases")
    return [lambda case=case: Conformance(case) for case in cases]  # type: ignore[misc]


def _copy(tapes: Tapes) -> Tapes:
    return {port: replace(tape, time=tape.time.copy(), data=tape.data.copy()) for port, tape in tapes.items()}


def _parameters(operator: Operator[Any]) -> dict[str, Any]:
    return {name: getattr(operator, name) for name in getattr(operator, "__dataclass_fields__", {})}


def _jitter_ns(tapes: Tapes) -> int:
    """How far regular inputs' stamps are from one period apart."""
    off = [np.abs(np.diff(t.time) - t.spec.period_ns).max(initial=0) for t in tapes.values() if t.spec.period_ns]
    return int(max(off, default=0))
