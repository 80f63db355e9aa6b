"""Which cycles and muscles count: bad ones are left out by their own seconds' quality, and a person has the last word."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal, TypeAlias

import numpy as np
import structlog

from kinegraph.operators.contacts.limbs import Belonging
from kinegraph.operators.cycles.contact_spans import ContactSpans
from kinegraph.operators.cycles.cycle import POINTS, Expected, check_cycles, some_cycles
from kinegraph.operators.cycles.history import REVISABLE
from kinegraph.operators.cycles.verdicts import FLAGS, IN, OUT, UNSAID, PersonVerdicts, Windows, understood
from kinegraph.operators.emg.quality import QUALITY
from kinegraph.stream.chunk import FOREVER, NEVER, NS, Array, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.data.finite import only_finite
from kinegraph.stream.domain.alarm import ALARM
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import Case, Input, Operator
from kinegraph.stream.params import param

JUDGED = np.dtype(
    [
        ("onset", "<i8"),
        ("end", "<i8"),
        ("number", "<i8"),
        ("muscle", "<i4"),
        ("name", "<U16"),
        ("flag", "<U8"),
        ("reason", "<U16"),
        ("used", "<i4"),
    ]
)
"""A muscle in a cycle: the worst flag of its signal in the cycle's seconds, why, and whether it counts (1) or is left out (0)."""
LEAVE, USE = "leave out ", "use "
CONTACTS, TURNING = "contacts", "turning"

Reports: TypeAlias = list[tuple[int, Array, Samples | None, Array]]
"""Stamp, event (1,), curve (None: rejected) and judgements of each cycle to be reported."""

log = structlog.get_logger(__name__)


@dataclass(slots=True)
class ReviewState:
    """
    rows (64,), curves (64, 100, m)   the latest accepted cycles as they came, a ring; `seen` in all;  used (64, m) muscles reported used
    person                a person's verdicts
    spans                 from when to when contacts were wrong;  trust: a person's verdict on all contacts, UNSAID, OUT or IN
    turns                 (64,) numbers of the latest cycles in which the body turned, a ring; 0: not one
    pending, since        the stamp of windows and alarms not applied yet (NEVER if applied), and when the first of them begins
    """

    expected: Expected
    windows: Windows
    rows: Array
    curves: Samples
    used: Times
    person: PersonVerdicts
    seen: int
    spans: ContactSpans
    trust: int
    pending: int
    since: int
    limbs: Belonging
    names: list[str]
    turns: Times


