"""What somebody who trains sees: the names of exercises that were shown, taught by a file or while they are done."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.operators.segmentation.commands.label import _cut
from kinegraph.operators.segmentation.names.naming import TURNS, NameRepetitions, letters
from kinegraph.operators.segmentation.names.taught import UNKNOWN, Taught, taught
from kinegraph.operators.segmentation.outputs import PRIMITIVE
from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.cli import main as cli
from kinegraph.stream.data.model_file import ModelError
from kinegraph.stream.errors import InputError, KinegraphError
from kinegraph.stream.manual import ANNOTATION
from kinegraph.stream.operator import grid
from tests.support.command_line import call_command
from tests.support.exercise_events import EVENTS

CONFIGS = Path(__file__).resolve().parents[2] / "configs"


def turns(kind: int, cycles: int = 4, length: int = 40, seed: int = 0, start: float = 0.0) -> Any:
    """A cycle of one kind: (n, 4)."""
    rng, turn = np.random.default_rng(seed), np.arange(cycles * length) * 2 * np.pi / length + start
    mix = np.random.default_rng(100 + kind).normal(size=(4, 4))
    return np.stack([np.sin(turn), np.cos(turn), np.sin(2 * turn), np.cos(2 * turn)], 1) @ mix + 0.05 * rng.normal(
        size=(len(turn), 4)
    )


SPEC = StreamSpec((4,), rate_hz=30.0, units=("cm",), channels=("a", "b", "c", "d"))


def model() -> Taught:
    pieces = [[turns(k, 1, n, seed=n) for n in (38, 40, 44)] for k in range(2)]
    return taught([("squat", pieces[0]), ("arms", pieces[1])], 0.3)


def named(x: Any, spans: list[tuple[int, int]], path: Path | None) -> Any:
    """The output of NameRepetitions for these repetitions, each reported 20 frames after its end."""
    time = grid(30.0, len(x))
    operator = NameRepetitions(model=str(path or ""))
    operator.open({"in": SPEC, "primitive": StreamSpec((), PRIMITIVE)})
    made = []
    for k, (first, last) in enumerate(spans):
        since = spans[k - 1][1] + 20 if k else 0
        operator.process("in", Chunk(time[since : last + 20], x[since : last + 20], int(time[last + 19])))
        done = np.zeros(1, PRIMITIVE)
        done["onset"], done["end"], done["repetition"], done["cluster"] = time[first], time[last], k + 1, k
        ((_, chunk),) = operator.process("primitive", Chunk(time[last + 19 : last + 20], done, int(time[last + 19])))
        made.append(chunk.data)
    return np.concatenate(made)


@pytest.mark.parametrize("phase", [0.0, 2.0, 4.0])
def test_repetitions_are_called_what_was_shown_whatever_phase_they_are_cut_at(tmp_path: Path, phase: float) -> None:
    model().write(tmp_path / "m.npz", SPEC, "made up")
    x = np.concatenate([turns(k, 4, 42, seed=9 + k, start=phase) for k in (0, 1, 2)])
    spans = [(168 * k + 42 * j, 168 * k + 42 * j + 41) for k in range(3) for j in range(3)]
    found = named(x, spans, tmp_path / "m.npz")
    assert found["name"].tolist() == ["squat"] * 3 + ["arms"] * 3 + [UNKNOWN] * 3
    assert (found["sure"][:6] > 0.3).all() and not found["sure"][6:].any()
    assert np.allclose(found["duration_s"], 1.4) and (found["range"] > 1.0).all() and set(found["moves"]) <= set("abcd")
    assert found["distance"][:6].max() < found["distance"][6:].min()


def live(
    x: Any,
    done: list[tuple[int, int, int]],
    names_given: list[tuple[int, str]],
    image: Any = None,
    believed: Any = None,
) -> tuple[list[Any], list[Any]]:
    """Provisional and final output of NameRepetitions for repetitions (activity, first, last), with a name given at some frames.

    believed  what is believed of them, if something else: (frame at which, activity, first, last)
    """
    time = grid(30.0, len(x))
    specs = {"in": SPEC, "radius": EVENTS["radius"], "annotations": StreamSpec((), ANNOTATION)}
    specs |= {"provisional": EVENTS["provisional"], "primitive": EVENTS["primitive"]}
    specs |= {"mirrored": SPEC.derive(meta={"mirrored": True})} if image is not None else {}
    operator = NameRepetitions()
    operator.open(specs)
    operator.process("radius", Chunk(time[:1], np.full(1, 0.3, specs["radius"].dtype), int(time[0])))
    believed = [(last + 5, *one, last) for *one, last in done] if believed is None else believed
    events: list[tuple[int, str, Any]] = [
        (min(at, len(x) - 2), "provisional", (k, *one)) for k, (at, *one) in enumerate(believed)
    ]
    events += [
        (min(last + 50, len(x) - 1), "primitive", (k, a, first, last)) for k, (a, first, last) in enumerate(done)
    ]
    events += [(at, "annotations", text) for at, text in names_given]
    made: dict[str, list[Any]] = {"believed": [], "repetition": []}
    since = 0
    for at, port, what in sorted(events, key=lambda e: e[0]):
        for name, data in (("mirrored", image), ("in", x)):
            if data is not None and at >= since:
                operator.process(name, Chunk(time[since : at + 1], data[since : at + 1], int(time[at])))
        since = at + 1
        row = np.zeros(1, specs[port].dtype)
        row["onset"] = time[at]
        if port == "annotations":
            row["text"] = what
        else:
            k, activity, first, last = what
            row["onset"], row["end"], row["activity"] = time[first], time[last], activity
            row["repetition"] = 1 + sum(a == activity for a, _, _ in done[:k])
        for name, chunk in operator.process(port, Chunk(time[at : at + 1], row, int(time[at]))):
            made[name] += list(chunk.data)
    return made["believed"], made["repetition"]


def test_what_a_person_says_while_it_is_done_names_it_from_then_on() -> None:
    x = np.concatenate([turns(k, 6, 40, seed=k) for k in (0, 1, 0, 2)])
    done = [(k, 240 * k + 40 * j, 240 * k + 40 * j + 39) for k in range(4) for j in range(5)]
    believed, final = live(
        x, done, [(130, "this is: squat"), (180, "well done"), (420, "This is arms"), (430, "this is: " + 30 * "x")]
    )
    names = [str(row["name"]) for row in final]
    assert names[:2] == ["", ""] or names[:2] == ["A", "A"]
    assert names[2:10] == ["squat"] * 3 + [UNKNOWN] * 3 + ["arms"] * 2
    assert names[10:15] == ["squat"] * 5 and names[15:] == [UNKNOWN] * 5
    assert [str(row["name"]) for row in believed if row["activity"] == 0][-1] == "squat"
    assert all(np.isfinite(row["distance"]) for row in final[2:5])


def test_a_name_that_is_said_before_anything_repeats_is_that_of_what_comes_next() -> None:
    x = turns(0, 8, 40)
    _, final = live(x, [(3, 40 * j, 40 * j + 39) for j in range(6)], [(20, "this is: squat")])
    assert [str(row["name"]) for row in final] == ["squat"] * 6


def test_without_a_model_what_is_believed_has_the_letter_of_the_activity_once_that_is_known() -> None:
    """It had no name, so a reader of `believed` alone, such as a broker's entity, never got one."""
    x = turns(0, 8, 40)
    believed, final = live(x, [(3, 40 * j, 40 * j + 39) for j in range(6)], [])
    assert {str(row["name"]) for row in final} == {"A"}
    assert [str(row["name"]) for row in believed] == ["", "", *["A"] * 4]


