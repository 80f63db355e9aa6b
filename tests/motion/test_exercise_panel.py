"""What stands on the terminal while somebody trains: the panel, its lines, the bell."""

from __future__ import annotations

import io
from contextlib import nullcontext

import numpy as np
import pytest
from rich.console import Console
from rich.file_proxy import FileProxy

from kinegraph.devices.outlets.terminal.exercise_panel import FIELDS, ExercisePanel, ring
from kinegraph.devices.outlets.terminal.exercise_screen import panel
from kinegraph.devices.outlets.terminal.view import LineView
from kinegraph.stream.chunk import Chunk
from kinegraph.stream.cli.commands.run import _screen
from kinegraph.stream.data.state import pack, unpack
from kinegraph.stream.errors import InputError
from kinegraph.stream.graph import Graph
from tests.support.exercise_events import EVENTS, event, training


def opened(bell: bool = False) -> ExercisePanel:
    made = ExercisePanel(bell=bell)
    made.open({port: EVENTS[port] for port in FIELDS})
    return made


def shown(outlet: ExercisePanel) -> str:
    console = Console(width=120, file=io.StringIO(), record=True)
    console.print(panel(outlet.state))
    return console.export_text()


def test_the_panel_says_what_is_done_since_when_how_often_and_what_came_before() -> None:
    outlet, seen = opened(), []
    for port, chunk in training():
        outlet.process(port, chunk)
        seen.append(shown(outlet))
    assert "squat x 3, last 2.0 s, since 0:00, 80% sure" in "".join(seen) and "1 final, 2 may still" in "".join(seen)
    after = next(k for k, (port, _) in enumerate(training()) if port == "activity")
    assert seen[after].startswith("nothing that repeats") and "before: squat x 3, 6.0 s" in seen[after]
    assert seen[after + 1].startswith("rest, since 0:04\n")
    final = next(k for k, (port, _) in enumerate(training()) if port == "repetition")
    assert seen[final].startswith("squat x 3, last 1.9 s, since 0:00, 90% sure")
    assert seen[-2].startswith("motion, since")
    assert seen[-1].startswith("exercise x 1, since") and "before: rest, 4.5 s · squat x 3, 6.0 s" in seen[-1]


def test_an_exercise_that_is_final_when_the_next_one_goes_on_keeps_its_name() -> None:
    outlet, parts = opened(), training()
    ended = next(k for k, (port, _) in enumerate(parts) if port == "activity")
    for port, chunk in [*parts[:ended], *parts[-2:], parts[ended]]:
        outlet.process(port, chunk)
    assert shown(outlet).startswith("exercise x 1") and "before: squat x 3" in shown(outlet)


def test_a_correction_of_what_came_before_does_not_take_the_place_of_what_is_done_now() -> None:
    """Gestures out of rest are corrected when the activity that holds them is final; the next one goes on by then."""
    outlet, parts = opened(), training()
    ended = next(k for k, (port, _) in enumerate(parts) if port == "activity")
    late = [
        ("provisional", event("provisional", 17, onset=7, end=9, activity=1, repetition=4)),
        ("count", event("count", 17, activity=1, count=4, certainty=0.5)),
    ]
    for port, chunk in [*parts[:ended], *parts[-2:], *late]:
        outlet.process(port, chunk)
    assert shown(outlet).startswith("exercise x 1")
    outlet.process(*parts[ended])
    for port, chunk in late:
        outlet.process(port, chunk)
    assert shown(outlet).startswith("exercise x 1") and "before: squat x 3" in shown(outlet)


def test_what_was_counted_as_the_next_exercise_and_taken_back_goes_on_as_the_last() -> None:
    outlet, parts = opened(), training()
    ended = next(k for k, (port, _) in enumerate(parts) if port == "activity")
    for port, chunk in [*parts[:ended], *parts[-2:]]:
        outlet.process(port, chunk)
    outlet.process("count", event("count", 17, activity=2, count=0))
    outlet.process("count", event("count", 17, activity=1, count=4, certainty=0.5))
    assert shown(outlet).startswith("squat x 4")


def test_motion_that_goes_on_while_the_last_exercise_is_corrected_is_motion_still() -> None:
    outlet, parts = opened(), training()
    ended = next(k for k, (port, _) in enumerate(parts) if port == "activity")
    late = ("count", event("count", 17, activity=1, count=4, certainty=0.5))
    for port, chunk in [*parts[:ended], parts[-2], late, parts[ended]]:
        outlet.process(port, chunk)
    assert shown(outlet).startswith("motion, since 0:09")