@dataclass(frozen=True, slots=True)
class CycleReview(Operator[ReviewState]):
    """Cycles and their events in, the same out, without the muscles that are not to be trusted.

    closed, cycles   as they came, but a muscle that is left out is NaN throughout its cycle, and so in no mean, spread or statistic; a
                     cycle that a person left out is rejected "by hand", one with wrong contacts "contacts", one with no muscle left
                     "quality"
    judged           one event per muscle of every accepted cycle (`JUDGED`): the worst quality of its own seconds, and whether it counts

    A muscle is left out where its signal was bad (`leave_out`) in a window that overlaps the cycle. A window that ends after the cycle was
    emitted changes it afterwards: `closed` and `cycles` then hold it a second time, which replaces the first, for the latest 64 cycles.

    A whole cycle is left out where an alarm of `contacts` (`operators.monitors.cycle_watch.CycleWatch`: steps missed, or found twice) or
    `timing` (`operators.monitors.timing_watch.TimingWatch`: shifted, or the other leg's) says that its contacts are wrong, from the onset
    of the alarm to that of its end, with the cycles at both edges. Those reported before the alarm came are taken back. `trust_contacts`
    leaves them in.

    A stride of turning (`manner`: operators.strides.stride_manner.StrideManner) is left out, "turning", unless `count_turns`.

    A person has the last word, by an annotation: "leave out 17", "leave out 17 TA", "leave out TA" (in every cycle), "leave out last", or
    "use ..." for the contrary; "use contacts" takes back in all cycles with wrong contacts. As annotations are recorded, a replay knows.
    `left_out` and `kept` say the same from the start on. A cycle that `Cycles` rejected cannot be used: it has no curve.

    >>> notes = events([9.0], [("onset", "<i8"), ("text", "<U64")], text=["leave out 3"])
    >>> closed = apply(CycleReview(), annotations=notes, **some_cycles(8, 2, seed=1))["closed"]
    >>> closed[["number", "rejected"]][closed["number"] == 3].tolist()
    [(3, ''), (3, 'by hand'), (3, 'by hand')]
    """

    inputs = {
        "quality": Input(revises=True, optional=True),
        "annotations": Input(revises=True, optional=True),
        "contacts": Input(revises=True, optional=True),
        "timing": Input(revises=True, optional=True),
        "manner": Input(revises=True, optional=True),
        "closed": Input(trigger=True),
        "cycles": Input(trigger=True),
    }
    outputs: ClassVar[tuple[str, ...]] = ("closed", "cycles", "judged")

    leave_out: Literal["bad", "doubtful", "none"] = param("bad", help="the quality at which a muscle is left out")
    trust_contacts: bool = param(False, help="count cycles although an alarm says that their contacts are wrong")
    count_turns: bool = param(False, help="count strides of turning, too")
    left_out: tuple[str, ...] = param((), help='cycles and muscles to be left out: "17", "17 TA", "TA"')
    kept: tuple[str, ...] = param((), help="those to be used whatever their quality, named alike")

    def open(self, specs: Specs) -> Specs:
        spec = check_cycles(specs)
        if "quality" in specs and specs["quality"].dtype != QUALITY:
            raise InputError("quality", specs["quality"].describe(), "what operators.emg.quality.SignalQuality gives")
        if "annotations" in specs and "text" not in (specs["annotations"].dtype.names or ()):
            raise InputError("annotations", specs["annotations"].describe(), "events with a field 'text'")
        for port in ("contacts", "timing"):
            if port in specs and specs[port].dtype != ALARM:
                raise InputError(port, specs[port].describe(), "alarms about contacts")
        if "manner" in specs and "manner" not in (specs["manner"].dtype.names or ()):
            raise InputError("manner", specs["manner"].describe(), "what operators.strides.stride_manner gives")
        n, names = spec.shape[1], list(spec.channels)
        for parameter in ("left_out", "kept"):
            for text in getattr(self, parameter):
                if understood(text, names, -1) is None:
                    raise ParameterError(parameter, text, f"a cycle's number, a muscle ({', '.join(names)}), or both")
        state = ReviewState(
            Expected.empty(specs["closed"].dtype), Windows.empty(n),
            np.zeros(REVISABLE, specs["closed"].dtype), np.zeros((REVISABLE, POINTS, n)),
            np.ones((REVISABLE, n), np.int64), PersonVerdicts.empty(REVISABLE, n), 0, ContactSpans.empty(),
            IN if self.trust_contacts else UNSAID, NEVER, FOREVER,
            Belonging.of(spec), names, np.zeros(REVISABLE, np.int64),
        )  # fmt: skip
        self.set_state(state, decision_s={"closed": 0.0, "judged": 0.0})
        units = ("ns", "ns", *(6 * [""]))
        return {
            "closed": specs["closed"],
            "cycles": spec,
            "judged": StreamSpec((), JUDGED, units=units, meta=spec.meta),
        }

    def annotations_understood(self) -> tuple[str, ...]:
        return LEAVE, USE

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        s = self.state
        out: Reports = []
        for i, stamp in enumerate(chunk.time.tolist()):
            self._apply(out, stamp - 1)
            if port == "quality":
                name = str(chunk.data["name"][i])
                if name in s.names:
                    s.windows.add(chunk.data[i], s.names.index(name))
                    s.pending, s.since = stamp, min(s.since, int(chunk.data["onset"][i]))
            elif port in ("contacts", "timing"):
                self._alarm(stamp, chunk.data[i])
            elif port == "manner":
                self._walked(out, stamp, chunk.data[i])
            elif port == "annotations":
                self._annotated(out, stamp, str(chunk.data["text"][i]).strip())
            elif port == "closed":
                s.expected.note(chunk.part(i, i + 1))
                if chunk.data["rejected"][i]:
                    s.rows["number"][s.rows["number"] == chunk.data["number"][i]] = -1  # taken back
                    out.append((stamp, chunk.data[i : i + 1], None, np.empty(0, JUDGED)))
            elif (closed := s.expected.match(stamp)) is not None:
                self._take(out, stamp, closed, chunk.data[i])
        self._apply(out, chunk.until)
        return _emitted(out, chunk, s.rows.dtype, len(s.names))

    @classmethod
    def cases(cls) -> list[Case]:
        return _cases()

    def _take(self, out: Reports, stamp: int, closed: Array, curve: Samples) -> None:
        """An accepted cycle has come, for the first time or again."""
        s = self.state
        found = np.flatnonzero(s.rows["number"] == closed["number"][0])
        k = int(found[0]) if len(found) and s.seen else s.seen % REVISABLE
        if not len(found):
            s.seen += 1
            s.person.say(k, -1, UNSAID)
            for texts, verdict in ((self.left_out, OUT), (self.kept, IN)):
                for text in texts:
                    number, muscle = understood(text, s.names, -1) or (0, 0)
                    if number in (-1, int(closed["number"][0])):
                        s.person.say(k, muscle, verdict)
        s.rows[k], s.curves[k] = closed[0], only_finite(curve)
        self._report(out, stamp, k)

    def _alarm(self, stamp: int, row: np.void) -> None:
        """An alarm about contacts has come, or is over."""
        s, subject = self.state, str(row["subject"])
        if subject in s.names or (s.limbs.names and subject not in s.limbs.names):
            return
        since = s.spans.note(row, s.limbs.names.index(subject) if s.limbs.names else 0)
        if since is not None:
            s.pending, s.since = stamp, min(s.since, since - 1)

    def _walked(self, out: Reports, stamp: int, row: np.void) -> None:
        """How a stride was walked is known; it may come before the stride itself."""
        s, number = self.state, int(row["number"])
        if str(row["manner"]) == TURNING and not (s.turns == number).any():
            s.turns[number % REVISABLE] = number
            self._again(out, stamp, [k for k in self._latest() if s.rows["number"][k] == number])

    def _again(self, out: Reports, stamp: int, cycles: list[int]) -> None:
        """Report those of these cycles again of which other muscles count now."""
        for k in cycles:
            if not np.array_equal(self._used(k)[0], self.state.used[k]):
                self._report(out, stamp, k)

    def _apply(self, out: Reports, until: int) -> None:
        """Judge the cycles again that new windows and alarms concern, once these are all there; emit those that change."""
        s = self.state
        if s.pending == NEVER or s.pending > until:
            return
        stamp, since, s.pending, s.since = s.pending, s.since, NEVER, FOREVER
        self._again(out, stamp, [k for k in self._latest() if s.rows["end"][k] > since])

    def _annotated(self, out: Reports, stamp: int, text: str) -> None:
        """Apply a person's verdict on one cycle, on a muscle in it, or on a muscle in all of them."""
        s = self.state
        verdict = OUT if text.startswith(LEAVE) else IN if text.startswith(USE) else UNSAID
        if verdict and text in (LEAVE + CONTACTS, USE + CONTACTS):
            s.trust = verdict
            self._again(out, stamp, self._latest())
            return
        latest = max((int(s.rows["number"][k]) for k in self._latest()), default=0)
        meant = understood(text.removeprefix(LEAVE).removeprefix(USE), s.names, latest) if verdict else None
        if meant is None:
            if verdict:
                log.warning("nothing is left out or used: not understood", text=text, muscles=", ".join(s.names))
            return
        number, muscle = meant
        here = [k for k in self._latest() if number in (-1, int(s.rows["number"][k]))]
        if number < 0:
            s.person.session[muscle] = verdict
        elif not here:
            log.warning(
                "not among the latest cycles that were accepted: replay with left_out or kept", cycle=number, text=text
            )
        for k in here:
            s.person.say(k, muscle, verdict)
        self._again(out, stamp, here)

    def _latest(self) -> list[int]:
        """Where the latest cycles stand, the oldest first."""
        s = self.state
        ring = (k % REVISABLE for k in range(max(s.seen - REVISABLE, 0), s.seen))
        return [k for k in ring if s.rows["number"][k] > 0]

    def _used(self, k: int) -> tuple[Times, Times, Array]:
        """Which muscles of a cycle count (m,), their flags and reasons."""
        s = self.state
        flag, reason = s.windows.of(int(s.rows["onset"][k]), int(s.rows["end"][k]))
        worst = {"bad": 2, "doubtful": 1, "none": 3}[self.leave_out]
        verdicts = s.person.of(k)
        good = (flag < worst) & (not self._wrong(k)) & (not self._turns(k))
        used = np.where(verdicts == UNSAID, good, verdicts == IN) & s.limbs.mine(s.rows[k])
        return used.astype(np.int64), flag, reason

    def _wrong(self, k: int) -> bool:
        """Whether a cycle's contacts are wrong."""
        s, row = self.state, self.state.rows[k]
        limb = s.limbs.names.index(str(row["limb"])) if s.limbs.names else 0
        return s.trust != IN and s.spans.hold(limb, int(row["onset"]), int(row["end"]))

    def _turns(self, k: int) -> bool:
        """Whether a cycle is a stride of turning, which is not asked for."""
        return not self.count_turns and bool((self.state.turns == self.state.rows["number"][k]).any())

    def _report(self, out: Reports, stamp: int, k: int) -> None:
        s = self.state
        used, flag, reason = self._used(k)
        s.used[k] = used
        row = s.rows[k : k + 1].copy()
        judged = np.zeros(len(used), JUDGED)
        for name in ("onset", "end", "number"):
            judged[name] = row[name][0]
        judged["muscle"], judged["name"], judged["used"] = np.arange(len(used)), s.names, used
        judged["flag"], judged["reason"] = np.array(FLAGS)[flag], reason
        mine = s.limbs.mine(row[0])
        judged = judged[mine]
        if not used.any():
            by_hand, wrong = (s.person.cycle[k][mine] == OUT).all(), self._wrong(k)
            row["rejected"] = (
                "by hand" if by_hand else "contacts" if wrong else TURNING if self._turns(k) else "quality"
            )
            out.append((stamp, row, None, judged))
        else:
            out.append((stamp, row, np.where(used.astype(bool), s.curves[k], np.nan), judged))