def test_a_repetition_that_becomes_an_example_lies_as_far_off_as_it_is_from_those_before_it() -> None:
    """Its distance to itself is 0, so a report on repetitions taught while running showed them as all the same."""
    x = np.concatenate([turns(k, 6, 40, seed=k) for k in (0, 1)])
    _, final = live(x, [(0, 40 * j, 40 * j + 39) for j in range(6)], [(20, "this is: squat")])
    distance = [float(row["distance"]) for row in final]
    assert np.isnan(distance[0]) and min(distance[1:]) > 0.0


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("pause", [45, 120])
def test_a_name_that_is_said_as_the_next_exercise_begins_is_not_that_of_the_last(pause: int, known: bool) -> None:
    """The name is given half a second into the first repetition, before it can be detected."""
    begins = 240 + pause
    x = np.concatenate([turns(0, 6, 40), np.zeros((pause, 4)), turns(1, 6, 40), turns(0, 6, 40, seed=3)])
    done = [(k, at + 40 * j, at + 40 * j + 39) for k, at in enumerate((0, begins, begins + 240)) for j in range(6)]
    marks = [(100, "this is: arms")] if known else []
    believed, final = live(x, done, [*marks, (begins + 15, "this is: squat")])
    names = [str(row["name"]) for row in final]
    assert names[6:12] == ["squat"] * 6 and set(names[12:]) == {"arms" if known else UNKNOWN}
    assert not known or "squat" not in names[:6]
    of_first = [str(row["name"]) for row in believed if row["activity"] == 0]
    assert of_first[-1] == ("arms" if known else of_first[-1]) != "squat"


