"""The demo's graph from end to end: a simulated walk with known truth, its report, and the same report from a replay."""

from __future__ import annotations

import csv
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.people.treadmill import Treadmill, truth
from kinegraph.stream.engine.replay import Replay
from kinegraph.stream.graph.plan import plan
from kinegraph.stream.graph.reading.load import load
from kinegraph.stream.recording import Recording
from tests.support.command_line import call_command, succeeding

pytestmark = pytest.mark.xdist_group("treadmill session")  # one process runs it, once

CONFIG = Path(__file__).resolve().parents[2] / "configs" / "treadmill_emg.yaml"
SECONDS = 20


def kinegraph(*arguments: str | Path) -> str:
    """What a command prints."""
    shown = StringIO()
    with redirect_stdout(shown), succeeding():
        call_command(*arguments)
    return shown.getvalue()


def table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder in which a session was run, faster than real time, and what it printed."""
    folder = tmp_path_factory.mktemp("session")
    quick = ["treadmill.realtime=false", f"treadmill.duration_s={SECONDS}"]
    faults = "treadmill.faults=[{kind: flat, muscle: SO, from_s: 6, for_s: 8}, {kind: lost, from_s: 10, for_s: 0.3}]"
    sets = [part for setting in [*quick, faults] for part in ("--set", setting)]
    return folder, kinegraph("run", CONFIG, *sets, "-o", folder / "recording", "--view", "lines")


def test_every_cycle_is_where_it_truly_was(session: tuple[Path, str]) -> None:
    folder, shown = session
    true, envelope = truth(Treadmill(), SECONDS * 1000)
    rows = [row for row in table(folder / "recording" / "report.csv") if float(row["touch-down (s)"]) > 0]
    assert len(rows) >= len(true) - 1
    for row, (touch, lift, end) in zip(rows, true, strict=False):
        assert float(row["touch-down (s)"]) == touch / 1000
        assert abs(float(row["duration_s"]) - (end - touch) / 1000) < 1e-9
        assert abs(float(row["stance_pct"]) - 100 * (lift - touch) / (end - touch)) < 1e-9
        hit, near = (touch < 10_300 + reach and end > 10_000 - reach for reach in (0, 500))
        assert bool(row["rejected"]) == hit or near, row[
            "number"
        ]  # the envelope's filters reach 0.2 s into the gap's neighbours
        assert f"cycle {row['number']} " in shown
    good = [(row, cycle) for row, cycle in zip(rows, true, strict=False) if not row["rejected"]]
    for muscle, name in enumerate(Treadmill().muscles[:-1]):
        means = [float(row[f"{name} mean (uV)"]) for row, _ in good]
        expected = [envelope[a:b, muscle].mean() * np.sqrt(2 / np.pi) for _, (a, _, b) in good]
        assert abs(np.mean(means) / np.mean(expected) - 1) < 0.15, name


def test_the_page_names_what_went_wrong(session: tuple[Path, str]) -> None:
    page = (session[0] / "recording" / "report.html").read_text()
    for words in (
        "Recording <b>recording</b>",
        "SO bad (flat line",
        "gap in the signal or the contacts",
        "treadmill.emg",
        "300 (1.50 %)",
        "not normalised",
    ):
        assert words in page, words


def test_a_replay_names_whose_recording_it_is(tmp_path: Path) -> None:
    """The command line overrules the graph's names. A missing date is not made up."""
    rows = "".join(f"{i / 1000:.3f},{i % 7}\n" for i in range(4000))
    (tmp_path / "walk.csv").write_text(f"time,TA [uV]\n{rows}")
    (tmp_path / "steps.csv").write_text("heel_s\n0.5\n1.5\n2.5\n")
    streams = ["--stream", "treadmill.emg=TA", "--time", "treadmill.emg=time", "--events", "treadmill.touchdown=heel_s"]
    streams += ["--events", "treadmill.liftoff=heel_s"]
    tables = [tmp_path / "walk.csv", tmp_path / "steps.csv"]
    kinegraph(
        "files",
        "import",
        *tables,
        "-o",
        tmp_path / "named.mcap",
        *streams,
        "--fact",
        "subject=S01",
        "--fact",
        "speed_m_s=1.4",
    )
    kinegraph("files", "import", *tables, "-o", tmp_path / "nameless.mcap", *streams)
    for name, settings, words in (
        ("named", [], "Subject <b>S01</b>"),
        ("named", ["--set", "session.subject=S02"], "Subject <b>S02</b>"),
        ("nameless", [], '<p class="facts">'),
    ):
        page = tmp_path / f"{len(words)}{len(settings)}{name}.html"
        say = ["--speak", "report", "--set", f"report.path={page}", *settings]
        output = kinegraph("replay", CONFIG, tmp_path / f"{name}.mcap", *say)
        assert (
            words in page.read_text()
            and "Subject <b>simulated" not in page.read_text()
            and "1970" not in page.read_text().partition("<h2>")[0]
        )
        assert ("Speed <b>1.4 m/s</b>" in page.read_text()) == (name == "named")
        assert ("holds no facts about its session" in output) == (name == "nameless")
        assert ("side right (--set session.NAME=VALUE overrides one)" in output) == (name == "named")
        assert f"Recording <b>{name}.mcap (from walk.csv, steps.csv)</b>" in page.read_text()
        assert f"{name}.mcap, in place of devices.people.treadmill.Treadmill" in page.read_text()
        assert "cadence_per_min: 57" not in page.read_text()


def test_a_replay_that_may_speak_writes_the_same_table(session: tuple[Path, str]) -> None:
    folder, _ = session
    again = ["--speak", "report", "--set", f"report.path={folder / 'again.html'}", "--verify", "-q"]
    kinegraph("replay", CONFIG, folder / "recording", *again)
    assert (folder / "again.csv").read_bytes() == (folder / "recording" / "report.csv").read_bytes()
    assert "<svg" in (folder / "again.html").read_text()


def test_no_cycle_is_told_later_than_the_plan_says(session: tuple[Path, str], tmp_path: Path) -> None:
    """From the touch-down that closes a cycle to the newest sample that had come when it was reported; not within lost samples."""
    with Recording.open(session[0] / "recording") as recording:
        graph = load(CONFIG, recorded={name: stream.spec for name, stream in recording.streams.items()})
        replay = Replay(graph, recording, output=tmp_path / "again")
        newest, waited = [0], []
        for wire in replay.pipeline.entries.values():
            wire.observers.append(lambda chunk: newest.append(max(newest[-1], *chunk.time[-1:].tolist(), 0)))
        replay.pipeline.edges["leg.cycles.closed"].observers.append(
            lambda chunk: waited.extend((newest[-1] - chunk.data["end"])[chunk.data["rejected"] == ""].tolist())
        )
        replay.run()
        slowest = plan(graph).slowest
    assert len(waited) > 12 and slowest is not None
    assert 0.239 < max(waited) / 1e9 <= slowest.delay_s