def _emitted(out: Reports, chunk: Chunk, kind: np.dtype[np.void], muscles: int) -> list[tuple[str, Chunk]]:
    until, lost = chunk.until, -1 if chunk.lost else 0
    stamps = np.array([stamp for stamp, *_ in out], np.int64)
    curves = [(stamp, curve) for stamp, _, curve, _ in out if curve is not None]
    judged = [rows for *_, rows in out]
    closed = np.concatenate([np.empty(0, kind), *(row for _, row, _, _ in out)])
    cycles = np.array([curve for _, curve in curves]).reshape(-1, POINTS, muscles)
    verdicts = np.concatenate([np.empty(0, JUDGED), *judged])
    return [
        ("closed", Chunk(stamps, closed, until, lost)),
        ("cycles", Chunk(np.array([stamp for stamp, _ in curves], np.int64), cycles, until, lost)),
        ("judged", Chunk(stamps.repeat([len(rows) for rows in judged]), verdicts, until, lost)),
    ]


def _cases() -> list[Case]:
    cycles = some_cycles(20, 3, 11)
    last = int(cycles["closed"][1][-1])
    stamps = np.arange(NS, last, NS).repeat(3)
    rows = np.zeros(len(stamps), QUALITY)
    rows["name"], rows["onset"], rows["end"] = np.resize(["TA", "SO", "GM"], len(rows)), stamps - NS, stamps
    rows["flag"] = "good"
    rows["flag"][12:24:3], rows["reason"][12:24:3] = "bad", "flat line"
    text = np.dtype([("onset", "<i8"), ("text", "U64")])
    verdicts = np.array([(0, "leave out 3"), (0, "use 6 TA"), (0, "coffee"), (0, "leave out SO"), (0, "use 3")], text)
    when = np.linspace(6 * NS, last - NS, len(verdicts)).astype(np.int64)
    more = {
        "quality": (StreamSpec((), QUALITY, units=("",)), stamps, rows),
        "annotations": (StreamSpec((), text, units=("",)), when, verdicts),
    }
    alarms = np.zeros(2, ALARM)
    alarms["subject"], alarms["what"] = "contacts", "muscles work half a cycle off"
    alarms["state"], alarms["onset"] = ["on", "over"], cycles["closed"][2]["onset"][[9, 13]]
    wrong = {"timing": (StreamSpec((), ALARM, units=("",)), cycles["closed"][1][[11, 15]], alarms)}
    return [
        Case(CycleReview(), {**more, **cycles}, least=60),
        Case(CycleReview(), {**more, **wrong, **cycles}, least=60),
        Case(CycleReview(leave_out="none", left_out=("4", "TA")), cycles, least=40),
    ]