@pytest.mark.parametrize(("pause", "at", "other"), [(120, 260, False), (120, 345, True), (45, 275, True)])
def test_in_a_pause_a_name_is_that_of_the_nearer_exercise(pause: int, at: int, other: bool) -> None:
    """In the last case the repetition before the pause becomes final after the name was given, and settles nothing."""
    begins = 240 + pause
    x = np.concatenate([turns(0, 6, 40), np.zeros((pause, 4)), turns(1, 6, 40), turns(0, 6, 40, seed=3)])
    done = [
        (k, start + 40 * j, start + 40 * j + 39) for k, start in enumerate((0, begins, begins + 240)) for j in range(6)
    ]
    _, final = live(x, done, [(at, "this is: squat")])
    names = [str(row["name"]) for row in final]
    assert names[6:12] == ["squat" if other else UNKNOWN] * 6 and names[12:] == [UNKNOWN if other else "squat"] * 6


def test_a_name_goes_with_repetitions_that_are_believed_of_another_activity_later() -> None:
    """Given in a pause; what follows is provisional in activity 1, then again in activity 2, where it becomes final."""
    x = np.concatenate([turns(0, 6, 40), np.zeros((120, 4)), turns(1, 8, 40)])
    first = [(0, 40 * j, 40 * j + 39) for j in range(6)]
    second = [(2, 360 + 40 * j, 360 + 40 * j + 39) for j in range(6)]
    believed = [(b + 5, k, a, b) for k, a, b in first] + [(b + 5, 1, a, b) for _, a, b in second[:3]]
    believed += [(max(b + 5, second[2][2] + 20), k, a, b) for k, a, b in second]
    _, final = live(x, [*first, *second], [(100, "this is: arms"), (340, "this is: squat")], believed=believed)
    assert [str(row["name"]) for row in final[6:]] == ["squat"] * 6


@pytest.mark.parametrize(("shift", "alike"), [(0, True), (20, True), (None, False)])
def test_how_alike_both_sides_move_is_told_of_every_repetition(shift: int | None, alike: bool) -> None:
    """The mirror image is the same at once, the same in turn, or something else."""
    x = turns(0, 5, 40, seed=1)
    image = turns(1, 5, 40, seed=2) if shift is None else np.roll(turns(0, 5, 40, seed=2), shift, 0)
    _, final = live(x, [(0, 40 * j, 40 * j + 39) for j in range(3)], [], image)
    found = np.array([row["symmetry"] for row in final])
    assert (found > 0.85).all() if alike else (found < 0.5).all()


def test_of_two_steps_the_second_tells_how_long_both_took() -> None:
    operator = NameRepetitions()
    operator.open({"in": SPEC, "primitive": StreamSpec((), PRIMITIVE)})
    done = np.zeros(4, PRIMITIVE)
    done["onset"], done["end"] = np.array([0, 30, 60, 110]) * NS // 30, np.array([29, 59, 99, 129]) * NS // 30
    done["repetition"], done["side"] = [1, 1, 2, 3], [0, 1, 0, 1]
    ((_, chunk),) = operator.process("primitive", Chunk(done["end"].copy(), done, int(done["end"][-1])))
    assert np.allclose(chunk.data["duration_s"], [1.0, 1.0, 40 / 30, 20 / 30], atol=1e-6)
    assert np.allclose(chunk.data["whole_s"], [1.0, 2.0, 40 / 30, 20 / 30], atol=1e-6)


