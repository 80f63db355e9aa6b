"""What each repetition is called, by exercises that were shown, and how well it was done: how long, how far, how near to those."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import structlog

from kinegraph.operators.features.mirror import STACKED
from kinegraph.operators.inputs.channels import names_of
from kinegraph.operators.inputs.lengths import length_of, metres
from kinegraph.operators.segmentation.names.recent_frames import RecentFrames, sides_alike, widest
from kinegraph.operators.segmentation.names.taught import (
    MOST_LETTERS,
    MOST_NAMES,
    UNKNOWN,
    Taught,
    fit_for_name,
    grown,
    name_in,
    of_what_ended,
)
from kinegraph.operators.segmentation.outputs import BELIEVED, PRIMITIVE, RADIUS
from kinegraph.stream.chunk import NEVER, Array, Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.data.require import numeric, regular, samples_in
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.manual import ANNOTATION
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

log = structlog.get_logger(__name__)
TEXT = f"<U{MOST_LETTERS}"
BELIEVED_NAME = np.dtype([("activity", "<i8"), ("repetition", "<i4"), ("name", TEXT), ("sure", "<f8")])
REPETITION = np.dtype(
    [
        ("onset", "<i8"), ("end", "<i8"), ("activity", "<i8"), ("repetition", "<i4"), ("cluster", "<i8"), ("side", "<i4"),
        ("name", TEXT), ("sure", "<f8"), ("distance", "<f8"), ("duration_s", "<f8"), ("range", "<f8"), ("moves", TEXT),
        ("symmetry", "<f8"), ("whole_s", "<f8"),
    ]
)  # fmt: skip
SPAN = np.dtype([("onset", "<i8"), ("end", "<i8"), ("activity", "<i8"), ("repetition", "<i4")])
DUE, DUE_NS = 1.5, 10**9
"""An exercise goes on for this many repetitions after its newest one ended, and this long, as it takes a while to see one."""
REMEMBERED = 16
"""This many final repetitions are remembered, for a name that is given after them."""
TURNS = Path(__file__).with_name("turns.npz")
"""Two turns of a made-up signal, taught as "turn": what the cases are named by."""
WALKING, WALKS_M = "walking", 0.35
"""What takes somebody this far from where it began, by the middle of all joints, is walking; exercises end where they begin."""
NONE, COMING = -1, -2
"""No activity; the one that has not been noticed yet."""
NEEDED = {"provisional": BELIEVED, "primitive": PRIMITIVE, "annotations": ANNOTATION, "radius": RADIUS}
"""By port: events with these fields."""


@dataclass(slots=True)
class NamingState:
    """
    recent, images   the newest frames, and their mirror images
    places           the newest middles of all joints, in m
    model            the exercises by which repetitions are named; None: nothing was shown
    latest           (REMEMBERED,) the newest final repetitions, a ring; n_told: how many there were
    lesson, of       a name that was given, and its activity
    given_at, held   when it was given, ns, while its activity is uncertain, and the newest activity then; NEVER: it is certain
    before, formerly the model before it, and what that activity was called; named: by a model
    now, count, last the newest activity with a reported repetition, that repetition's number, and its end, ns
    took, called     how long that took, ns; what the activity was called last
    radius           of the newest activity; period: ns; features: their names
    """

    recent: RecentFrames
    images: RecentFrames
    places: RecentFrames
    to_m: float
    model: Taught | None
    latest: Array
    n_told: int
    lesson: str
    of: int
    given_at: int
    held: int
    before: Taught | None
    formerly: str
    named: bool
    now: int
    count: int
    last: int
    took: int
    called: str
    radius: float
    period: int
    features: list[str]


@dataclass(frozen=True, slots=True)
class NameRepetitions(Operator[NamingState]):
    """Repetitions and the features that they were found in; what each is called, and how it was done, out.

    in           features, as operators.segmentation.Segment takes them
    mirrored     input, optional: the same through operators.features.mirror.Mirror, for `symmetry`
    place        input, optional: the joints that the features are of; what moves somebody on by 0.35 m is "walking"
    annotations  input, optional: "this is: squat" teaches what is being done while the session runs, or what comes next
    radius       of Segment, optional: how far repetitions of a name that is taught live may lie apart
    provisional  of it: repetitions as soon as they are believed
    primitive    of it: repetitions, or their steps, when they are final
    believed     at once: activity, repetition, name, sure (0 to 1)
    repetition   final: onset, end, activity, repetition, cluster, side, as reported; name, sure; distance (to the nearest one of that
                 name that was shown, in the features' unit; NaN without a model), duration_s, range (of the feature that moves most, in its
                 unit), moves (which one that is), symmetry (0 to 1: how alike both sides move, at once or in turn; of two steps, with
                 the second; NaN: not known) and whole_s (duration_s, of the second of two steps with the first)

    `model` is a file that `kinegraph motion label` wrote. What lies too far from all that was shown is "unknown". Without a model clusters
    are named by letters: A, B, ..., what is believed by that of the repetition before it. Two repetitions are compared by warping in
    time, from whichever phase of the cycle is best.
    An annotation teaches up to 5 repetitions of the activity under way, those that are final already among them, or of the next one where
    no activity is under way; up to 32 names. `kinegraph motion label` makes a model of it. A repetition longer than `window_s`, or reported
    later than that, is unknown, and its numbers NaN.

    >>> given, made = tried(NameRepetitions)
    >>> len(given["primitive"]), made["repetition"][["repetition", "name"]][-1].item()
    (17, (3, 'turn'))
    """

    inputs = {
        "in": Input(),
        "mirrored": Input(optional=True),
        "place": Input(optional=True),
        "radius": Input(optional=True),
        "annotations": Input(trigger=True, optional=True),
        "provisional": Input(trigger=True, optional=True),
        "primitive": Input(trigger=True),
    }
    outputs: ClassVar[tuple[str, ...]] = ("believed", "repetition")

    model: str = param(
        "", help="the exercises that `kinegraph motion label` wrote; without: clusters are named by letters"
    )
    window_s: float = param(60.0, above=0.0, most=600.0, help="how much of the features is kept")

    def annotations_understood(self) -> list[str]:
        return ["this is: "]

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        numeric(spec)
        if not spec.is_signal:
            raise InputError(
                "in", spec.describe(), "a signal of features, as operators.segmentation.Segment takes them"
            )
        rate_hz = regular(spec)
        for port, needed in NEEDED.items():
            if port in specs and not set(needed.names or ()) <= set(specs[port].dtype.names or ()):
                raise InputError(
                    port, specs[port].describe(), f"events with the fields {', '.join(needed.names or ())}"
                )
        if "mirrored" in specs and not (
            specs["mirrored"].shape == spec.shape and specs["mirrored"].meta.get("mirrored")
        ):
            raise InputError(
                "mirrored",
                specs["mirrored"].describe(),
                "the features of 'in' through operators.features.mirror.Mirror",
            )
        if "place" in specs and (len(specs["place"].shape) != 2 or specs["place"].shape[1] != 3):
            raise InputError("place", specs["place"].describe(), "joints or markers (n, 3)")
        ring = samples_in("window_s", self.window_s, rate_hz)
        if ring > 20000:
            raise ParameterError("window_s", self.window_s, f"at most {20000 / rate_hz:.4g} s of {rate_hz:g} Hz")
        self.set_state(
            NamingState(
                recent=RecentFrames.of(ring, spec.shape[0]),
                images=RecentFrames.of(ring if "mirrored" in specs else 1, spec.shape[0]),
                places=RecentFrames.of(4 * ring if "place" in specs else 1, 3),
                to_m=metres(length_of(specs["place"], "place")) if "place" in specs else 1.0,
                model=Taught.read(Path(self.model), "in", spec) if self.model else None,
                latest=np.zeros(REMEMBERED, SPAN), n_told=0, lesson="", of=NONE, given_at=NEVER, held=NONE, before=None,
                formerly="", named=False, now=NONE, count=0, last=NEVER, took=0, called="", radius=0.0,
                period=spec.period_ns, features=list(names_of(spec)),
            ),
            decision_s={"believed": 0.0, "repetition": 0.0},
        )  # fmt: skip
        unit = spec.units[0] if len(set(spec.units)) == 1 else ""
        units = {"onset": "ns", "end": "ns", "distance": unit, "range": unit}
        return {
            name: StreamSpec((), dtype, units=tuple(units.get(f, "") for f in dtype.names or ()), meta=spec.meta)
            for name, dtype in (("believed", BELIEVED_NAME), ("repetition", REPETITION))
        }

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        s = self.state
        if port in ("in", "mirrored"):
            (s.recent if port == "in" else s.images).add(chunk)
            return []
        if port == "place":
            known = np.isfinite(chunk.data)
            middle = np.where(known, chunk.data, 0.0).sum(1) / np.where(known.any(1), known.sum(1), np.nan)
            s.places.add(Chunk(chunk.time, middle * s.to_m, chunk.until))
            return []
        if port == "radius":
            if len(chunk):
                s.radius = float(chunk.data["radius"][-1])
            return []
        rows = np.ones(len(chunk), bool) if port == "annotations" else chunk.data["repetition"] > 0
        name, answer, dtype = ANSWERS[port]
        made: list[tuple[int, Array]] = []
        for stamp, event in zip(chunk.time[rows].tolist(), chunk.data[rows], strict=True):
            made += [(stamp, row) for row in answer(self, event)]
        data = np.concatenate([row for _, row in made]) if made else np.empty(0, dtype)
        stamps = np.array([stamp for stamp, _ in made], np.int64)
        return [(name, Chunk(stamps, data, chunk.until, -1 if chunk.lost and made else 0))]

    def _heard(self, event: Array) -> list[Array]:
        """An annotation: if it names what is being done, the repetitions of it so far are examples, and those that follow.

        What goes on is not certain in a pause, or when it has a name: then the next repetition decides.
        """
        s = self.state
        name = name_in(str(event["text"]))
        if not name:
            return []
        known = s.model.names if s.model else []
        if not fit_for_name(name) or (name not in known and len(known) >= MOST_NAMES):
            log.warning("not taught: a name has 1 to 24 letters, and there are at most 32", name=name)
            return []
        s.given_at, s.held, s.before, s.formerly = int(event["onset"]), s.now, s.model, s.called
        s.named = s.model is not None and s.called not in ("", UNKNOWN)
        goes_on = s.now != NONE and not s.named and s.given_at - s.last < DUE * s.took + DUE_NS
        s.lesson = name
        is_of(s, s.now if goes_on else COMING)
        return [named(s.of, s.count, name, 1.0)] if goes_on else []

    def _believed(self, event: Array) -> list[Array]:
        corrected = self._at(event)
        x = self.state.recent.span(int(event["onset"]), int(event["end"]))
        name, _, sure = self._called(x, NONE, event, True)
        return [*corrected, named(int(event["activity"]), int(event["repetition"]), name, sure)]

    def _final(self, event: Array) -> list[Array]:
        s = self.state
        self._at(event)
        span = np.zeros((), SPAN)
        for field in SPAN.names or ():
            span[field] = event[field]
        before = s.latest[(s.n_told - 1) % REMEMBERED].copy()
        s.latest[s.n_told % REMEMBERED] = span
        s.n_told += 1
        shown = s.model
        if s.of == event["activity"]:
            learn(s, span)
        row: Array = np.zeros(1, REPETITION)
        for field in ("onset", "end", "activity", "repetition", "cluster", "side"):
            row[field] = event[field]
        x = s.recent.span(int(event["onset"]), int(event["end"]))
        row["name"], row["distance"], row["sure"] = self._called(x, int(event["cluster"]), event, False)
        if s.model is not shown:  # it has become an example: how far from those before it, not from itself
            row["distance"] = shown.distance_from(x, str(row["name"][0])) if shown else np.nan
        row["duration_s"] = (event["end"] - event["onset"] + s.period) / 1e9
        row["range"], most = widest(x)
        row["moves"] = STACKED.sub("", s.features[most])[:MOST_LETTERS] if most >= 0 else ""
        row["symmetry"] = self._symmetry(event, before)
        row["whole_s"] = row["duration_s"] + (before["end"] - before["onset"] + s.period) / 1e9 * is_second_step(
            event, before
        )
        if s.of >= 0 and event["activity"] > s.of:
            s.lesson, s.of = "", NONE
        return [row]

    def _at(self, event: Array) -> list[Array]:
        """Note that a repetition of this activity was reported; returns the corrections that follow."""
        s = self.state
        if counted_again(s, event):
            is_of(s, int(event["activity"]))
        corrected = decide(s, event)
        if event["activity"] > s.now:
            s.count, s.called = 0, ""
        s.now = max(s.now, int(event["activity"]))
        s.count = max(s.count, int(event["repetition"])) if event["activity"] == s.now else s.count
        if event["end"] > s.last:
            s.last, s.took = int(event["end"]), int(event["end"] - event["onset"])
        return corrected

    def _called(self, x: Samples, cluster: int, event: Array, believed: bool) -> tuple[str, float, float]:
        """A name, the distance from what was shown of it, and how sure that is. What is believed of an activity that is being taught
        has its name."""
        s, activity = self.state, int(event["activity"])
        if s.places.travelled(int(event["onset"]), int(event["end"])) >= WALKS_M:
            answer: tuple[str, float, float] = (WALKING, np.nan, 1.0)
        elif s.lesson and activity == s.of and believed:
            answer = (s.lesson, np.nan, 1.0)
        elif s.model is None:
            letter = s.called if believed and activity == s.now else ""
            answer = (letters(cluster) if cluster >= 0 else letter), np.nan, 0.0
        elif not len(x):
            answer = UNKNOWN, np.nan, 0.0
        else:
            name, distance, sure = s.model.call(s.model.distances(x))
            answer = name, distance if np.isfinite(distance) else np.nan, sure
        if activity == s.now:
            s.called = answer[0] or s.called
        return answer

    def _symmetry(self, event: Array, before: Array) -> float:
        """Symmetry of a repetition; of one reported as two steps, with the second."""
        s = self.state
        onset = int(event["onset"])
        if event["side"] > 0:
            if not is_second_step(event, before):
                return np.nan
            onset = int(before["onset"])
        return sides_alike(s.recent.span(onset, int(event["end"])), s.images.span(onset, int(event["end"])))

    @classmethod
    def cases(cls) -> Sequence[Case]:
        return _cases(cls)


ANSWERS = {
    "annotations": ("believed", NameRepetitions._heard, BELIEVED_NAME),
    "provisional": ("believed", NameRepetitions._believed, BELIEVED_NAME),
    "primitive": ("repetition", NameRepetitions._final, REPETITION),
}
"""By port: the output that answers, how, and with what."""


def is_second_step(event: Array, before: Array) -> bool:
    """Whether it and the one before it are the two steps of one repetition."""
    same = before["activity"] == event["activity"] and before["repetition"] == event["repetition"]
    return bool(event["side"] > 0 and same)


def is_of(s: NamingState, activity: int) -> None:
    """Give the name to an activity: its repetitions so far are examples."""
    s.of = activity
    for span in s.latest[: min(s.n_told, REMEMBERED)]:
        if span["activity"] == activity:
            learn(s, span)


def decide(s: NamingState, event: Array) -> list[Array]:
    """Let a repetition decide the activity of a name given before it ended; returns corrections of wrong beliefs."""
    activity = int(event["activity"])
    if s.given_at == NEVER or (activity <= s.held and event["end"] <= s.given_at):
        return []
    ended = activity <= s.held or of_what_ended(s.given_at, s.last, int(event["onset"]), s.named)
    mine = s.held if ended else activity
    taken_back = s.of not in (COMING, mine)
    if taken_back:
        s.model = s.before
    if s.of != mine:
        is_of(s, mine)
    s.given_at, s.before = NEVER, None
    return [named(s.held, 1, s.formerly, 0.0)] if taken_back and s.formerly else []


def counted_again(s: NamingState, event: Array) -> bool:
    """Whether repetitions of the named activity are now reported in a later one, after a stretch in between."""
    final = (s.latest["activity"][: min(s.n_told, REMEMBERED)] == s.of).any()
    return bool(s.lesson and 0 <= s.of < event["activity"] and not final and event["onset"] + s.took < s.last)


def learn(s: NamingState, span: Array) -> None:
    x = s.recent.span(int(span["onset"]), int(span["end"]))
    if len(x) > 1:
        s.model = grown(s.model, s.lesson, x, s.radius)


def letters(cluster: int) -> str:
    """A, B, ... Z, AA, AB, ..."""
    name, left = "", cluster + 1
    while left:
        left, digit = divmod(left - 1, 26)
        name = chr(ord("A") + digit) + name
    return name


def named(activity: int, repetition: int, name: str, sure: float) -> Array:
    """What is believed: one event."""
    row: Array = np.zeros(1, BELIEVED_NAME)
    row["activity"], row["repetition"], row["name"], row["sure"] = activity, repetition, name, sure
    return row


def _cases(cls: type[NameRepetitions]) -> list[Case]:
    n = 600
    time, turn = grid(30.0, n), np.arange(n) * 0.2
    x = np.stack([np.sin(turn + k) for k in range(3)], 1)
    spec = StreamSpec((3,), rate_hz=30.0, units=("cm",))
    ends = np.arange(60, n - 40, 30)
    latest = np.zeros(len(ends), PRIMITIVE)
    latest["onset"], latest["end"], latest["repetition"] = time[ends - 30], time[ends], 1 + np.arange(len(ends)) % 7
    believed = np.zeros(len(ends), BELIEVED)
    for field in SPAN.names or ():
        believed[field] = latest[field]
    events = {
        "provisional": (StreamSpec((), BELIEVED), time[ends + 5], believed),
        "primitive": (StreamSpec((), PRIMITIVE), time[ends + 30], latest),
    }
    inputs = {"in": (spec, time, x), **events}
    marks = np.zeros(60, ANNOTATION)
    marks["text"] = "well done"
    marks["text"][10] = "this is: a"
    radii = np.full(60, 0.5, RADIUS)
    live = {
        "mirrored": (spec.derive(meta={"mirrored": True}), time, x[:, ::-1].copy()),
        "annotations": (StreamSpec((), ANNOTATION), time[::10], marks),
        "radius": (StreamSpec((), RADIUS), time[::10], radii),
    }
    return [
        Case(cls(model=str(TURNS)), inputs, least=20),
        Case(cls(window_s=3.0), inputs, least=20),
        Case(cls(), inputs | live, least=20),
    ]