def test_a_session_that_is_to_show_nothing_prints_no_repetition(capsys: pytest.CaptureFixture[str]) -> None:
    """`--view none`: nothing is printed; in replay, which has no view, every repetition is a line."""
    for view in (_screen("none", Graph("train", {}, "")), nullcontext()):
        outlet = opened()
        with view:
            for port, chunk in training():
                outlet.process(port, chunk)
        assert bool(capsys.readouterr().out) is isinstance(view, nullcontext)


def test_where_there_is_no_terminal_every_repetition_is_a_line() -> None:
    out = io.StringIO()
    with LineView(Graph("train", {}, ""), out):
        outlet = opened()
        for port, chunk in training():
            outlet.process(port, chunk)
    lines = out.getvalue().splitlines()[1:]
    assert [line.split(",")[0] for line in lines if line.startswith("squat")] == [
        f"squat x {n}" for n in (1, 2, 3, 2, 3)
    ]
    assert "ended: squat x 3, 6.0 s" in lines and "ended: rest, 4.5 s" in lines and "" not in lines


def test_the_panel_goes_on_from_a_snapshot_and_takes_any_stream_with_its_fields() -> None:
    outlet, other = opened(), opened()
    parts = training()
    for port, chunk in parts[:9]:
        outlet.process(port, chunk)
    unpack(other.state, pack(outlet.state))
    for port, chunk in parts[9:]:
        outlet.process(port, chunk)
        other.process(port, chunk)
    assert shown(outlet) == shown(other)
    with pytest.raises(InputError, match="events with the fields onset, end, activity"):
        ExercisePanel().open(dict.fromkeys(FIELDS, EVENTS["rest"]))


def test_the_bell_rings_once_for_every_new_repetition(monkeypatch: pytest.MonkeyPatch) -> None:
    rung: list[int] = []
    monkeypatch.setattr("kinegraph.devices.outlets.terminal.exercise_panel.ring", lambda: rung.append(1))
    outlet = opened(bell=True)
    for port, chunk in training():
        outlet.process(port, chunk)
    assert len(rung) == 5  # 1, 2, 3, 3 again after a correction, and 1 of the next exercise