def test_without_a_model_clusters_have_letters_and_what_has_left_the_window_has_no_numbers() -> None:
    x = turns(0, 60)
    found = named(x, [(0, 41), (50, 90)], None)
    assert found["name"].tolist() == ["A", "B"] and np.isnan(found["distance"]).all()
    assert [letters(k) for k in (0, 25, 26, 701, 702)] == ["A", "Z", "AA", "ZZ", "AAA"]
    assert np.isnan(named(x, [(0, 1900)], None)["range"][0])


def test_the_shipped_turns_are_those_of_the_cases() -> None:
    """What a session does before it starts must not need room on a disk."""
    case = NameRepetitions.cases()[0]
    spec, _, x = case.inputs["in"]
    kept, fresh = Taught.read(TURNS, "in", spec), taught([("turn", [x[:31], x[31:62]])], 0.5)
    assert kept.names == fresh.names and (kept.lengths == fresh.lengths).all()
    np.testing.assert_allclose(kept.frames, fresh.frames, atol=1e-12)
    np.testing.assert_allclose(kept.reach, fresh.reach, rtol=1e-9)


def test_a_model_of_other_features_or_a_broken_one_is_refused(tmp_path: Path) -> None:
    model().write(tmp_path / "m.npz", SPEC, "made up")
    read = Taught.read(tmp_path / "m.npz", "in", SPEC)
    assert read.names == ["squat", "arms"] and np.array_equal(read.frames, model().frames)
    with pytest.raises(InputError, match="trained on"):
        Taught.read(tmp_path / "m.npz", "in", SPEC.derive(channels=("a", "b", "c", "e")))
    broken = model()
    broken.lengths[0] = 900
    broken.write(tmp_path / "b.npz", SPEC, "made up")
    with pytest.raises(ModelError, match="lengths"):
        Taught.read(tmp_path / "b.npz", "in", SPEC)


def test_one_repetition_alone_says_nothing_of_how_far_others_may_be() -> None:
    with pytest.raises(KinegraphError, match="show two or more"):
        taught([("squat", [turns(0, 1)])], 0.0)


def kinegraph(*arguments: object) -> int | str | None:
    try:
        call_command(*arguments)
    except SystemExit as ended:
        return ended.code
    return None


def test_one_shown_repetition_that_is_unlike_the_others_does_not_let_everything_pass() -> None:
    """Five of one kind, one of them far away: how far the rest lie from each other says what is of the kind."""
    phase = np.linspace(0.0, 2.0 * np.pi, 40)[:, None]
    shown = [np.hstack([np.sin(phase), np.cos(phase)]) * size for size in (1.0, 1.05, 1.1, 1.15, 2.0)]
    model = taught([("circle", shown)], 0.05)
    other = np.hstack([np.sin(phase), np.cos(phase)]) * 3.0
    assert model.call(model.distances(other))[0] == UNKNOWN
    assert model.call(model.distances(shown[0] * 0.97))[0] == "circle"


