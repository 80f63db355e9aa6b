"""A muscle with a bad signal during a cycle is left out and counted as such; a person can overrule it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.people.treadmill import Treadmill
from kinegraph.devices.people.treadmill.faults import Fault, Faults
from kinegraph.operators.cycles.cycles import Cycles
from kinegraph.operators.cycles.review import CycleReview
from kinegraph.operators.cycles.statistics.ensemble import CycleEnsemble
from kinegraph.operators.cycles.statistics.operator import CycleStatistics
from kinegraph.operators.cycles.verdicts import WINDOWS, Windows
from kinegraph.operators.emg.quality import SignalQuality
from kinegraph.stream.chunk import NS, StreamSpec
from kinegraph.stream.engine.replay import Replay
from kinegraph.stream.engine.session import Session
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.graph.reading.load import load
from kinegraph.stream.recording import Recording
from tests.support.emg_run import contacts, drive, enveloped, stamps

MUSCLES = ("TA", "SO")
TEXT = np.dtype([("onset", "<i8"), ("text", "U64")])


def reviewed(seconds: int = 60, fault: Fault | None = None, notes: Any = (), **given: Any) -> dict[str, Any]:
    """A simulated walk through cycles, review, statistics and ensemble; `notes`: (second, text)."""
    signal = Treadmill(muscles=MUSCLES).signal()
    if fault:
        signal.spoil = Faults((fault,), signal).spoil
    n = seconds * 1000
    spec = StreamSpec((2,), rate_hz=1000.0, channels=MUSCLES, units=("uV",))
    emg = (spec, stamps(n), signal.read(0, n)[0])
    touch = signal.gait.cycles(0, n)
    inputs = {
        "signal": enveloped(emg),
        "touchdown": contacts([*(touch[:, 0] / 1000), touch[-1, 2] / 1000]),
        "liftoff": contacts(touch[:, 1] / 1000),
    }
    cycles = drive(Cycles(), inputs, 12)
    typed = np.array([(0, text) for _, text in notes], TEXT)
    when = np.array([round(at * NS) for at, _ in notes], np.int64)
    more = {
        "quality": drive(SignalQuality(), {"in": emg}, 100)["out"],
        "annotations": (StreamSpec((), TEXT), when, typed),
        "closed": cycles["closed"],
        "cycles": cycles["cycles"],
    }
    found = drive(CycleReview(**given), more, 5)
    both = {name: found[name] for name in ("judged", "closed", "cycles")}
    statistics = drive(CycleStatistics(), both)["out"][2]
    ensemble = drive(CycleEnsemble(), {name: both[name] for name in ("closed", "cycles")})
    return {
        "judged": found["judged"][2],
        "closed": found["closed"][2],
        "statistics": statistics,
        "cycles": cycles,
        **ensemble,
    }


def last_of(rows: Any) -> dict[int, Any]:
    """By number, what was reported last."""
    return {int(row["number"]): row for row in rows}


def test_an_electrode_that_was_off_changes_no_number_of_the_good_cycles() -> None:
    """Twenty of sixty seconds without TA: its peak is that of the sound walk's same cycles."""
    sound, spoilt = reviewed(), reviewed(fault=Fault("flat", "TA", from_s=20.0, for_s=20.0))
    rows = [last_of(x["statistics"][x["statistics"]["name"] == "TA"]) for x in (sound, spoilt)]
    left = {k for k, row in rows[1].items() if np.isnan(row["peak"])}
    assert 19 <= len(left) <= 23
    assert {str(rows[1][k]["flag"]) for k in left} == {"bad"}
    peaks = [np.array([x[k]["peak"] for k in rows[1] if k not in left]) for x in rows]
    np.testing.assert_allclose(peaks[1], peaks[0], rtol=1e-6)
    end = spoilt["muscles"][2][-2:]
    assert end["left_out"].tolist() == [len(left), 0]
    mean = np.stack([c for c, k in zip(sound["cycles"]["cycles"][2], rows[0], strict=True) if k not in left]).mean(0)
    np.testing.assert_allclose(spoilt["mean"][2][-1][:, 0], mean[:, 0], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(spoilt["mean"][2][-1][:, 1], sound["mean"][2][-1][:, 1], rtol=1e-9)


def test_a_person_leaves_out_and_takes_back_cycles_and_muscles() -> None:
    notes = [
        (30.0, "leave out 5"),
        (31.0, "leave out 7 SO"),
        (32.0, "leave out 9"),
        (33.0, "use 9"),
        (34.0, "coffee 3"),
    ]
    found = reviewed(notes=notes)
    closed = last_of(found["closed"])
    assert str(closed[5]["rejected"]) == "by hand" and not closed[9]["rejected"] and not closed[7]["rejected"]
    end = found["muscles"][2][-2:]
    assert end["cycles"].tolist() == [len(closed) - 1, len(closed) - 2] and end["left_out"].tolist() == [0, 1]
    whole = reviewed()
    keep = [k for k, number in enumerate(closed) if number != 5]
    np.testing.assert_allclose(
        found["mean"][2][-1][:, 0], whole["cycles"]["cycles"][2][keep].mean(axis=0)[:, 0], rtol=1e-9, atol=1e-9
    )


def test_what_is_said_from_the_start_is_what_is_said_afterwards() -> None:
    afterwards = reviewed(notes=[(50.0, "leave out 12"), (51.0, "leave out SO")])
    given = reviewed(left_out=("12", "SO"))
    np.testing.assert_allclose(given["mean"][2][-1], afterwards["mean"][2][-1], rtol=1e-9, atol=1e-9, equal_nan=True)
    assert given["muscles"][2][-2:]["cycles"].tolist() == afterwards["muscles"][2][-2:]["cycles"].tolist()
    bad = Fault("flat", "TA", from_s=20.0, for_s=20.0)
    assert reviewed(fault=bad, kept=("TA",))["muscles"][2][-2:]["left_out"].tolist() == [0, 0]
    assert reviewed(fault=bad, leave_out="none")["muscles"][2][-2:]["left_out"].tolist() == [0, 0]
    with pytest.raises(ParameterError, match="left_out is 'GM'"):
        reviewed(left_out=("GM",))


@pytest.mark.parametrize("config", ["treadmill_emg", "overground_emg"])
def test_the_shipped_graphs_hear_a_person_and_replay_recordings_that_hold_no_word(config: str) -> None:
    live = load(config)
    sources = {
        f"{n.name}.{out}": spec for n in live.sources for out, spec in n.specs.items() if n.name != "annotations"
    }
    imported = load(config, recorded=sources)
    reviews = [name for name, node in live.nodes.items() if isinstance(node.part, CycleReview)]
    assert reviews
    for name in reviews:
        assert str(live.nodes[name].inputs["annotations"]) == "annotations"
        assert sorted({*imported.nodes[name].inputs} - {"manner"}) == [
            "closed",
            "contacts",
            "cycles",
            "quality",
            "timing",
        ]


def test_what_is_typed_in_a_session_of_the_shipped_graph_counts_in_its_replay(tmp_path: Path) -> None:
    overrides = {"report.path": str(tmp_path / "report.html")}
    session = Session(load("treadmill_emg", overrides=overrides), tmp_path / "s", duration_s=6.0)
    session.mark("leave out TA")
    assert session.run().exit_code == 0
    with Recording.open(tmp_path / "s") as recording:
        rows = recording.read("review.judged")[1]
        assert len(rows) and not rows["used"][rows["name"] == "TA"].any() and rows["used"][rows["name"] == "SO"].all()
        graph = load("treadmill_emg", recorded={n: s.spec for n, s in recording.streams.items()}, overrides=overrides)
        assert Replay(graph, recording).run().differing == []


def test_a_window_of_all_muscles_takes_one_place_of_the_latest() -> None:
    """Of 256 windows the first is still there, however many muscles each was judged for; of one more it is not."""
    event = np.zeros((), [("onset", "<i8"), ("end", "<i8"), ("flag", "U16"), ("reason", "U16")])
    windows = Windows.empty(2)
    for k in range(WINDOWS + 1):
        if k == WINDOWS:
            assert windows.of(0, 1)[0].tolist() == [2, 1] and windows.of(0, 1)[1].tolist() == ["off", "noisy"]
        for muscle, (flag, why) in enumerate(
            (("bad", "off"), ("doubtful", "noisy")) if k == 0 else (("good", ""),) * 2
        ):
            event["onset"], event["end"], event["flag"], event["reason"] = 10 * k, 10 * k + 10, flag, why
            windows.add(event, muscle)
    assert windows.of(0, 1)[0].tolist() == [0, 0]
    assert windows.of(2500, 2501)[0].tolist() == [0, 0] and windows.seen == WINDOWS + 1


def test_a_cycle_stays_left_out_when_its_seconds_are_long_gone() -> None:
    """Windows of signal quality are kept as long as their cycles can be emitted again."""
    found = reviewed(seconds=120, fault=Fault("flat", "TA", from_s=10.0, for_s=6.0), notes=[(100.0, "leave out SO")])
    judged = found["judged"][found["judged"]["name"] == "TA"]
    bad = {int(row["number"]) for row in judged if row["flag"] == "bad"}
    assert len(bad) >= 5
    last = last_of(judged)
    assert {number for number in bad if str(last[number]["flag"]) != "bad"} == set()