def test_the_bell_rings_for_each_of_two_repetitions_that_are_counted_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first one is believed with the second, and both come in one chunk; so do the first of the next exercise."""
    rung: list[int] = []
    monkeypatch.setattr("kinegraph.devices.outlets.terminal.exercise_panel.ring", lambda: rung.append(1))
    outlet = opened(bell=True)
    for activity, counts in ((1, (1, 2)), (1, (3, 4, 5)), (2, (1, 2)), (2, (1,))):
        fields = [event("count", 5, activity=activity, count=k) for k in counts]
        data = np.concatenate([one.data for one in fields])
        outlet.process("count", Chunk(np.concatenate([one.time for one in fields]), data, fields[-1].until))
    assert len(rung) == 7


def test_the_bell_is_heard_past_the_live_view(monkeypatch: pytest.MonkeyPatch) -> None:
    """While the live view is drawn, what goes to standard error waits for the end of its line, and a bell is no line."""

    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    terminal = Terminal()
    monkeypatch.setattr("sys.__stderr__", terminal)
    monkeypatch.setattr("sys.stderr", FileProxy(Console(file=io.StringIO()), terminal))
    ring()
    assert terminal.getvalue() == "\a"


def final(number: int, onset: float, end: float, side: int = 0, activity: int = 1) -> tuple[str, Chunk]:
    fields = {"activity": activity, "repetition": number, "side": side, "name": "knees", "duration_s": end - onset}
    return "repetition", event("repetition", end + 3, onset=onset, end=end, **fields)


def ended(onset: float, end: float, activity: int = 1, repetitions: int = 0) -> tuple[str, Chunk]:
    fields = {"activity": activity, "repeats": repetitions > 0, "repetitions": repetitions, "certainty": 0.5}
    return "activity", event("activity", end + 9, onset=onset, end=end, **fields)


def after(*parts: tuple[str, Chunk]) -> str:
    outlet = opened()
    for port, chunk in parts:
        outlet.process(port, chunk)
    return shown(outlet)


def test_the_last_repetition_is_as_long_as_both_of_its_steps() -> None:
    begun = ("provisional", event("provisional", 3, onset=1, end=3, activity=1, repetition=0))
    steps = [final(1, 5, 5.9, side=1), final(1, 5.9, 6.7, side=2), final(2, 6.7, 7.5, 1), final(2, 7.5, 8.4, 2)]
    assert ", last 1.7 s, " in after(begun, *steps[:2]) and ", last 1.7 s, " in after(begun, *steps)
    newer = ("provisional", event("provisional", 10, onset=8.4, end=9.3, activity=1, repetition=3))
    assert ", last 1.7 s, " in after(begun, *steps, newer)  # it is believed before it has quite ended


def test_since_when_is_the_first_repetition_not_the_rest_that_the_activity_begins_with() -> None:
    """An activity may begin with a rest: what is shown of it is from its first repetition to its last."""
    parts = [
        ("resting", event("resting", 1, onset=0.5)),
        ("provisional", event("provisional", 9, onset=1, end=9, activity=1, repetition=0)),
        ("provisional", event("provisional", 9, onset=5, end=7, activity=1, repetition=1)),
        ("count", event("count", 9, activity=1, count=1)),
    ]
    assert "since 0:04" in after(*parts)
    repetitions = [final(1, 5.2, 7), final(2, 7, 9.2)]
    assert "before: knees x 2, 4.0 s\n" in after(*parts, *repetitions, ended(1, 10, repetitions=2)) + "\n"


def test_what_came_before_stands_in_its_order_and_rest_is_no_other_motion() -> None:
    """Rests come at once, activities seconds later; a stretch that holds nothing but a rest is not shown."""
    rest = ("rest", event("rest", 12, onset=7, end=11.5))
    assert "before: rest, 4.5 s · exercise 1 x 3, 6.0 s\n" in after(rest, ended(1, 7, repetitions=3)).replace(
        " \n", "\n"
    )
    assert "other" not in after(rest, ended(6.8, 12, activity=2))
    pairs = [
        [
            ("rest", event("rest", 20 * k + 9, onset=20 * k + 7, end=20 * k + 12)),
            ended(20 * k, 20 * k + 7, k, repetitions=3),
        ]
        for k in range(6)
    ]
    parts = [part for pair in pairs for part in pair][:-1]
    strip = " ".join(after(*parts).partition("before: ")[2].split())
    assert strip == " · ".join(["rest, 5.0 s", *2 * ["rest, 5.0 s", "exercise 1 x 3, 7.0 s"], "rest, 5.0 s"])


def repeated(activity: int, number: int, onset: float, end: float, name: str, sure: float) -> list[tuple[str, Chunk]]:
    """A repetition, and that it is one of the activity, in the order in which they come."""
    fields = {"onset": onset, "end": end, "activity": activity, "repetition": number}
    return [
        ("provisional", event("provisional", end, **fields)),
        ("count", event("count", end, activity=activity, count=number)),
        ("believed", event("believed", end, activity=activity, repetition=number, name=name, sure=sure)),
    ]


def confirmed(number: int, onset: float, end: float, name: str, sure: float) -> tuple[str, Chunk]:
    fields = {"activity": 1, "repetition": number, "name": name, "sure": sure, "duration_s": end - onset}
    return "repetition", event("repetition", end + 1, onset=onset, end=end, **fields)


THREE = [
    *repeated(1, 1, 1, 3, "arms", 0.7),
    *repeated(1, 2, 3, 5, "arms", 0.7),
    confirmed(1, 1, 3, "arms", 0.8),
    *repeated(1, 3, 5, 6.9, "arms", 0.3),
    confirmed(2, 3, 5, "arms", 0.78),
]


def test_a_count_is_doubtful_only_when_one_that_rests_on_two_final_repetitions_says_so() -> None:
    """The newest count was reported with a single final repetition, which cannot be compared with any."""
    assert "not sure" not in after(*THREE)
    assert "not sure that it repeats" in after(*THREE, ("count", event("count", 9, activity=1, count=4)))


def test_how_sure_a_name_is_does_not_fall_with_every_repetition_that_has_not_quite_ended() -> None:
    """The newest final one counts; before it, the provisional one."""
    assert ", 80% sure" in after(*THREE[:-1]) and ", 78% sure" in after(*THREE)
    assert ", 70% sure" in after(*THREE[:6])
    unlike = after(*THREE, *repeated(1, 4, 7, 9, "unknown", 0.0))
    assert unlike.startswith("arms x 4, ") and ", 78% sure" in unlike
    assert after(*THREE, *repeated(1, 4, 7, 9, "squat", 0.4)).startswith("squat x 4, ")
    assert after(*THREE, *repeated(1, 4, 7, 9, "", 0.0), confirmed(3, 5, 7, "unknown", 0.0)).startswith("unknown x 4")
    believed = ("believed", event("believed", 9, activity=1, repetition=3, name="arms up", sure=1.0))
    assert after(*THREE, believed).startswith("arms up x 3, ") and "100% sure" in after(*THREE, believed)


def test_a_name_that_is_hardly_sure_is_a_question() -> None:
    """An exercise that had not been shown was called "squat", 29 % sure, until its first repetition was final."""
    assert after(*repeated(1, 1, 1, 3, "squat", 0.29)).startswith("squat? x 1, ")
    assert after(*repeated(1, 1, 1, 3, "squat", 0.4)).startswith("squat x 1, ")
    assert after(*THREE[:3], confirmed(1, 1, 3, "arms", 0.2)).startswith("arms? x 1, ")
    for name in ("unknown", "A", ""):  # of letters nothing says how sure they are
        assert "?" not in after(*repeated(1, 1, 1, 3, name, 0.0))


def test_unknown_is_no_answer_before_a_repetition_is_final() -> None:
    """The first line of an exercise that had been shown read "unknown x 2": what has not quite ended is less like what was shown."""
    first = [*repeated(1, 1, 1, 3, "unknown", 0.0), *repeated(1, 2, 3, 5, "unknown", 0.0)]
    assert after(*first).startswith("exercise x 2, ")
    assert after(*first, *repeated(1, 3, 5, 7, "squat", 0.6)).startswith("squat x 3, ")
    assert after(*first, confirmed(1, 1, 3, "unknown", 0.0), *repeated(1, 3, 5, 7, "unknown", 0.0)).startswith(
        "unknown x 3"
    )
    assert after(*repeated(1, 1, 1, 3, "squat", 0.6), *repeated(1, 2, 3, 5, "unknown", 0.0)).startswith("unknown x 2")


def test_while_somebody_rests_and_until_something_repeats_the_last_count_stays_in_view() -> None:
    rest = ("resting", event("resting", 9, onset=8)), ("rest", event("rest", 12, onset=8, end=11.5))
    resting, moving = after(*THREE, rest[0]), after(*THREE, *rest)
    assert resting.startswith("rest, since 0:05\nso far arms x 3, last 2.0 s, since 0:00, 78% sure\n2 final, 1 may")
    assert moving.startswith("motion\nso far arms x 3, last 2.0 s")
    on = [*THREE, *rest, *repeated(1, 4, 12, 14, "arms", 0.7)]
    assert after(*on).startswith("arms x 4, ") and "so far" not in after(*on)
    corrected = after(*THREE, rest[0], ("count", event("count", 9, activity=1, count=3)))
    assert corrected.startswith("rest, since 0:05\nso far arms x 3")


def test_what_goes_on_no_more_but_is_not_final_yet_is_in_the_strip() -> None:
    rest = ("rest", event("rest", 12, onset=8, end=11.5))
    other = repeated(2, 1, 12, 14, "squat", 0.7)
    seen = after(*THREE, rest, *other)
    assert seen.startswith("squat x 1") and "before: rest, 3.5 s · arms x 3, 4.0 s" in seen
    ended_too = after(*THREE, rest, *other, ended(1, 7, repetitions=3))
    assert ended_too.count("arms") == 1 and "before: rest, 3.5 s · arms x 3, 6.0 s" in ended_too
    taken_back = ("count", event("count", 15, activity=1, count=0))
    assert "arms" not in after(*THREE, rest, *other, taken_back)


def test_a_line_waits_for_the_name_that_comes_with_it() -> None:
    """The count of a repetition comes first; its name, worked out from it, at the same stamp."""

    def lines(outlet: ExercisePanel) -> list[str]:
        out = io.StringIO()
        with LineView(Graph("train", {}, ""), out):
            for port, chunk in [*THREE, ("count", event("count", 8, activity=1, count=2))]:
                if port in outlet_ports(outlet):
                    outlet.process(port, chunk)
        return [line.split(",")[0] for line in out.getvalue().splitlines() if " x " in line]

    assert lines(opened()) == [f"arms x {n}" for n in (1, 2, 3, 2)]
    nameless = ExercisePanel()
    nameless.open({port: EVENTS[port] for port in ("provisional", "count", "activity")})
    assert lines(nameless) == [f"exercise x {n}" for n in (1, 2, 3, 2)]


def outlet_ports(outlet: ExercisePanel) -> tuple[str, ...]:
    return tuple(FIELDS) if outlet.state.named else ("provisional", "count", "activity")


def test_what_repeats_without_a_cluster_has_no_number() -> None:
    outlet = opened()
    outlet.process("activity", event("activity", 9.0, repeats=True, cluster=-1, activity=0, repetitions=4))
    assert "exercise x 4" in shown(outlet)