def test_steps_of_both_sides_are_kept_however_many_were_shown() -> None:
    """Nine steps, five of which are kept: every second one would be five of the same side, and no step of the other is like them."""
    done = np.zeros(9, PRIMITIVE)
    done["side"], done["repetition"] = 1 + np.arange(9) % 2, 1 + np.arange(9) // 2
    done["onset"], done["end"] = np.arange(9) * NS, np.arange(1, 10) * NS - 1
    time = grid(30.0, 270, 0)
    frames = np.where(time[:, None] // NS % 2 == 0, 1.0, -1.0) * np.ones(4)
    made = taught([("knees", _cut(done, time, frames))], 0.3)
    kept = [float(x[0, 0]) for x in made.frames]
    assert len(kept) == 5 and set(kept) == {1.0, -1.0}
    whole = done[["onset", "end"]][:3]
    assert [len(x) for x in _cut(whole, time, frames)] == [30, 30, 30]


def test_exercises_are_taught_from_one_person_and_named_live_on_another(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Three exercises are shown by one simulated person, and done by another; the fourth was never shown."""
    from kinegraph.devices.people.exerciser import EXERCISES, Exerciser, Routine
    from kinegraph.stream.recording import Recording

    def session(name: str, seed: int, *more: object) -> Path:
        fast = ("--set", "mocap.realtime=false", "--set", "mocap.duration_s=50", "--set", f"mocap.seed={seed}")
        report = ("--set", f"report.path={tmp_path / name}.html")
        assert not kinegraph(
            "run", CONFIGS / "segment_mocap.yaml", *fast, *report, *more, "--view", "none", "-o", tmp_path / name
        )
        return tmp_path / name

    def spans(seed: int) -> dict[str, Any]:
        return {exercise: Routine(Exerciser(seed=seed)).starts(k) for k, exercise in enumerate(EXERCISES)}

    made = tmp_path / "exercises.npz"
    done = [f"{name}={at[0]:.1f}-{at[-1]:.1f}" for name, at in spans(2).items() if name != "wave"]
    assert not kinegraph("motion", "label", session("shown", 2), *done, "-o", made)
    assert "squat: 5 of 6 repetitions kept" in capsys.readouterr().out
    for wrong, message in ((done, "exercises.npz exists"), (["rest=0-0.2"], "between 0 and 0.2 s; there are some at")):
        with pytest.raises(KinegraphError, match=message):
            output = made if wrong is done else tmp_path / "other.npz"
            cli.call("motion label", [str(tmp_path / "shown"), *wrong, "-o", str(output)])
    both = [done[0], done[1], done[1].replace("squat", "arms")]
    with pytest.raises(
        KinegraphError, match=r"squat and arms: the repetition at .* s cannot be both|arms and squat: the"
    ):
        cli.call("motion label", [str(tmp_path / "shown"), *both, "-o", str(tmp_path / "other.npz")])
    assert not (tmp_path / "other.npz").exists()
    assert not kinegraph("motion", "label", tmp_path / "shown", done[1], done[1], "-o", tmp_path / "twice.npz")
    assert "squat: 5 of 6 repetitions kept" in capsys.readouterr().out
    mixed = f"arms={spans(2)['arms'][0]:.1f}-{spans(2)['squat'][2]:.1f}"
    assert not kinegraph("motion", "label", tmp_path / "shown", mixed, "-o", tmp_path / "mixed.npz")
    assert "arms: its repetitions are of 2 kinds" in capsys.readouterr().out
    with Recording.open(session("done", 5, "--set", f"named.model={made}")) as recording:
        found = np.concatenate([entry[0].data for entry in recording.entries("named.repetition")])
        zero = min(s.first for s in recording.streams.values() if s.role == "input" and s.first is not None)
    middle = ((found["onset"] + found["end"]) / 2 - zero) / NS
    for name, at in spans(5).items():
        mine = found["name"][(middle > at[0]) & (middle < at[-1])]
        assert len(mine) and set(mine) == {name if name != "wave" else UNKNOWN}
    assert "squat" in (tmp_path / "done.html").read_text()


def test_taught_by_what_was_said_a_name_is_of_what_was_under_way_or_nearer() -> None:
    from kinegraph.operators.segmentation.commands.label import _meant

    done = np.zeros(6, PRIMITIVE)
    done["onset"] = np.array([0, 2, 4, 12, 14, 16]) * NS
    done["end"], done["activity"] = done["onset"] + 2 * NS, [0, 0, 0, 2, 2, 2]
    meant = [_meant(done, round(s * NS), {}) for s in (-1.0, 1.0, 6.5, 9.5, 12.5, 18.5, 40.0)]
    assert meant == [0, 0, 0, 2, 2, 2, None]
    assert _meant(done, round(6.5 * NS), {0: "arms"}) == 2 and _meant(done, 3 * NS, {0: "arms"}) == 0
    assert _meant(done[:0], 0, {}) is None
