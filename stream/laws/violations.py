"""The rules that the trial holds operators to, by the law of DESIGN they stem from, and what to do where one is broken."""

from __future__ import annotations

from dataclasses import dataclass

from kinegraph.stream.errors import KinegraphError


@dataclass(frozen=True, slots=True)
class Rule:
    """One rule: the law's number (0: what makes a trial possible), what it says, and where to look when it is broken."""

    law: int
    says: str
    advice: str


RULES: dict[str, Rule] = {
    "cases": Rule(
        0,
        "every operator brings cases that it can be tried on, and enough comes out of them",
        "give the class a classmethod `cases` with samples that fill every window; `least` says how many outputs must come",
    ),
    "runs": Rule(
        0,
        "no legal input makes it raise",
        "empty chunks, gaps, pauses, NaN and infinity are legal anywhere; what is not is refused by `open`",
    ),
    "cuts": Rule(
        1,
        "any cutting of the same samples gives the same samples, stamps and gap positions, bit for bit",
        "whatever spans two samples belongs into the state: no window per call, no padding by the first chunk, no BLAS on what is emitted",
    ),
    "ties": Rule(
        1,
        "equal stamps on several inputs give the same, whatever order the ports are named in",
        "declare ports with samples that trigger output as `Input(trigger=True)`, or act once `until` has passed the stamp",
    ),
    "replay": Rule(
        2,
        "the same input gives the same output, chunk for chunk",
        "read no clock, draw no unseeded random numbers, keep nothing in the class or the module",
    ),
    "state": Rule(
        3,
        "a new instance that takes over a snapshot goes on as if nothing had happened",
        "put all that is remembered into fields of the state: arrays, numbers, texts, and lists or dataclasses of these",
    ),
    "memory": Rule(
        4,
        "the state stops growing once its windows are full",
        "keep what a window needs and no more: a ring instead of a list that is appended to",
    ),
    "spec": Rule(
        5,
        "what comes out has the declared output, shape and dtype, with int64 stamps",
        "make the output's arrays from the spec that `open` returned",
    ),
    "order": Rule(
        5, "stamps never decrease", "emit in order of time; an event's stamp is the sample at which it was decided"
    ),
    "spacing": Rule(
        5,
        "a regular stream's stamps stand one period apart, except where samples are reported lost",
        "compute stamps from an index and an anchor; pass `lost` on; or declare rate_hz=None",
    ),
    "until": Rule(
        5,
        "`until` never falls, and no later sample has a stamp at or before it",
        "subtract the delay from the input's `until` as from the stamps, and never promise more than is out",
    ),
    "delay": Rule(
        5,
        "an output is no later, and no earlier, than the declared delay_s allows",
        "declare in `set_state` how much later than its stamp a sample can be known; subtract the delay from the stamps",
    ),
    "time": Rule(
        5,
        "where only time passes, the output's `until` passes with it",
        "answer an empty chunk with an empty chunk that has the input's `until` less the delay",
    ),
    "channels": Rule(
        6,
        "a bad value in one channel changes no other channel",
        "keep every channel's state apart; where channels are combined on purpose, say so in `exemptions`",
    ),
    "nan": Rule(6, "NaN in, NaN out", "emit NaN where the input is not finite, rather than an old or made-up value"),
    "poison": Rule(
        6,
        "after bad samples, good ones give good output again",
        "hold the state where the input is not finite: NaN that has entered a recursive filter never leaves it",
    ),
    "infinity": Rule(6, "infinity is treated as NaN", "test with isfinite, not isnan"),
    "gaps": Rule(
        6,
        "what is lost in the input is reported as lost in the output",
        "pass `lost` on (-1: unknown) with the first output after the gap, on an empty chunk if there is no output yet",
    ),
    "reset": Rule(
        6,
        "after a gap longer than reset_gap_s a signal goes on as if it began there",
        "reset the whole state, the stamps' anchor included",
    ),
    "settling": Rule(
        6,
        "how long the inputs settle counts into how long a regular output does",
        "derive the output's spec with settling_s = the longest of the inputs' + the operator's own",
    ),
    "arrays": Rule(
        7,
        "what is emitted is C-contiguous and writable",
        "np.ascontiguousarray before emitting a transposed or strided view",
    ),
    "emitted": Rule(
        7, "an array is never written again once it has been emitted", "emit fresh arrays, not views of the state"
    ),
    "inputs": Rule(7, "inputs and their specs are never written", "copy before working in place: others read the same"),
    "compile": Rule(
        7,
        "nothing compiles after the warm-up",
        "call every kernel with the same types in every case: float64, C-contiguous; and let the case reach it",
    ),
}


class Broken(KinegraphError):
    """A law that an operator broke: which, where, and what to do."""

    exit_code = 1

    def __init__(self, rule: str, what: str, how: str = "") -> None:
        """`what` was found; `how` it was brought about (the cutting, the faults)."""
        self.rule, self.what, self.how = rule, what, how
        stated = RULES[rule]
        law = f"law {stated.law}, rule '{rule}'" if stated.law else f"rule '{rule}'"
        lines = [f"{law}: {stated.says}", f"  found: {what}"]
        lines += [f"  {line}" for line in how.splitlines()]
        super().__init__("\n".join([*lines, f"  what to do: {stated.advice}"]))
